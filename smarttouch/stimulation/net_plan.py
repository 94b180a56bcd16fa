"""Plan of periods by which the net current of each electrode stays below its limit."""

import math
from bisect import bisect_right
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.stimulation.slot_sums import NET_PC, PLANNED

WINDOW_US = 1_100_000
"""Time over which net charge is planned: a board may count its second in tenths."""
GUARD_PC = 0.95 * NET_PC
"""Net charge of any newest passes up to which a next one like the last is planned."""
_MEAN_PC = PLANNED * NET_PC
_FREE_PC = NET_PC / 2
_MOST_PC = 0.99 * NET_PC

Array = NDArray[np.float64]


class _Pass(NamedTuple):
    """Pass by the times of frames, with the bound of its net charge, and that where it is known."""

    end_us: float
    most_pc: float
    net_pc: Array | None


class NetPlan:
    """Net charge of the last passes, by the times of their frames.

    Passes of one sign are spaced, as evenly as possible, once they have used half of a second's net
    charge at a rate that would use more than all; after a change of the picture, as far as needed.
    """

    def __init__(self, electrodes: int) -> None:
        self._electrodes = electrodes
        self._passes: deque[_Pass] = deque()
        self._sum_pc = np.zeros(electrodes)
        # Bounds of all passes, of those whose own net charge is unknown, and of the newest.
        self._at_most_pc = self._unknown_pc = self._newest_at_most_pc = 0.0

    def period_us(
        self,
        current_ua: NDArray[np.int16],
        width_us: NDArray[np.uint16],
        time_us: float,
        period_us: int,
        busy_us: int,
        at_most_pc: float = math.inf,
    ) -> float | None:
        """Enter a sequence of the frame at a time; return its shortest period, µs.

        It is not below `period_us`, and None if slots (S, E), of `busy_us` together, would break
        the limit now: then they are not entered. Where a window of sequences of no more than
        `at_most_pc` (pC on one electrode) cannot break it, net charge is not added up.
        """
        passes = self._passes
        # Of passes that are in no window any more, nothing counts.
        while passes and passes[0].end_us <= time_us - WINDOW_US:
            _, most_pc, before_pc = passes.popleft()
            self._at_most_pc -= most_pc
            if before_pc is None:
                self._unknown_pc -= most_pc
            else:
                self._sum_pc -= before_pc
            self._newest_at_most_pc = min(self._newest_at_most_pc, self._at_most_pc)
        of_window_pc = (WINDOW_US // period_us + 2) * at_most_pc
        if max(of_window_pc, self._at_most_pc + at_most_pc) <= GUARD_PC:
            # No slot is later than the period.
            passes.append(_Pass(time_us + period_us, at_most_pc, None))
            self._at_most_pc += at_most_pc
            self._newest_at_most_pc += at_most_pc
            self._unknown_pc += at_most_pc
            return period_us
        net_pc: Array = (width_us.astype(np.float32) @ current_ua.astype(np.float32)).astype(float)
        most_pc = float(np.abs(net_pc).max())
        if self._newest_at_most_pc + most_pc > GUARD_PC:
            newest_pc = float(self._newest(net_pc).max())
            self._newest_at_most_pc = newest_pc + most_pc
            if newest_pc > _MOST_PC:
                return None
        passes.append(_Pass(time_us + busy_us, most_pc, net_pc))
        self._at_most_pc += most_pc
        self._newest_at_most_pc += most_pc
        self._sum_pc += net_pc
        return self._spaced_us(net_pc, most_pc, time_us, period_us)

    def _spaced_us(self, net_pc: Array, most_pc: float, time_us: float, period_us: int) -> float:
        """Return the shortest period of the newest pass, which is entered."""
        count, needed_us = len(self._passes), float(period_us)
        carried_pc = float(np.abs(self._sum_pc).max()) + self._unknown_pc
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

    def _newest(self, net_pc: Array) -> Array:
        """Return the largest net charges (magnitude) of the newest passes and one more, (N + 1, E).

        The bound of a pass of unknown charge counts on every electrode.
        """
        newest, nothing = [*reversed(self._passes)], np.zeros(self._electrodes)
        known = (nothing if each.net_pc is None else each.net_pc for each in newest)
        unknown = (each.most_pc if each.net_pc is None else 0.0 for each in newest)
        sums = np.abs(np.cumsum([net_pc, *known], axis=0))
        sums += np.cumsum([0.0, *unknown])[:, None]
        return np.asarray(sums)
