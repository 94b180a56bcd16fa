"""A recording as arrays, for programs that analyze it."""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from smarttouch.profile import Profile
from smarttouch.running.recording_reader import Recording
from smarttouch.running.step_decoder import RecordedStep


@dataclass(frozen=True, eq=False)
class RunArrays:
    """All numbers of a run: N steps, S slots one after another, E electrodes.

    Attributes
    ----------
    step, time_ns, clock_ns : ndarray, (N,) int64
        Number from 0, the sum of all periods before it, and the real time since the start.
    number : ndarray, (N,) int64
        Of the image or stimulus at its source: the same is the same again.
    mode : ndarray, (N,) str
    level, intensity : ndarray, (N,) float64, in [0, 1]
        What the user asked for, and what was reached.
    restarted : ndarray, (N,) bool
        Whether intensity began at zero with the step.
    asked_us, period_us : ndarray, (N,) int64
        To the next sequence: as rates ask, and as it was.
    force_n, x_mm, y_mm, angle_rad : ndarray, (N,) float64
        Force that counted, place on the page, and turn, clockwise.
    age_ns, stale : ndarray, (N,) int64 and bool
        Age of the input, and whether its source was silent.
    latency_us, work_us : ndarray, (N,) float64
        From the input in hand to the last byte written, and processor time of the loop.
    sent : ndarray, (N,) int64
        The board's number of the sequence; -1 where the board was lost with it.
    acknowledged, refused : ndarray, (N,) int64
        Sequences that the board had begun, or declined, until then.
    first_pulse_us : ndarray, (N,) float64
        From the taking of the image to its first pulse; NaN if the board did not say.
    activation : ndarray, (N, 3, E) float32
        Of RA, SAI and PC.
    first_slot : ndarray, (N + 1,) int64
        The slots of step n are ``first_slot[n]`` to ``first_slot[n + 1]``.
    current_ua : ndarray, (S, E) int16
        Positive cathodic.
    width_us, discharge_us, site : ndarray, (S,) uint16
    recharge_us, recharge_ua : ndarray, (N,) int64 and (N, E) int16
        Recharge phases; zero where there is none.
    volts, volts_step : ndarray, (V,) float32, and (M,) int64
        Measured voltage of each slot of M steps, one after another, and these steps; -1 if unknown.
    """

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


class ArrayCollector:
    """Collects the arrays of a run step by step."""

    def __init__(self, electrodes: int) -> None:
        self._electrodes = electrodes
        self._columns: dict[str, list[Any]] = {each.name: [] for each in fields(RunArrays)}
        self._columns["first_slot"] = [0]
        self._step_at: dict[int, int] = {}
        self._step_of: dict[int, int] = {}

    def add(self, recorded: RecordedStep) -> None:
        """Add a step."""
        step, columns = recorded.step, self._columns
        sequence, given, sent = step.sequence, step.input, recorded.sent
        none = np.zeros(self._electrodes, np.int16)
        pose = given.pose
        row = {
            "step": recorded.index, "time_ns": given.time_ns,
            "clock_ns": sent.clock_ns, "number": given.number,
            "mode": step.mode.value, "level": step.level, "intensity": sequence.intensity,
            "restarted": step.restarted, "asked_us": step.asked_us,
            "period_us": sequence.period_us, "force_n": given.force_n, "x_mm": pose.x_mm,
            "y_mm": pose.y_mm, "angle_rad": pose.angle_rad, "age_ns": given.age_ns,
            "stale": given.stale, "latency_us": sent.latency_us, "work_us": sent.work_us,
            "sent": -1 if sent.number is None else sent.number,
            "acknowledged": recorded.acknowledged, "refused": recorded.refused,
            "first_pulse_us": np.nan, "activation": step.tactile.activation,
            "first_slot": columns["first_slot"][-1] + sequence.slots,
            "recharge_us": sequence.recharge_us,
            "recharge_ua": none if sequence.recharge_ua is None else sequence.recharge_ua,
        }  # fmt: skip
        for name, value in row.items():
            columns[name].append(value)
        for name in _SLOTS:
            columns[name].append(getattr(sequence, name))
        if sent.number is not None:
            self._step_of[sent.number] = len(columns["step"]) - 1
        pulse = sent.first_pulse
        if pulse is not None and pulse.number in self._step_of:
            columns["first_pulse_us"][self._step_of[pulse.number]] = pulse.latency_us
        self._step_at[sequence.time_ns] = recorded.index
        for measured, volts in step.observed:
            columns["volts"].append(volts)
            columns["volts_step"].append(self._step_at.get(measured.time_ns, -1))

    def arrays(self) -> RunArrays:
        """Return what was collected."""
        count, made = self._electrodes, dict[str, Any]()
        sides = {"current_ua": (count,), "activation": (3, count), "recharge_ua": (count,)}
        for each in fields(RunArrays):
            values: Any = self._columns[each.name]
            # A dtype before NumPy 2.5, and its scalar from then on.
            kind: Any = get_args(each.type)[-1]
            kind = (get_args(kind) or (kind,))[0]
            if each.name in (*_SLOTS, "volts"):
                values = np.concatenate([np.empty(0, kind), *map(np.ravel, values)])
            made[each.name] = np.array(values, kind).reshape(-1, *sides.get(each.name, ()))
        return RunArrays(**made)


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
        collector = ArrayCollector(len(self.profile.electrodes))
        for each in self._recording.steps():
            collector.add(each)
        return collector.arrays()

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
