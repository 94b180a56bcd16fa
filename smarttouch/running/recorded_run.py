"""A recording as arrays, for programs that analyze it."""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from smarttouch.profile import Profile
from smarttouch.running.recording import Recording
from smarttouch.running.step_messages import RecordedStep


@dataclass(frozen=True, eq=False)
class RunArrays:
    """All numbers of a run; the page *Recorded data* lists shapes, units and meanings."""

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
    volts: NDArray[np.float32]
    volts_step: NDArray[np.int64]


_SLOTS = ("current_ua", "width_us", "discharge_us", "site")


def _arrays(steps: Iterator[RecordedStep], electrodes: int) -> RunArrays:
    columns: dict[str, list[Any]] = {each.name: [] for each in fields(RunArrays)}
    row_of: dict[int | None, int] = {}  # by the board's number
    index_of: dict[int, int] = {}  # by the time of the sequence
    columns["first_slot"].append(0)
    for row, recorded in enumerate(steps):
        step, sent = recorded.step, recorded.sent
        for name, value in _values(recorded, electrodes).items():
            columns[name].append(value)
        for name in _SLOTS:
            columns[name].append(getattr(step.sequence, name).ravel())
        columns["first_slot"].append(columns["first_slot"][-1] + step.sequence.slots)
        row_of[sent.number] = row
        if sent.first_pulse is not None and sent.first_pulse.number in row_of:
            pulsed = row_of[sent.first_pulse.number]
            columns["first_pulse_us"][pulsed] = sent.first_pulse.latency_us
        index_of[step.sequence.time_ns] = recorded.index
        for measured, volts in step.observed:
            columns["volts"].append(volts)
            columns["volts_step"].append(index_of.get(measured.time_ns, -1))
    sides = {
        "current_ua": (electrodes,),
        "activation": (3, electrodes),
        "recharge_ua": (electrodes,),
    }
    arrays = {}
    for each in fields(RunArrays):
        # A dtype before NumPy 2.5, and its scalar from then on.
        kind: Any = get_args(each.type)[-1]
        kind = (get_args(kind) or (kind,))[0]
        values: Any = columns[each.name]
        if each.name in (*_SLOTS, "volts"):
            values = np.concatenate([np.empty(0, kind), *values])
        arrays[each.name] = np.array(values, kind).reshape(-1, *sides.get(each.name, ()))
    return RunArrays(**arrays)


def _values(recorded: RecordedStep, electrodes: int) -> dict[str, Any]:
    """Return the numbers of one step."""
    step, sent, sequence, given = (
        recorded.step, recorded.sent, recorded.step.sequence, recorded.step.input,
    )  # fmt: skip
    recharge_ua = sequence.recharge_ua
    return {
        "step": recorded.index,
        "mode": step.mode.value,
        "sent": -1 if sent.number is None else sent.number,
        "first_pulse_us": np.nan,
        "activation": step.tactile.activation,
        "recharge_us": sequence.recharge_us,
        "recharge_ua": np.zeros(electrodes, np.int16) if recharge_ua is None else recharge_ua,
        **{name: getattr(step, name) for name in ("level", "restarted", "asked_us")},
        **{name: getattr(sequence, name) for name in ("intensity", "period_us")},
        **{
            name: getattr(given, name)
            for name in ("time_ns", "number", "force_n", "age_ns", "stale")
        },
        **{name: getattr(given.pose, name) for name in ("x_mm", "y_mm", "angle_rad")},
        **{
            name: getattr(sent, name)
            for name in ("clock_ns", "latency_us", "work_us", "acknowledged", "refused")
        },
    }


class RecordedRun:
    """A recording, with its numbers as arrays: returned by `smarttouch.load_recording`.

    Attributes
    ----------
    path : Path
    arrays : RunArrays
        All numbers of the run; read at their first use.
    """

    def __init__(self, path: Path | str) -> None:
        self.path: Path = Path(path)
        self._recording = Recording(self.path)

    def __repr__(self) -> str:
        return f"RecordedRun({str(self.path)!r}, {self.seconds:.1f} s)"

    @property
    def profile(self) -> Profile:
        """Device and finger of the run."""
        return self._recording.profile

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the run."""
        return self._recording.settings

    @property
    def seconds(self) -> float:
        """Time from the start of the run to its last message, s."""
        return self._recording.duration_s

    @property
    def whole(self) -> bool:
        """Whether it ended properly, and everything read so far was intact."""
        return self._recording.whole

    @cached_property
    def arrays(self) -> RunArrays:
        """All numbers of the run."""
        return _arrays(self._recording.steps(), len(self.profile.electrodes))

    @cached_property
    def events(self) -> list[tuple[int, str]]:
        """Time of each event since the start of the run, ns, and its words."""
        return [*self._recording.events()]

    def images(self) -> Iterator[NDArray[np.uint8] | None]:
        """Yield the image of each step, (H, W) uint8; None where there is none."""
        for each in self._recording.steps():
            yield each.step.input.image


def load_recording(path: Path | str) -> RecordedRun:
    """Open a recording as arrays: currents, activation, times, force, events, settings.

    Parameters
    ----------
    path : Path or str
        A recording. A cut or damaged one gives every step that is complete.

    Returns
    -------
    RecordedRun
        Its ``arrays`` are a `RunArrays`, which lists shapes and units: for example ``current_ua``,
        (S, E) int16, µA, and ``time_ns``, (N,) int64, ns since the start of the run.

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
