"""Plan of periods by which the net current of each electrode stays below its limit."""

from bisect import bisect_right
from collections import deque

import numpy as np
from numpy.typing import NDArray

from smarttouch.stimulation.exposure import NET_PC, PLANNED

WINDOW_US = 1_100_000
"""Time over which net charge is planned: a board may count its second in tenths."""
GUARD_PC = 0.95 * NET_PC
"""Net charge of any newest passes up to which a next one like the last is planned."""
_MEAN_PC = PLANNED * NET_PC
_MOST_PC = 0.99 * NET_PC

Array = NDArray[np.float64]


class NetPlan:
    """Net charge of the last passes, by the times of their frames.

    Passes of one sign come farther apart, as evenly as may be, where the mean net charge of the
    last ones asks for it; and after a change of the picture as far as it must be.

    Parameters
    ----------
    electrodes : int
    """

    def __init__(self, electrodes: int) -> None:
        self._passes: deque[tuple[float, Array]] = deque()
        """End by time of frames, µs, and net charge."""
        self._sum_pc = np.zeros(electrodes)
        self._newest_at_most_pc = 0.0

    def admits(self, net_pc: Array, time_us: float) -> bool:
        """Whether a sequence may begin at a time without breaking the limit in any second."""
        passes = self._passes
        while passes and passes[0][0] <= time_us - WINDOW_US:
            self._sum_pc -= passes.popleft()[1]
        if not passes:
            self._newest_at_most_pc = 0.0
        most_pc = float(np.abs(net_pc).max())
        if self._newest_at_most_pc + most_pc <= GUARD_PC:
            return True
        newest_pc = float(self._newest(net_pc).max())
        self._newest_at_most_pc = newest_pc + most_pc
        return newest_pc <= _MOST_PC

    def period_us(self, net_pc: Array, time_us: float, period_us: int, busy_us: int) -> float:
        """Enter a sequence that begins at a time, and return its shortest period, µs.

        Parameters
        ----------
        net_pc : ndarray, (E,) pC
        time_us : float
        period_us : int
            That it would have.
        busy_us : int
            Of its slots.
        """
        self._passes.append((time_us + busy_us, net_pc))
        self._sum_pc += net_pc
        most_pc = float(np.abs(net_pc).max())
        self._newest_at_most_pc += most_pc
        count, needed_us = len(self._passes), float(period_us)
        mean_pc = float(np.abs(self._sum_pc).max()) / count
        # So many of it as a window holds, and one more that it cuts.
        if mean_pc < _MEAN_PC:
            needed_us = max(needed_us, WINDOW_US / 1.1 * mean_pc / (_MEAN_PC - mean_pc))
        if self._newest_at_most_pc + most_pc > GUARD_PC:
            # A next one like this must find room: wait until enough of the passes have left.
            newest = self._newest(net_pc).max(axis=1)
            room = max(0, bisect_right(np.maximum.accumulate(newest).tolist(), GUARD_PC) - 1)
            if room < count:
                needed_us = max(needed_us, self._passes[count - room - 1][0] + WINDOW_US - time_us)
        return needed_us

    def _newest(self, net_pc: Array) -> Array:
        """Return the magnitudes of the newest passes' net charge with one more, (N + 1, E)."""
        sums = np.cumsum([net_pc, *(each for _, each in reversed(self._passes))], axis=0)
        return np.asarray(np.abs(sums))
