"""Phase of the loop against the board: a sequence is complete just before the board needs it."""

from collections import deque
from dataclasses import dataclass

from smarttouch.boards.board import Board
from smarttouch.running.run_statistics import RunStatistics
from smarttouch.running.step import FirstPulse

GUARD_NS = 500_000  # time kept beside the usual delay of a sequence
_IDLE_NS = 1_000_000
"""Pause of the board from which a sequence counts as late; below, the board itself may be."""
_OF_20 = 20  # one sequence in so many may come late
_REMEMBERED = 250  # sequences for which it is remembered what the line took


@dataclass(frozen=True)
class Sent:
    """Sequence that was sent; times by the loop's clock."""

    number: int
    taken_ns: int  # when its image was taken
    deadline_ns: int
    shift_ns: int  # of the schedule at its deadline
    waited_ns: int  # for a place on the board, where that was the board's doing
    sent_ns: int
    period_ns: int
    ahead_ns: int  # of the board's clock, of the loop's


class PhaseLock:
    """Shift of a loop's deadlines by the times at which a board says it began earlier sequences.

    A sequence is complete some delay after its deadline. Deadlines move later until they lie
    before the board's need by the delay that 19 of 20 of the last ones had, what the line takes,
    and `GUARD_NS`: images are as fresh as they can be. They never move earlier: a sequence that
    comes late makes the board wait, and thereby moves all its later needs.
    """

    def __init__(self, board: Board, statistics: RunStatistics) -> None:
        self._board, self._statistics = board, statistics
        self._pending: deque[Sent] = deque(maxlen=8)
        self._delays_ns: deque[int] = deque(maxlen=64)
        self._lines: deque[tuple[int, int]] = deque(maxlen=8)
        """Of sequences for which the board waited: number, and from last byte to start, ns."""
        self._free_ns: int | None = None
        """When the board was free after the newest sequence whose start is known."""
        self.newest: FirstPulse | None = None
        """Of the newest sequence whose start has become known since the step before."""

    def note(self, sent: Sent) -> None:
        """Note a sequence that was sent."""
        self._delays_ns.append(sent.sent_ns - sent.waited_ns - sent.deadline_ns)
        self._pending.append(sent)

    def follow(self, shift_ns: int) -> int:
        """Return by how much deadlines, shifted so far by ``shift_ns``, move later."""
        self.newest, more_ns = None, 0
        for each in list(self._pending):
            start = self._board.start_of(each.number)
            if start is None:
                continue
            self._pending.remove(each)
            begun_ns = start.time_ns - each.ahead_ns
            self.newest = FirstPulse(
                each.number, (begun_ns - each.taken_ns) / 1000, (begun_ns - each.sent_ns) / 1000
            )
            self._statistics.enter_first_pulse(self.newest)
            line_ns = self._line_ns(each.number)
            if self._free_ns is not None and begun_ns > self._free_ns + _IDLE_NS:
                self._lines.append((each.number, begun_ns - each.sent_ns))
                line_ns = max(line_ns, begun_ns - each.sent_ns)
            self._free_ns = begun_ns + each.period_ns
            room_ns = begun_ns - each.deadline_ns - (shift_ns - each.shift_ns)
            more_ns = max(0, room_ns - line_ns - self._usual_ns() - GUARD_NS)
        return more_ns

    def forget(self) -> None:
        """Discard what was sent: the board was lost."""
        self._pending.clear()
        self._free_ns = None

    def _usual_ns(self) -> int:
        """Return the delay from deadline to last byte that 19 of 20 keep."""
        return sorted(self._delays_ns)[-1 - len(self._delays_ns) // _OF_20]

    def _line_ns(self, number: int) -> int:
        """Return what the line usually takes, from two sequences on: one may have been held up."""
        while self._lines and self._lines[0][0] < number - _REMEMBERED:
            self._lines.popleft()
        lines = sorted(each for _, each in self._lines)
        return lines[(len(lines) - 1) // 2] if len(lines) > 1 else 0
