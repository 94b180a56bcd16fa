"""Pulses delivered in one interval of a trial."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Interval:
    """Pulses delivered in one interval of a trial, as the board reports them."""

    time_s: NDArray[np.float64]  # (N,) float64, s: of each slot, since the interval began
    width_us: NDArray[np.float32]  # (N,) float32, µs: duration of each slot
    current_ua: NDArray[np.int16]  # (N, E) int16, µA: current of each electrode, positive cathodic
