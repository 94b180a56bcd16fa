"""Recorder of a run: writes steps and events to an MCAP file, in its own thread."""

import json
import os
import queue
import threading
import time
from pathlib import Path

import numpy as np
from mcap.writer import Writer
from numpy.typing import NDArray

from smarttouch.base import __version__
from smarttouch.base.errors import RecordingError
from smarttouch.base.events import Event
from smarttouch.base.files import owner_only, unwritable
from smarttouch.running.recording_format import (
    METADATA,
    SCHEMAS,
    Message,
    about_run,
    event_message,
    image_message,
    step_message,
)
from smarttouch.running.step_records import Listener, RunContext, StepResult

CHUNK_S = 1.0  # longest time until a step is on disk, apart from delays of the disk
MOST_WAITING = 1000  # largest number of steps waiting for the disk


class Recorder(Listener):
    """Listener that records a run to a file, in its own thread.

    Each step is on disk after at most `CHUNK_S`, plus the delay of the disk. Times in the file are
    Unix times.

    Parameters
    ----------
    path : Path or str
        New file; an existing file is not overwritten.

    Examples
    --------
    See `smarttouch.replay`.
    """

    def __init__(self, path: Path | str) -> None:
        super().__init__()
        self.path: Path = Path(path)
        self._started_unix_ns = 0
        self._failure: Exception | None = None
        self._reported = False
        self._steps = 0
        self._image: tuple[NDArray[np.uint8], int] | None = None
        self._queue: queue.SimpleQueue[StepResult | Event | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None  # runs from `start` to `close`

    def prepare(self, run: RunContext) -> None:
        """Before the display is opened, raise RecordingError if the file already exists."""
        if self.path.exists():
            raise RecordingError(
                f"{self.path} exists and recordings are never overwritten: give another name"
            )

    def start(self, run: RunContext) -> None:
        """Begin the file with the description of the run."""
        started_unix_ns = time.time_ns()
        self.begin(about_run(run.profile, run.settings, started_unix_ns), started_unix_ns)

    def begin(self, about: dict[str, str], started_unix_ns: int) -> None:
        """Begin the file with a description of the run, see `about_run`."""
        self._started_unix_ns = started_unix_ns
        try:
            self._file = open(self.path, "xb", opener=owner_only)  # noqa: SIM115, until closing
            self._writer = Writer(self._file)
            self._write_head(about)
        except OSError as error:
            raise unwritable(RecordingError, self.path, error) from None
        self._thread = threading.Thread(target=self._write_all, name="recorder", daemon=True)
        self._thread.start()

    def _write_head(self, about: dict[str, str]) -> None:
        self._writer.start(profile=METADATA, library=f"smarttouch {__version__}")
        self._writer.add_metadata(METADATA, about)
        self._channels = {}
        for topic, (name, properties) in SCHEMAS.items():
            schema = {"title": name, "type": "object", "properties": properties}
            schema_id = self._writer.register_schema(
                name, "jsonschema", json.dumps(schema).encode()
            )
            self._channels[topic] = self._writer.register_channel(topic, "json", schema_id)
        self._writer.flush()
        self._to_disk()

    def step(self, result: StepResult) -> None:
        """Queue a step for writing. Raises RecordingError if the disk fails, is full or slow."""
        if self._queue.qsize() > MOST_WAITING:
            self._failure = self._failure or TimeoutError(
                0, f"{MOST_WAITING} steps wait for the disk, which is too slow"
            )
        if self._failure is not None:
            raise self._complaint()
        self._queue.put(result)

    def event(self, event: Event) -> None:
        """Queue an event for writing."""
        if self._thread is not None:
            self._queue.put(event)

    def close(self) -> None:
        """Write everything queued, and finish the file.

        Raises RecordingError if writing failed, unless `step` has reported the failure.
        """
        thread, self._thread = self._thread, None
        if thread is None:
            return
        self._queue.put(None)
        thread.join()
        if self._failure is not None and not self._reported:
            raise self._complaint()

    def _complaint(self) -> RecordingError:
        self._reported = True
        reason = getattr(self._failure, "strerror", None) or repr(self._failure)
        return RecordingError(f"{self.path} is incomplete: {reason}; earlier steps are kept")

    def _write_all(self) -> None:
        """Write the queue until the end. After a failure, only close the file."""
        try:
            with self._file:
                while self._write_chunk():
                    self._writer.flush()
                    self._to_disk()
                self._writer.finish()
                self._to_disk()
        # Pass any exception to the loop: a run must not continue unrecorded.
        except Exception as error:
            self._failure = self._failure or error

    def _write_chunk(self) -> bool:
        """Write the items of the next `CHUNK_S`; return False at the end of the recording."""
        item, begun_s = self._queue.get(), time.monotonic()
        while item is not None:
            if self._failure is not None:
                raise self._failure
            self._write(item)
            left_s = begun_s + CHUNK_S - time.monotonic()
            if left_s <= 0:
                return True
            try:
                item = self._queue.get(timeout=left_s)
            except queue.Empty:
                return True
        return False

    def _to_disk(self) -> None:
        """Sync the file to disk. Raises OSError if the file was removed or replaced."""
        self._file.flush()
        os.fsync(self._file.fileno())
        try:
            is_there = os.path.samestat(self.path.stat(), os.fstat(self._file.fileno()))
        except OSError:
            is_there = False
        if not is_there:
            raise OSError(0, "the file was removed, moved or replaced while it was written")

    def _write(self, item: StepResult | Event) -> None:
        if isinstance(item, Event):
            at_ns = self._started_unix_ns + item.time_ns
            self._add("/event", event_message(str(item), at_ns), at_ns)
            return
        step_input = item.step.input
        at_ns = self._started_unix_ns + step_input.time_ns
        if step_input.image is not None and self._is_new(step_input.image, step_input.number):
            self._add("/frame", image_message(step_input.image, at_ns), at_ns)
        self._add("/step", step_message(item), at_ns)
        self._steps += 1

    def _is_new(self, image: NDArray[np.uint8], number: int) -> bool:
        """Return whether an image must be written, because its number or pixels have changed."""
        before, self._image = self._image, (image, number)
        return (
            before is None
            or number != before[1]
            or not (image is before[0] or np.array_equal(image, before[0]))
        )

    def _add(self, topic: str, message: Message, at_ns: int) -> None:
        self._writer.add_message(
            self._channels[topic],
            log_time=at_ns,
            publish_time=at_ns,
            sequence=self._steps,
            data=json.dumps(message, separators=(",", ":"), allow_nan=False).encode(),
        )
