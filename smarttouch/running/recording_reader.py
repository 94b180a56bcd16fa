"""Reading of recordings, including cut or damaged ones, as steps, events and arrays."""

import json
from collections.abc import Generator, Iterator
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, get_args

import numpy as np
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray
from pydantic import ValidationError

from smarttouch.base.errors import ProfileError, RecordingError, SmartTouchError
from smarttouch.base.files import open_file, unreadable
from smarttouch.profile import Profile
from smarttouch.running.recording_format import (
    FORMAT,
    METADATA,
    RecordedConfig,
    RecordedStep,
    StepDecoder,
    digest_of,
)

_MOST_BYTES = 2**40  # largest size of a recording, reached after about a month
_MOST_RECORD_BYTES = 128 * 2**20  # largest size of a chunk that is read; most have a few MB


@dataclass(frozen=True, eq=False)
class RunArrays:
    """All arrays of a recording; the page *Recordings* lists shapes, units and meanings."""

    step: NDArray[np.int64]
    time_ns: NDArray[np.int64]
    clock_ns: NDArray[np.int64]
    number: NDArray[np.int64]
    mode: NDArray[np.str_]
    level: NDArray[np.float64]
    intensity: NDArray[np.float64]
    restarted: NDArray[np.bool_]
    asked_us: NDArray[np.int64]
    period_us: NDArray[np.int64]
    force_n: NDArray[np.float64]
    x_mm: NDArray[np.float64]
    y_mm: NDArray[np.float64]
    angle_rad: NDArray[np.float64]
    age_ns: NDArray[np.int64]
    stale: NDArray[np.bool_]
    latency_us: NDArray[np.float64]
    work_us: NDArray[np.float64]
    sent: NDArray[np.int64]
    acknowledged: NDArray[np.int64]
    refused: NDArray[np.int64]
    first_pulse_us: NDArray[np.float64]
    activation: NDArray[np.float32]
    first_slot: NDArray[np.int64]
    current_ua: NDArray[np.int16]
    width_us: NDArray[np.uint16]
    discharge_us: NDArray[np.uint16]
    site: NDArray[np.uint16]
    recharge_us: NDArray[np.int64]
    recharge_ua: NDArray[np.int16]


_SLOTS = ("current_ua", "width_us", "discharge_us", "site")


def _arrays(steps: Iterator[RecordedStep], electrodes: int) -> RunArrays:
    columns: dict[str, list[Any]] = {field.name: [] for field in fields(RunArrays)}
    row_of: dict[int | None, int] = {}  # row of each sequence, by its number
    columns["first_slot"].append(0)
    for row, recorded in enumerate(steps):
        sent, sequence = recorded.sent, recorded.step.sequence
        recharge_ua = sequence.recharge_ua
        # Most values are fields of the message, with the same names as the arrays.
        values = recorded.message | {
            "step": recorded.index,
            "sent": -1 if sent.number is None else sent.number,
            "first_pulse_us": np.nan,
            "activation": recorded.step.tactile.activation,
            "first_slot": columns["first_slot"][-1] + sequence.slots,
            "recharge_ua": np.zeros(electrodes) if recharge_ua is None else recharge_ua,
            **{name: getattr(sequence, name).ravel() for name in _SLOTS},
        }
        for name, column in columns.items():
            column.append(values[name])
        row_of[sent.number] = row
        if sent.first_pulse is not None and sent.first_pulse.number in row_of:
            pulsed = row_of[sent.first_pulse.number]
            columns["first_pulse_us"][pulsed] = sent.first_pulse.latency_us
    sides = {"current_ua": [electrodes], "activation": [3, electrodes], "recharge_ua": [electrodes]}
    arrays = {}
    for field in fields(RunArrays):
        # The last argument of an array type is a dtype before NumPy 2.5, and a scalar type later.
        kind: Any = get_args(field.type)[-1]
        kind = (get_args(kind) or (kind,))[0]
        made: Any = columns[field.name]
        if field.name in _SLOTS:
            made = np.concatenate([np.empty(0, kind), *made])
        arrays[field.name] = np.array(made, kind).reshape(-1, *sides.get(field.name, []))
    return RunArrays(**arrays)


class RecordedRun:
    """Recording of a run, possibly cut or damaged, see `smarttouch.load_recording`.

    Attributes
    ----------
    path : Path
    about : dict of str to str
        Description of the run: profile, settings, versions.
    damaged_chunks, broken_steps : int
        Numbers of unreadable chunks and steps, counted when the file was last read.
    """

    def __init__(self, path: Path | str) -> None:
        self.path: Path = Path(path)
        self.about: dict[str, str] = {}
        self.damaged_chunks: int = 0
        self.broken_steps: int = 0
        self._ended = False
        self._last_ns = 0
        for record in self._records():
            if isinstance(record, Metadata) and record.name == METADATA:
                self.about = record.metadata
            elif isinstance(record, Chunk):
                self._last_ns = max(self._last_ns, record.message_end_time)
        version = self.about.get("format")
        if version is None:
            raise RecordingError(f"{path} is not a recording of SmartTouch")
        if version != FORMAT:
            raise RecordingError(
                f"{path} is a recording of format {version!r}, but this version reads {FORMAT}: "
                "use the version that made the recording"
            )
        if self.about.get("digest") != digest_of(self.about):
            raise RecordingError(
                f"the description of the run in {path} does not match its digest, so it was "
                "changed or damaged: use an intact copy"
            )

    def __repr__(self) -> str:
        return f"RecordedRun({str(self.path)!r}, {self.seconds:.1f} s)"

    @property
    def whole(self) -> bool:
        """Whether the recording ended properly, and everything read so far was intact."""
        return self._ended and not self.damaged_chunks and not self.broken_steps

    @cached_property
    def started_unix_ns(self) -> int:
        """Start of the run, ns since 1970."""
        return int(self.about["started_unix_ns"])

    @property
    def seconds(self) -> float:
        """Time from the start of the run to the last message, s."""
        return max(0, self._last_ns - self.started_unix_ns) / 1e9

    @cached_property
    def profile(self) -> Profile:
        """Device and finger of the run."""
        try:
            return Profile.model_validate_json(self.about["profile"])
        except (ValueError, ProfileError) as error:
            first = error.errors()[0]["msg"] if isinstance(error, ValidationError) else error
            message = f"the profile in {self.path} is not valid in this version: {first}"
            raise RecordingError(message) from None

    @cached_property
    def settings(self) -> dict[str, Any]:
        """Settings of the run."""
        return dict(json.loads(self.about["settings"]))

    @cached_property
    def run(self) -> RecordedConfig:
        """Configuration of the run, with everything that sequences depend on."""
        try:
            return RecordedConfig.model_validate(self.settings)
        except (SmartTouchError, LookupError, AttributeError) as error:
            raise RecordingError(f"the settings in {self.path} are incomplete: {error}") from None

    def steps(self) -> Generator[RecordedStep, None, None]:
        """Yield all complete steps, in order."""
        decoder = StepDecoder(len(self.profile.electrodes))
        for topic, message in self.messages():
            at_ns = message.log_time - self.started_unix_ns
            step = decoder.take(topic, message.sequence, message.data, at_ns)
            if step is not None:
                yield step
        self.broken_steps = decoder.broken

    @cached_property
    def arrays(self) -> RunArrays:
        """Arrays of the run, read at first use."""
        return _arrays(self.steps(), len(self.profile.electrodes))

    def contents(self, topic: str) -> Iterator[tuple[int, dict[str, Any]]]:
        """Yield the time, ns since the start, and the content of each message of a topic."""
        for name, message in self.messages():
            if name == topic:
                yield message.log_time - self.started_unix_ns, json.loads(message.data)

    @cached_property
    def events(self) -> list[tuple[int, str]]:
        """For each event: its time, ns since the start of the run, and its text."""
        return [(time_ns, content["message"]) for time_ns, content in self.contents("/event")]

    def messages(self) -> Iterator[tuple[str, Message]]:
        """Yield all messages with their topics, in the order of the file; skip damaged chunks."""
        topics: dict[int, str] = {}
        self.damaged_chunks = 0
        for record in self._records():
            if not isinstance(record, Chunk):
                continue
            try:
                parts = breakup_chunk(record, validate_crc=True)
            # Damaged bytes can raise any exception in decompressors and parsers.
            except Exception:
                self.damaged_chunks += 1
                continue
            for part in parts:
                if isinstance(part, Channel):
                    topics[part.id] = part.topic
                elif isinstance(part, Message) and part.channel_id in topics:
                    yield topics[part.channel_id], part

    def _records(self) -> Iterator[McapRecord]:
        """Yield all records up to the end of the file, or up to a cut or damage."""
        try:
            with open_file(self.path, RecordingError, _MOST_BYTES) as file:
                if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                    raise RecordingError(f"{self.path} is not an MCAP file")
                file.seek(0)
                reader = StreamReader(file, emit_chunks=True, record_size_limit=_MOST_RECORD_BYTES)
                yield from reader.records
                self._ended = True
        except OSError as error:
            raise unreadable(RecordingError, self.path, error) from None
        except RecordingError:
            raise
        # Missing or damaged bytes can raise any exception in the parser.
        except Exception:
            return


def load_recording(path: Path | str) -> RecordedRun:
    """Open a recording as arrays: currents, activation, times, force, events, settings.

    Parameters
    ----------
    path : Path or str
        Path of the recording. If the file is cut or damaged, all complete steps are read.

    Returns
    -------
    RecordedRun
        Recording, with ``arrays`` (`RunArrays`): for example ``current_ua``, (S, E) int16, µA, and
        ``time_ns``, (N,) int64, ns since the start of the run.

    Raises
    ------
    RecordingError
        If the file does not exist or is not a recording.

    Examples
    --------
    >>> import smarttouch as st, tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "run.mcap"
    >>> statistics = st.run("text:a", "simulated:", seconds=0.5, listeners=[st.Recorder(path)])
    >>> run = st.load_recording(path).arrays
    >>> run.activation.shape, run.current_ua.shape[1]
    ((25, 3, 64), 64)
    """
    return RecordedRun(path)
