"""Natural drive: changes drive RA, and sustained ink SAI, as in a finger that explores."""

import math

import numpy as np
from numpy.typing import NDArray

from smarttouch.afferent import Afferent

ADAPTATION_S = 0.04
"""Time constant of the adaptation to ink that stays. Ours: longer than between two
pulses of RA, and so short that a stroke at reading speed does not smear over the next letter."""
LEAVING = 0.4
"""Drive of leaving ink, relative to arriving: RA responds less to the end of a touch. (At full
strength the stroke that has just left would be felt beside the one that is there.)"""
FAINTEST_CHANGE = 0.15
"""Least change above the sensor's noise."""


class NaturalDrive:
    """Splits a tactile image into its changes and its sustained part.

    Each electrode keeps a slow memory of its activation. What differs from it is an edge on the
    move and drives RA, on arrival and on leaving; what the memory agrees with drives SAI. After
    `last_ns` of None, as on a finger that has just landed, all is new.
    """

    def __init__(self, electrodes: int) -> None:
        self._slow = np.zeros(electrodes, np.float32)
        self.last_ns: int | None = None

    def drive(
        self,
        activation: NDArray[np.float32],
        ink: NDArray[np.float32],
        time_ns: int,
        touching: bool,
    ) -> None:
        """Fill rows RA and SAI of zeros (3, E) from ink, (E,); without touch all ink is new."""
        if self.last_ns is None or not touching:
            self._slow[:] = 0
        change, sustained = activation[Afferent.RA], activation[Afferent.SAI]
        np.subtract(ink, self._slow, out=change)
        if self.last_ns is not None and touching:
            elapsed_s = max(0, time_ns - self.last_ns) / 1e9
            np.minimum(ink, self._slow, out=sustained)
            sustained[sustained < FAINTEST_CHANGE] = 0
            self._slow += change * np.float32(1 - math.exp(-elapsed_s / ADAPTATION_S))
        self.last_ns = time_ns if touching else None
        change[change < 0] *= -LEAVING
        change -= FAINTEST_CHANGE
        change *= 1 / (1 - FAINTEST_CHANGE)
        # On a few numbers, quicker than np.clip.
        np.maximum(change, 0, out=change)
        np.minimum(change, 1, out=change)
