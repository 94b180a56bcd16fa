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
