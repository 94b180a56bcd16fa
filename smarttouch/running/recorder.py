"""Recorder of a run: steps and events into one MCAP file, on a thread of its own."""

import json
import math
import os
import platform
import queue
import threading
import time
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any, BinaryIO

import cv2
import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex
from mcap.writer import Writer

from smarttouch.base.electrodes import ElectrodeArray
from smarttouch.base.errors import RecordingError
from smarttouch.base.events import Event
from smarttouch.base.files import owner_only, sync_folder, unwritable
from smarttouch.base.version import __version__
from smarttouch.profile import Profile
from smarttouch.running.listener import Listener, RunContext
from smarttouch.running.recording_format import FORMAT, METADATA, TOPICS, schema
from smarttouch.running.step import StepResult
from smarttouch.running.step_encoder import Message, StepEncoder

FLUSH_S = 0.04
"""Longest time before data is passed to the system: the loss when a program is killed."""
SYNC_S = 1.0  # longest time before data is on the disk: the loss at a power failure
MOST_WAITING = 1000


class _GoneError(OSError):
    """The file no longer has the name that it was created with."""


_Item = StepResult | tuple[int, str]


class RecordingWriter:
    """Writer of steps and events to a new MCAP file, on a thread of its own.

    A step is with the system at most `FLUSH_S` and the time to write it later, and is then safe
    from any end of this program; at most `SYNC_S` and the disk's own time later it is safe from a
    power cut. Times in the file are times of day; ``about`` (see `about_run`) is kept as metadata.
    """

    def __init__(
        self,
        path: Path,
        about: dict[str, str],
        started_unix_ns: int,
        electrodes: ElectrodeArray | None = None,
    ) -> None:
        try:
            self._file: BinaryIO = open(path, "xb", opener=owner_only)  # noqa: SIM115, until closing
        except FileExistsError:
            raise name_taken(path) from None
        except OSError as error:
            raise unwritable(RecordingError, path, error) from None
        self._path = path
        self._started_unix_ns = started_unix_ns
        self._failure: Exception | None = None
        self._reported = False
        self._closed = False
        self._index = 0
        self._queue: queue.SimpleQueue[_Item | None] = queue.SimpleQueue()
        self._encoder = StepEncoder(started_unix_ns, electrodes)
        self._writer = new_writer(self._file)
        self._thread = threading.Thread(target=self._write_all, name="recorder", daemon=True)
        self._guarded(self._begin, about)
        if self._failure is not None:
            self.close()
        self._thread.start()

    def _begin(self, about: dict[str, str]) -> None:
        self._writer.start(profile=METADATA, library=f"smarttouch {__version__}")
        self._writer.add_metadata(METADATA, {"format": FORMAT, **about})
        self._channels = {topic: self._register(topic) for topic in TOPICS}
        self._sync()
        sync_folder(self._path.absolute().parent)

    def record(self, result: StepResult) -> None:
        """Queue one step for writing; RecordingError if the disk is full, broken or too slow."""
        if self._queue.qsize() > MOST_WAITING:
            said = f"{MOST_WAITING} frames wait for the disk, it is too slow"
            self._fail(TimeoutError(0, said))
        if self._failure is not None:
            raise self._complaint()
        self._queue.put(result)

    def event(self, time_ns: int, words: str) -> None:
        """Queue an event at a time since the start of the run."""
        self._queue.put((time_ns, words))

    def close(self) -> None:
        """Write everything queued, and finish the file.

        Raises RecordingError if the disk did not take all of it, unless that was reported before.
        """
        if self._closed:
            return
        self._closed = True
        if self._thread.is_alive():
            self._queue.put(None)
            self._thread.join()
        self._guarded(self._writer.finish)
        self._guarded(self._to_disk)
        self._guarded(self._require_there)
        self._guarded(self._file.close)
        if self._failure is not None and not self._reported:
            raise self._complaint()

    def _register(self, topic: str) -> int:
        name, content = TOPICS[topic][0], json.dumps(schema(topic)).encode()
        schema_id = self._writer.register_schema(name, "jsonschema", content)
        return int(self._writer.register_channel(topic, "json", schema_id))

    def _complaint(self) -> RecordingError:
        self._reported = True
        if isinstance(self._failure, _GoneError):
            return RecordingError(
                f"{self._path} was removed, moved or replaced while it was written, so it is not "
                "this run's recording: leave the file alone until the run has ended"
            )
        said = getattr(self._failure, "strerror", None) or repr(self._failure)
        return RecordingError(f"{self._path} is cut short: {said}; what was written is kept")

    def _fail(self, error: Exception) -> None:
        self._failure = self._failure or error

    def _guarded(self, act: Callable[..., object], *arguments: object) -> None:
        """Run an operation on the file; after the first failure, only close it.

        What has only lost its name is finished first: it may have been moved.
        """
        failed = self._failure is not None and not isinstance(self._failure, _GoneError)
        if failed and act != self._file.close:
            return
        try:
            act(*arguments)
        except Exception as error:
            # Any exception must reach the loop: a run is not to go on unrecorded.
            self._fail(error)

    def _write_all(self) -> None:
        """Write queued data; flush and sync before it has waited too long."""
        flush_at = sync_at = math.inf
        while True:
            due = min(flush_at, sync_at)
            wait_s = None if math.isinf(due) else max(0.0, due - time.monotonic())
            try:
                item = self._queue.get(timeout=wait_s)
                if item is None:
                    return
                now = time.monotonic()
                flush_at, sync_at = min(flush_at, now + FLUSH_S), min(sync_at, now + SYNC_S)
                self._guarded(self._write, item)
            except queue.Empty:
                pass
            now = time.monotonic()
            if now >= sync_at:
                self._guarded(self._sync)
                flush_at = sync_at = math.inf
            elif now >= flush_at:
                self._guarded(self._flush)
                flush_at = math.inf

    def _flush(self) -> None:
        self._writer.flush()
        self._file.flush()

    def _sync(self) -> None:
        self._flush()
        self._to_disk()
        self._require_there()

    def _require_there(self) -> None:
        """Raise unless whoever opens the path gets the file that is written."""
        try:
            there = os.path.samestat(self._path.stat(), os.fstat(self._file.fileno()))
        except OSError:
            there = False
        if not there:
            raise _GoneError

    def _to_disk(self) -> None:
        """Sync the file to the disk."""
        self._file.flush()
        os.fsync(self._file.fileno())

    def _write(self, item: _Item) -> None:
        if not isinstance(item, StepResult):
            time_ns, words = item
            self._add("/event", self._encoder.event(time_ns, words), time_ns, 0)
            return
        time_ns = item.step.input.time_ns
        for topic, message in self._encoder.messages(item):
            self._add(topic, message, time_ns, self._index)
        self._index += 1

    def _add(self, topic: str, message: Message, time_ns: int, index: int) -> None:
        at_ns = self._started_unix_ns + time_ns
        self._writer.add_message(
            self._channels[topic],
            log_time=at_ns,
            publish_time=at_ns,
            sequence=index,
            data=json.dumps(message, separators=(",", ":"), allow_nan=False).encode(),
        )


def new_writer(file: BinaryIO) -> Writer:
    """Return a writer whose memory does not grow with the run."""
    writer = Writer(file)
    # It keeps an index of every chunk until the end: as objects, 1 kB each, 25 a second.
    if hasattr(writer, _INDEXES):
        setattr(writer, _INDEXES, _PackedIndexes())
    return writer


_INDEXES = "_Writer__chunk_indices"


class _PackedIndexes:
    """Chunk indexes stored as the bytes at the end of the file."""

    def __init__(self) -> None:
        self._builder = RecordBuilder()

    def append(self, index: ChunkIndex) -> None:
        index.write(self._builder)

    def __iter__(self) -> Iterator["_PackedIndexes"]:
        yield self

    def write(self, builder: RecordBuilder) -> None:
        builder.write(self._builder.end())


def name_taken(path: Path) -> RecordingError:
    """Return the error of a recording that exists already."""
    return RecordingError(f"{path} exists and recordings are never overwritten: give another name")


class Recorder(Listener):
    """Listener that records a run to a file; see `RecordingWriter`.

    Parameters
    ----------
    path : Path or str
        The file; an existing one is not overwritten.

    Examples
    --------
    See `smarttouch.replay`.
    """

    def __init__(self, path: Path | str) -> None:
        super().__init__()
        self.path: Path = Path(path)
        self._writer: RecordingWriter | None = None

    def prepare(self, run: RunContext) -> None:
        """Raise if the file exists, before the display is opened."""
        if self.path.exists():
            raise name_taken(self.path)

    def start(self, run: RunContext) -> None:
        """Start the file, with the description of the open board."""
        started_unix_ns = time.time_ns()
        about = about_run(run.profile, run.settings, started_unix_ns)
        electrodes = run.profile.electrodes
        self._writer = RecordingWriter(self.path, about, started_unix_ns, electrodes)

    def step(self, result: StepResult) -> None:
        """Queue a step for writing."""
        if self._writer is not None:
            self._writer.record(result)

    def event(self, event: Event) -> None:
        """Queue an event for writing."""
        if self._writer is not None:
            self._writer.event(event.time_ns, str(event))

    def close(self) -> None:
        """Write everything queued, and finish the file."""
        if self._writer is not None:
            self._writer.close()


def about_run(profile: Profile, settings: dict[str, Any], started_unix_ns: int) -> dict[str, str]:
    """Return the description of a run in its recording, with the software versions.

    Of the settings, `RunSettings` are what sequences depend on; all else is for readers.
    """
    versions = {
        "smarttouch": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "scipy": version("scipy"),
        "mcap": version("mcap"),
        "platform": platform.platform(),
    }
    return {
        "started_unix_ns": str(started_unix_ns),
        "profile": profile.model_dump_json(),
        "settings": json.dumps(settings, default=str),
        "versions": json.dumps(versions),
    }
