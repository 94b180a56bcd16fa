"""The tactile image: the touch analogue of an RGB image."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.one_line import one_line


@dataclass(frozen=True, eq=False)
class TactileImage:
    """Activation of each afferent class at each electrode.

    Attributes
    ----------
    activation : ndarray, (3, E) float32, in [0, 1]
        One row for each `Afferent`: RA, SAI, PC.
    time_ns : int
        Time of what it came from.
    force_n : float, N
        Finger force at that time.
    period_us : int, µs, optional
        Given, every active class pulses once, now, and the next image comes after this time;
        else the profile's rates determine when each class pulses.
    level : float, in [0, 1]
        Of the strongest comfortable current, on top of what the user wishes.
    """

    __repr__ = one_line

    activation: NDArray[np.float32]
    time_ns: int
    force_n: float
    period_us: int | None = None
    level: float = 1.0
