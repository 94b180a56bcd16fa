"""Pulses delivered in one interval of a trial."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Interval:
    """Pulses delivered in one interval of a trial, as the board reports them.

    Attributes
    ----------
    time_s : ndarray, (N,) float64, s
        Of each slot, since the interval began.
    width_us : ndarray, (N,) float32, µs
        Duration of each slot.
    current_ua : ndarray, (N, E) int16, µA
        Current of each electrode, positive cathodic.
    """

    time_s: NDArray[np.float64]
    width_us: NDArray[np.float32]
    current_ua: NDArray[np.int16]

    def distinct(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the distinct slots, by their first, and the index of the distinct one for each
        slot.

        Trains repeat the same few pulses: what follows from a pulse need be computed once.
        """
        width = np.ascontiguousarray(self.width_us, np.float32).view(np.int16).reshape(-1, 2)
        rows = np.hstack([self.current_ua, width])
        whole = np.dtype((np.void, rows.dtype.itemsize * rows.shape[1]))
        _, first, which = np.unique(rows.view(whole)[:, 0], return_index=True, return_inverse=True)
        return first, which
