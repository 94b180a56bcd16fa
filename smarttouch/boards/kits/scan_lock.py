"""Bounds on the scan times of a free-running board that does not report them."""

import math
from dataclasses import dataclass

TOLERANCE = 200e-6  # of the ratio of two free-running clocks, each within 100 ppm
WIDEST = 0.25  # part of a period: a scan's start with a larger uncertainty counts as unknown


@dataclass(frozen=True)
class Span:
    """Earliest and latest possible time of an event, ns."""

    early: int
    late: int


class ScanLock:
    """Bounds on the start of each scan of a board, learned from brackets.

    A bracket says that a scan started after one moment and before another. Both are certain,
    however late the host woke up. So are the bounds on the scans after it, as the board's period
    is known within the tolerance of two clocks.

    Attributes
    ----------
    period_ns : int
        Period of the scans.
    last : Span or None
        Start of the scan of the last bracket, which has number 0; None if it is not known.
    """

    def __init__(self, period_ns: int) -> None:
        self.period_ns: int = period_ns
        self.last: Span | None = None

    def scan(self, number: int) -> Span:
        """Return when a scan starts; ``last`` must be known."""
        assert self.last is not None
        away_ns = number * self.period_ns
        unsure_ns = math.ceil(abs(away_ns) * TOLERANCE)
        return Span(self.last.early + away_ns - unsure_ns, self.last.late + away_ns + unsure_ns)

    def first_after(self, time_ns: int) -> int:
        """Return the number of the first scan that certainly starts after a moment."""
        number = self._near(time_ns) - 1
        while self.scan(number).early <= time_ns:
            number += 1
        return number

    def starts(self, begin: Span, end: Span) -> tuple[int, int]:
        """Return the least and the largest number of scans that started between two events."""
        if self.last is None:
            least = max(0, end.early - begin.late) / self.period_ns * (1 - TOLERANCE)
            most = max(0, end.late - begin.early) / self.period_ns * (1 + TOLERANCE)
            return math.floor(least), math.floor(most) + 1
        first, last = self._near(begin.early) - 1, self._near(end.late) + 1
        scans = [self.scan(number) for number in range(first, last + 1)]
        return (
            sum(each.early >= begin.late and each.late <= end.early for each in scans),
            sum(each.late > begin.early and each.early < end.late for each in scans),
        )

    def learn(self, bracket: Span) -> None:
        """Take a bracket in which a scan started; one that is too wide is ignored."""
        if self.last is None:
            if bracket.late - bracket.early <= WIDEST * self.period_ns:
                self.last = bracket
            return
        near = self._near((bracket.early + bracket.late) // 2)
        scans = [self.scan(number) for number in (near - 1, near, near + 1)]
        spans = [Span(max(s.early, bracket.early), min(s.late, bracket.late)) for s in scans]
        possible = [span for span in spans if span.early <= span.late]
        if not possible:
            # It contradicts the bounds: the board was restarted, or stood still.
            self.last = None
        elif len(possible) == 1:
            self.last = possible[0]

    def check(self, time_ns: int) -> None:
        """Forget the scans if their starts have become too uncertain by now."""
        if self.last is not None:
            scan = self.scan(self._near(time_ns))
            if scan.late - scan.early > WIDEST * self.period_ns:
                self.last = None

    def _near(self, time_ns: int) -> int:
        assert self.last is not None
        return round((time_ns - (self.last.early + self.last.late) / 2) / self.period_ns)
