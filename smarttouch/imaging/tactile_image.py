"""The touch analogue of an RGB image."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class TactileImage:
    """What each electrode should let the finger feel.

    Attributes
    ----------
    activation : ndarray, (3, E) float32, in [0, 1]
        One row for each `Primary`: RA, SAI, PC.
    time_ns : int
        Time of the frame it came from.
    force_n : float, N
        Finger force at that time.
    """

    activation: NDArray[np.float32]
    time_ns: int
    force_n: float
