"""Plan of periods by which the net current of each electrode stays below its limit."""

from bisect import bisect_right
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.stimulation.sequence_limits import NET_PC, PLANNED

WINDOW_US = 1_100_000
"""Time over which net charge is planned: a board may count its second in tenths."""
GUARD_PC = 0.95 * NET_PC
"""Net charge of any newest passes up to which a next one like the last is planned."""
_MEAN_PC = PLANNED * NET_PC
_FREE_PC = NET_PC / 2
_MOST_PC = 0.99 * NET_PC

Array = NDArray[np.float64]


class _Pass(NamedTuple):
    """Pass by the times of frames, with its net charge, (E,), and the largest of any electrode."""

    end_us: float
    most_pc: float
    net_pc: Array


class NetPlan:
    """Net charge of the last passes, by the times of their frames.

    Passes of one sign are spaced, as evenly as possible, once they have used half of a second's net
    charge at a rate that would use more than all; after a change of the picture, as far as needed.
    """

    def __init__(self, electrodes: int) -> None:
        self._passes: deque[_Pass] = deque()
        self._sum_pc = np.zeros(electrodes)
        self._at_most_pc = self._newest_at_most_pc = 0.0  # bounds of all passes, and of the newest

    def next_period_us(
        self, net_pc: Array, time_us: float, period_us: int, busy_us: int
    ) -> float | None:
        """Enter a sequence with net charge (E,) pC and slots of `busy_us` that begins at a time;
        return its shortest period, not below `period_us`, or None if it may not begin, since a
        second would have too much of it."""
        self._forget(time_us)
        most_pc = float(np.abs(net_pc).max())
        if self._newest_at_most_pc + most_pc > GUARD_PC:
            newest_pc = float(self._newest(net_pc).max())
            self._newest_at_most_pc = newest_pc + most_pc
            if newest_pc > _MOST_PC:
                return None
        self._passes.append(_Pass(time_us + busy_us, most_pc, net_pc))
        self._at_most_pc += most_pc
        self._newest_at_most_pc += most_pc
        self._sum_pc += net_pc
        count, needed_us = len(self._passes), float(period_us)
        carried_pc = float(np.abs(self._sum_pc).max())
        span_us = min(time_us + period_us - self._passes[0].end_us, WINDOW_US)
        # Trains that are over before they fill a window keep their times, and so does what pauses.
        if carried_pc > _FREE_PC and carried_pc * WINDOW_US > _MEAN_PC * span_us:
            mean_pc = carried_pc / count
            if mean_pc < _MEAN_PC:
                # So many of it as a window holds, and one more that it cuts.
                needed_us = max(needed_us, WINDOW_US / 1.1 * mean_pc / (_MEAN_PC - mean_pc))
            if carried_pc + mean_pc < GUARD_PC:
                # What there is room for comes evenly until the first of them leave.
                left_us = WINDOW_US - span_us
                needed_us = max(needed_us, left_us * mean_pc / (GUARD_PC - carried_pc))
        if self._newest_at_most_pc + most_pc > GUARD_PC:
            # A next one like this must find room: wait until enough of the passes have left.
            newest = self._newest(net_pc).max(axis=1)
            room = max(0, bisect_right(np.maximum.accumulate(newest).tolist(), GUARD_PC) - 1)
            if room < count:
                end_us = self._passes[count - room - 1].end_us
                needed_us = max(needed_us, end_us + WINDOW_US - time_us)
        return needed_us

    def _forget(self, time_us: float) -> None:
        """Remove passes that are no longer in a window that begins before a time."""
        passes = self._passes
        while passes and passes[0].end_us <= time_us - WINDOW_US:
            _, most_pc, net_pc = passes.popleft()
            self._at_most_pc -= most_pc
            self._sum_pc -= net_pc
            self._newest_at_most_pc = min(self._newest_at_most_pc, self._at_most_pc)

    def _newest(self, net_pc: Array) -> Array:
        """Return the largest net charges (magnitude) of the newest passes and one more, (N + 1,)
        by electrode."""
        passes = (earlier.net_pc for earlier in reversed(self._passes))
        return np.asarray(np.abs(np.cumsum([net_pc, *passes], axis=0)))
