"""The safety gate, which validates every limit on a frozen copy of each scan sequence."""

from threading import Lock
from typing import Protocol

from smarttouch.errors import SafetyError
from smarttouch.stimulation.exposure import Dose, Exposure
from smarttouch.stimulation.limits import PPB, SafetyLimits, parts_per_billion
from smarttouch.stimulation.rise import LEEWAY_PPB, Rise
from smarttouch.stimulation.sequence import ScanSequence, frozen
from smarttouch.stimulation.sequence_limits import prove_fields, prove_slots
from smarttouch.stimulation.sums import SlotAdder

__all__ = ["SafetyGate", "SafetyLimits"]


class Now(Protocol):
    """Clock of the gate."""

    def now_ns(self) -> int: ...


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
            return self._proved(frozen(given), times, ramped=ramped)

    def _proved(self, sequence: ScanSequence, times: int, *, ramped: bool) -> ScanSequence:
        prove_fields(sequence, self.limits)
        ppb = parts_per_billion(sequence.intensity)
        load = prove_slots(sequence, self.limits, ppb, self._adder)
        now_ns = self._read_clock(sequence)
        if ramped:
            self._prove_rise(sequence, ppb, now_ns)
        flows = sequence.slots > 0
        self._exposure.enter(now_ns, sequence.period_us, times, load, flows=flows)
        self._now_ns = now_ns
        if ramped:
            self._intensity_ppb, self._time_ns = ppb, sequence.time_ns
            self._rise.note(ppb, now_ns)
        return sequence

    def _read_clock(self, sequence: ScanSequence) -> int:
        """Return the display's time; a clock that falls counts as standing still."""
        now_ns = sequence.time_ns if self._clock is None else self._clock.now_ns()
        return now_ns if self._now_ns is None else max(now_ns, self._now_ns)

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
