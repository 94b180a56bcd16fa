"""Rise of intensity by a display's clock, which may catch up by no more than one late step."""

from smarttouch.clock import LATE_NS
from smarttouch.stimulation.limits import PPB

LEEWAY_PPB = 1000
"""Tolerance for rounding in the ramp's sum."""


class Rise:
    """Highest intensity allowed since it was zero, in whole parts per billion.

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
        hurried_ppb = LATE_NS * PPB // self._ramp_ns
        return ppb - LEEWAY_PPB <= self.risen_ppb(now_ns) + hurried_ppb

    def note(self, ppb: int, now_ns: int) -> None:
        """Take down an intensity that has begun; what it fell short of or hurried is kept."""
        self._ppb = min(self.risen_ppb(now_ns), ppb)
        self._since_ns = now_ns
