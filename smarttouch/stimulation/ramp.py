"""The ramp: how strong current may be, by what has flowed since it was zero."""

from smarttouch.base.clock import LATE_NS
from smarttouch.stimulation.safety_limits import PPB

LEEWAY_PPB = 1000  # tolerance for rounding
LEVEL_KEPT_NS = 15_000_000_000
"""Time without current for which a level stays open: an experiment waits for an answer so long
while the finger stays in contact."""
PLANNED_KEPT_NS = LEVEL_KEPT_NS - 1_000_000_000
"""The same for planning: what is written a little later must find the level open."""
FIRST_NS = 20_000_000
MOST_STEP_NS = 80_000_000
"""Part of the ramp at which the first pulses begin, unless that is too weak for any pulse; and the
largest step from one sequence to the next."""
AHEAD_NS = 85_000_000
"""Part of the ramp by which pulses may be planned stronger than what has flowed: 100 ms may be
caught up, and a sequence may be written late."""


class Ramp:
    """Level that written sequences have opened, in whole parts per billion of full strength.

    Only the time of passes with current counts, no more of it than has gone by, and up to their
    strength (`SafetyLimits.strength_ppb`). A level stays open for `LEVEL_KEPT_NS` after the last
    of it, and weak current does not lower it. One late step may be caught up. From zero to full it
    takes ``ramp_ns`` or longer.
    """

    def __init__(self, ramp_ns: int) -> None:
        self._ramp_ns = ramp_ns
        self._late_ppb = LATE_NS * PPB // ramp_ns
        self.restart()

    def restart(self) -> None:
        """Restart at zero: the next sequence must be without current."""
        self._begun = False
        self._level_ppb = self._strength_ppb = self._since_ns = self._left_ns = 0
        self._claimed_ppb = 0

    def claim(self, ppb: int, strength_ppb: int) -> None:
        """Enter a sequence that is proved, and may not be written yet, for planning.

        The next intensity is planned from its own, 0 where a finger was lifted.
        """
        self._begun = True
        self._claimed_ppb = ppb if strength_ppb else min(ppb, self._claimed_ppb)

    def open_ppb(self, now_ns: int, kept_ns: int = LEVEL_KEPT_NS) -> int:
        """Return the level that is open now, without what may be caught up."""
        gone_ns = now_ns - self._since_ns
        if gone_ns > self._left_ns + kept_ns:
            return 0
        flowed_ns = max(0, min(gone_ns, self._left_ns))
        risen_ppb = self._level_ppb + flowed_ns * PPB // self._ramp_ns
        return max(self._level_ppb, min(self._strength_ppb, risen_ppb))

    def open_level(self, now_ns: int) -> float:
        """Return the strength, in [0, 1], with which pulses may go on after a pause."""
        return min(self._claimed_ppb, self.open_ppb(now_ns, PLANNED_KEPT_NS)) / PPB

    def allowed_level(self, now_ns: int) -> float:
        """Return the strength, in [0, 1], to plan for a sequence that begins now."""
        if not self._begun:
            return 0.0
        open_ppb = self.open_ppb(now_ns, PLANNED_KEPT_NS)
        if not open_ppb:
            return FIRST_NS / self._ramp_ns
        # Time counts while pulses flow.
        step_ns = min(now_ns - self._since_ns, self._left_ns, MOST_STEP_NS)
        step_ns = max(step_ns, 0 if self._claimed_ppb else FIRST_NS)
        risen_ppb = self._claimed_ppb + step_ns * PPB // self._ramp_ns
        return min(PPB, risen_ppb, open_ppb + AHEAD_NS * PPB // self._ramp_ns) / PPB

    def permits(self, strength_ppb: int, now_ns: int) -> bool:
        """Return whether current of a strength may begin now: `LATE_NS` may be caught up."""
        most_ppb = self.open_ppb(now_ns) + self._late_ppb if self._begun else 0
        return strength_ppb <= most_ppb + LEEWAY_PPB

    def note(self, ppb: int, strength_ppb: int, now_ns: int, lasting_ns: int) -> None:
        """Enter a sequence whose bytes have just been written, by the intensity that it claims,
        which lowers the level, its strength, above which it raises none, and the time of its
        passes, all repetitions included."""
        # The board finishes its present pass, and of repetitions no more.
        gone_ns = max(0, now_ns - self._since_ns)
        left_ns = self._left_ns - gone_ns
        to_come_ns = min(left_ns, LATE_NS) if left_ns > 0 else 0
        if strength_ppb:
            if ppb > self._level_ppb or -left_ns > LEVEL_KEPT_NS:
                ppb = min(ppb, self.open_ppb(now_ns))
            self._level_ppb, self._strength_ppb = ppb, strength_ppb
            self._since_ns, self._left_ns = now_ns, to_come_ns + lasting_ns
        else:
            self._left_ns = min(self._left_ns, gone_ns + to_come_ns)
