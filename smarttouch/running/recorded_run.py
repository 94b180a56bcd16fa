"""A recording as arrays, for programs that analyze it."""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

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
_COMPUTED = {
    "step", "sent", "first_pulse_us", "activation", "first_slot", "recharge_ua", "volts",
    "volts_step", *_SLOTS,
}  # fmt: skip
_NUMBERS = [each.name for each in fields(RunArrays) if each.name not in _COMPUTED]
"""Arrays of the numbers that a step's message has by the same name."""


def _arrays(steps: Iterator[RecordedStep], electrodes: int) -> RunArrays:
    columns: dict[str, list[Any]] = {each.name: [] for each in fields(RunArrays)}
    row_of: dict[int | None, int] = {}  # by the board's number
    index_of: dict[int, int] = {}  # by the time of the sequence
    columns["first_slot"].append(0)
    for row, recorded in enumerate(steps):
        step, sent, sequence = recorded.step, recorded.sent, recorded.step.sequence
        for name in _NUMBERS:
            columns[name].append(recorded.message[name])
        columns["step"].append(recorded.index)
        columns["sent"].append(-1 if sent.number is None else sent.number)
        columns["first_pulse_us"].append(np.nan)
        columns["activation"].append(step.tactile.activation)
        recharge_ua = sequence.recharge_ua
        columns["recharge_ua"].append(np.zeros(electrodes) if recharge_ua is None else recharge_ua)
        for name in _SLOTS:
            columns[name].append(getattr(sequence, name).ravel())
        columns["first_slot"].append(columns["first_slot"][-1] + sequence.slots)
        row_of[sent.number] = row
        if sent.first_pulse is not None and sent.first_pulse.number in row_of:
            pulsed = row_of[sent.first_pulse.number]
            columns["first_pulse_us"][pulsed] = sent.first_pulse.latency_us
        index_of[sequence.time_ns] = recorded.index
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


class RecordedRun(Recording):
    """A recording, with its numbers as arrays: returned by `smarttouch.load_recording`.

    Attributes
    ----------
    path : Path
    """

    def __repr__(self) -> str:
        return f"RecordedRun({str(self.path)!r}, {self.seconds:.1f} s)"

    @cached_property
    def arrays(self) -> RunArrays:
        """All numbers of the run, read at their first use."""
        return _arrays(self.steps(), len(self.profile.electrodes))

    def images(self) -> Iterator[NDArray[np.uint8] | None]:
        """Yield the image of each step, (H, W) uint8; None where there is none."""
        for each in self.steps():
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
