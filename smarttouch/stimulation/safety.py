"""The safety gate, which validates every limit on a frozen copy of each scan sequence."""

from threading import Lock
from typing import Any, Protocol

import numpy as np

from smarttouch.clock import LATE_NS
from smarttouch.errors import SafetyError
from smarttouch.stimulation.exposure import Dose, Exposure
from smarttouch.stimulation.limits import PPB, SafetyLimits, parts_per_billion
from smarttouch.stimulation.sequence import ScanSequence
from smarttouch.stimulation.sequence_limits import prove_fields, prove_slots
from smarttouch.stimulation.sums import SlotAdder

__all__ = ["SafetyGate", "SafetyLimits"]

LEEWAY_PPB = 1000
"""Tolerance for rounding in the ramp's sum."""

_ARRAYS = tuple(
    (name, np.dtype(kind), dimensions, of_slots)
    for name, kind, dimensions, of_slots in (
        ("current_ua", np.int16, 2, True),
        ("width_us", np.uint16, 1, True),
        ("discharge_us", np.uint16, 1, True),
        ("site", np.uint16, 1, True),
        ("vibration", np.float32, 1, False),
        ("recharge_ua", np.int16, 1, False),
    )
)
"""Arrays of a sequence: type, dimensions, and whether they have a row for each slot; the others
may be None."""
_WHOLE = ("period_us", "time_ns", "recharge_us")


class Now(Protocol):
    """Clock of the gate."""

    def now_ns(self) -> int: ...


class Rise:
    """Highest intensity allowed since it was zero, in whole parts per billion.

    By a display's clock it may catch up by no more than one late step.

    Parameters
    ----------
    ramp_ns : int
        Least time from zero to full.
    """

    def __init__(self, ramp_ns: int) -> None:
        self._ramp_ns = ramp_ns
        self.restart()

    def restart(self) -> None:
        """Begin anew at zero."""
        self._ppb = 0
        self._since_ns: int | None = None

    def risen_ppb(self, now_ns: int) -> int:
        """Return how far it may have risen by now without having to catch up."""
        if self._since_ns is None:
            return self._ppb
        return min(PPB, self._ppb + max(0, now_ns - self._since_ns) * PPB // self._ramp_ns)

    def permits(self, ppb: int, now_ns: int) -> bool:
        """Whether an intensity may begin now: `LATE_NS` of the ramp at most are caught up."""
        if ppb <= self._ppb:
            return True
        hurried_ppb = LATE_NS * PPB // self._ramp_ns
        return ppb - LEEWAY_PPB <= self.risen_ppb(now_ns) + hurried_ppb

    def note(self, ppb: int, now_ns: int) -> None:
        """Take down an intensity that has begun; what it fell short of or hurried is kept."""
        self._ppb = ppb if ppb <= self._ppb else min(self.risen_ppb(now_ns), ppb)
        self._since_ns = now_ns


class SafetyGate:
    """Validator of successive sequences, on the clock of the display that it guards.

    Parameters
    ----------
    limits : SafetyLimits
        Limits of every sequence.
    clock : Now, optional
        The display's. Without one, for checks that reach no board, time is what each
        sequence claims.
    """

    def __init__(self, limits: SafetyLimits, clock: Now | None = None) -> None:
        self.limits = limits
        self._clock = clock
        self._exposure = Exposure(limits)
        self._adder = SlotAdder(limits.felt_ua)
        self._lock = Lock()
        self._now_ns: int | None = None
        self._rise = Rise(limits.ramp_ns)
        self.restart()

    @property
    def dose(self) -> Dose:
        """Dose of the session."""
        return self._exposure.dose

    def restart(self) -> None:
        """Restart at intensity zero; sequence time may start anew, the session continues."""
        self._intensity_ppb = 0
        self._rise.restart()
        self._time_ns: int | None = None
        if self._clock is None:
            self._now_ns = None
            self._exposure.forget_second()

    def begin_session(self) -> None:
        """Start at intensity zero with a dose of zero; the last second still counts."""
        self.restart()
        self._exposure.begin_session()

    def prove(self, sequence: ScanSequence, times: int = 1) -> ScanSequence:
        """Return a frozen copy of a sequence, or raise if it breaks a limit.

        Raises
        ------
        SafetyError
            Naming the limit, the slot and electrode, and by how much.
        """
        return self._prove(sequence, times, ramped=True)

    def prove_measurement(self, sequence: ScanSequence) -> ScanSequence:
        """Return a frozen copy of a scan; every limit is checked but the rise since the one before.

        For boards that measure with a pulse that their firmware fixes: it cannot
        be ramped, and comes only when a user asks for it.
        """
        return self._prove(sequence, 1, ramped=False)

    def _prove(self, given: ScanSequence, times: int, *, ramped: bool) -> ScanSequence:
        # What is added up is added up in memory that the next sequence will use again.
        with self._lock:
            sequence, limits = frozen(given), self.limits
            prove_fields(sequence, limits)
            ppb = parts_per_billion(sequence.intensity)
            load = prove_slots(sequence, limits, ppb, self._adder)
            now_ns = sequence.time_ns if self._clock is None else self._clock.now_ns()
            # A clock that falls counts as standing still.
            now_ns = now_ns if self._now_ns is None else max(now_ns, self._now_ns)
            if ramped:
                self._prove_rise(sequence, ppb, now_ns)
            flows = len(sequence.width_us) > 0
            self._exposure.enter(now_ns, sequence.period_us, times, load, flows=flows)
            self._now_ns = now_ns
            if ramped:
                self._intensity_ppb, self._time_ns = ppb, sequence.time_ns
                self._rise.note(ppb, now_ns)
            return sequence

    def _prove_rise(self, sequence: ScanSequence, ppb: int, now_ns: int) -> None:
        """Raise if intensity rises too fast, by the time sequences claim or the display's."""
        limits, before_ns = self.limits, self._time_ns
        if before_ns is not None and sequence.time_ns <= before_ns:
            raise SafetyError(
                f"sequence at {sequence.time_ns} ns does not follow the one at {before_ns} ns",
                limit="time_ns",
                value=sequence.time_ns,
                allowed=before_ns + 1,
            )
        claimed_ns = 0 if before_ns is None else sequence.time_ns - before_ns
        above = ppb - LEEWAY_PPB - self._intensity_ppb
        if above * limits.ramp_ns > claimed_ns * PPB or not self._rise.permits(ppb, now_ns):
            raise SafetyError(
                f"intensity rises from {self._intensity_ppb / PPB:.3f} to {ppb / PPB:.3f}: "
                f"zero to full must take {limits.ramp_s:g} s or more",
                limit="ramp_s",
                value=ppb / PPB,
                allowed=min(self._intensity_ppb, self._rise.risen_ppb(now_ns)) / PPB,
            )


def frozen(sequence: ScanSequence) -> ScanSequence:
    """Return an immutable copy: arrays backed by bytes, and plain whole numbers.

    Raises
    ------
    SafetyError
        If a field has another type or shape than it should.
    """
    fields: dict[str, Any] = {"proof": sequence.proof, "sums": sequence.sums}
    slots: int | None = None
    for name, kind, dimensions, of_slots in _ARRAYS:
        values = getattr(sequence, name)
        if values is None and not of_slots:
            continue
        # As a plain array: a class of somebody else's may answer for another array than it is.
        plain = values if type(values) is np.ndarray else None
        if plain is None and isinstance(values, np.ndarray):
            plain = np.asarray(values)
        if (
            plain is None
            or plain.dtype != kind
            or plain.ndim != dimensions
            or (of_slots and slots is not None and len(plain) != slots)
        ):
            found = type(values).__name__ if plain is None else f"{plain.dtype} {plain.shape}"
            of = "" if slots is None or not of_slots else f" of {slots} slots"
            raise SafetyError(
                f"{name} is {found}, must be {kind} in {dimensions} "
                f"dimension{'s' * (dimensions > 1)}{of}",
                limit=name,
            )
        slots = len(plain) if slots is None else slots
        flat = np.frombuffer(plain.tobytes(), kind)
        fields[name] = flat if dimensions == 1 else flat.reshape(plain.shape)
    for name in _WHOLE:
        fields[name] = value = getattr(sequence, name)
        if type(value) is int:
            continue
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
            raise SafetyError(f"{name} is {value!r}, must be a whole number", limit=name)
        fields[name] = int(value)
    value = sequence.intensity
    if isinstance(value, bool) or not isinstance(value, (int, float, np.floating)):
        raise SafetyError(f"intensity is {value!r}, must be a number", limit="intensity")
    try:
        intensity = float(value)
    except OverflowError:
        raise SafetyError(
            "intensity is beyond all numbers, must be one", limit="intensity"
        ) from None
    return ScanSequence(**fields, intensity=intensity)
