"""Estimate of the scan times of a free-running board that does not report them."""

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
    however late the host woke up, and so are the bounds on all other scans, as the board's period
    is known within the tolerance of two clocks. Every bracket narrows them.
    """

    def __init__(self, period_ns: int) -> None:
        self.nominal_ns = period_ns
        self.forget()

    @property
    def locked(self) -> bool:
        return self.last is not None

    def forget(self) -> None:
        """Reset to the nominal period."""
        nominal_ns = self.nominal_ns
        # Shortest and longest by the host's clock.
        self.period_ns: tuple[float, float] = (
            nominal_ns * (1 - TOLERANCE),
            nominal_ns * (1 + TOLERANCE),
        )
        # Scan 0, and the one of the last bracket.
        self._first: Span | None = None
        self.last: Span | None = None
        self._number = 0

    def scan(self, number: int) -> Span:
        """Return when a scan starts; the lock must be `locked`."""
        assert self.last is not None
        away = number - self._number
        shortest, longest = self.period_ns if away >= 0 else self.period_ns[::-1]
        return Span(
            math.floor(self.last.early + away * shortest),
            math.ceil(self.last.late + away * longest),
        )

    def first_after(self, time_ns: int) -> int:
        """Return the number of the first scan that certainly starts after a moment."""
        number = self._near(time_ns) - 1
        while self.scan(number).early <= time_ns:
            number += 1
        return number

    def starts(self, begin: Span, end: Span) -> tuple[int, int]:
        """Return the least and the largest number of scans that started between two events."""
        if self.last is None:
            shortest, longest = self.period_ns
            least = math.floor(max(0, end.early - begin.late) / longest)
            return least, math.floor(max(0, end.late - begin.early) / shortest) + 1
        least = most = 0
        number = self._near(begin.early) - 1
        while (scan := self.scan(number)).early < end.late:
            most += scan.late > begin.early
            least += scan.early >= begin.late and scan.late <= end.early
            number += 1
        return least, most

    def learn(self, bracket: Span) -> None:
        """Take a bracket in which a scan started; one that is too wide is ignored."""
        width_ns = bracket.late - bracket.early
        if self.last is None:
            if width_ns <= WIDEST * self.period_ns[0]:
                self._first, self.last, self._number = bracket, bracket, 0
            return
        if width_ns >= self.period_ns[0]:
            return
        near = self._near((bracket.early + bracket.late) // 2)
        spans = {
            number: Span(max(scan.early, bracket.early), min(scan.late, bracket.late))
            for number in range(near - 1, near + 2)
            for scan in [self.scan(number)]
        }
        possible = [number for number, span in spans.items() if span.early <= span.late]
        if not possible:
            # It contradicts the bounds: the board was restarted, or stood still.
            self.forget()
        if len(possible) != 1:
            return
        self._number = possible[0]
        self.last = spans[self._number]
        assert self._first is not None
        if self._number > 0:
            shortest, longest = self.period_ns
            self.period_ns = (
                max(shortest, (self.last.early - self._first.late) / self._number),
                min(longest, (self.last.late - self._first.early) / self._number),
            )

    def check(self, time_ns: int) -> None:
        """Reset if scans have become too uncertain by now."""
        if self.last is None:
            return
        span = self.scan(self._near(time_ns))
        if span.late - span.early > WIDEST * self.period_ns[0]:
            self.forget()

    def _near(self, time_ns: int) -> int:
        assert self.last is not None
        middle = (self.last.early + self.last.late) / 2
        return self._number + round((time_ns - middle) / self.nominal_ns)
