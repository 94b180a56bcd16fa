"""Intensity: gated by finger force, and never rising suddenly."""

import math

from smarttouch.profile import ForceLaw
from smarttouch.stimulation.safety_gate import Rise
from smarttouch.stimulation.safety_limits import PPB, parts_per_billion

KEPT_NS = 14_000_000_000
"""Time without pulses for which an intensity is kept; the safety gate keeps it a second longer."""
FIRST_NS = 20_000_000
MOST_STEP_NS = 80_000_000
"""Part of the ramp at which the first pulses begin: one step, and more only where that is too weak
for any pulse; and the largest step from one sequence to the next."""
MOST_AHEAD_NS = 85_000_000
"""Part of the ramp by which pulses may be stronger than what has flowed. The gate lets 100 ms of it
be caught up."""


def force_gate(force_n: float, law: ForceLaw) -> float:
    """Return the intensity at a finger force, in [0, 1].

    Zero below contact, one from full force on, rising linearly or with the logarithm of force in
    between (paper, Section IV-B). A force of NaN is no contact.
    """
    if not force_n > law.contact_n:
        return 0.0
    if force_n >= law.full_n:
        return 1.0
    if law.law == "linear":
        return (force_n - law.contact_n) / (law.full_n - law.contact_n)
    return math.log(force_n / law.contact_n) / math.log(law.full_n / law.contact_n)


class SoftStart:
    """Rate limiter by which intensity rises from zero to full in `ramp_s`, and falls at once.

    Time counts only while pulses flow, as in the safety gate (`Rise`), and the intensity reached is
    kept for `KEPT_NS` without pulses. Strong pulses after weak ones rise from those.
    """

    _reached: float
    _asked: float
    _of_vibration: float
    _since_ns: int
    _left_ns: int
    _first_ns: int
    _time_ns: int | None

    def __init__(self, ramp_s: float) -> None:
        self._ramp_s = ramp_s
        self._rise = Rise(round(1e9 * ramp_s))
        self._ahead_ppb = MOST_AHEAD_NS * PPB // round(1e9 * ramp_s)
        self.restart()

    def follow(self, wanted: float, time_ns: int, current: bool = True) -> float:
        """Return the intensity allowed at ``time_ns``; the first is always zero.

        Where time goes back, as in an edited file, intensity does not rise. For vibration alone
        (`current` false) time counts as it passes.
        """
        first, elapsed_ns = self._time_ns is None, time_ns - (self._time_ns or 0)
        self._time_ns = time_ns
        if first:
            return 0.0
        self._of_vibration = min(
            wanted, self._of_vibration + max(0, elapsed_ns) / 1e9 / self._ramp_s
        )
        if not current:
            return self._of_vibration
        gone_ns = max(0, time_ns - self._since_ns)
        if gone_ns > self._left_ns + KEPT_NS:
            self._reached, self._left_ns = 0.0, 0
        if self._reached >= wanted:
            self._reached = self._asked = wanted
            return wanted
        # What was reached without pulses is lost, all but the first step.
        step = min(gone_ns, self._left_ns, MOST_STEP_NS)
        step = max(step, 0 if self._reached else self._first_ns)
        self._asked = min(wanted, self._reached + step / 1e9 / self._ramp_s)
        return self._asked

    @property
    def most_ppb(self) -> int | None:
        """Greatest strength (`SafetyLimits.strength_ppb`) with which pulses may begin now; None
        where no less has flowed than was last returned."""
        risen_ppb = 0 if self._time_ns is None else self._rise.risen_ppb(self._time_ns)
        if parts_per_billion(self._asked) <= risen_ppb:
            return None
        return risen_ppb + self._ahead_ppb

    def open_level(self, time_ns: int) -> float:
        """Return the intensity that pulses of any strength may begin with, in [0, 1]."""
        if self._time_ns is None or time_ns - self._since_ns > self._left_ns + KEPT_NS:
            return 0.0
        return min(self._reached, self._rise.risen_ppb(time_ns) / PPB)

    def note(self, period_us: int, intensity: float, strength_ppb: int) -> None:
        """Store the period of the sequence of the last intensity, what it claims (less where that
        was too strong) and its strength; 0 if it has no current although points are active."""
        if strength_ppb and self._time_ns is not None:
            self._reached, self._since_ns = intensity, self._time_ns
            self._left_ns, self._first_ns = 1000 * period_us, FIRST_NS
            ppb = parts_per_billion(intensity)
            self._rise.note(ppb, strength_ppb, self._time_ns, 1000 * period_us)
        else:
            self._first_ns = min(2 * self._first_ns, MOST_STEP_NS)

    def restart(self) -> None:
        """Restart: the next intensity is zero."""
        self._reached = self._asked = self._of_vibration = 0.0
        self._since_ns = self._left_ns = 0
        self._first_ns = FIRST_NS
        self._time_ns = None
        self._rise.restart()
