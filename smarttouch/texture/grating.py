"""Grating of parallel ridges, by formula."""

import math

import numpy as np
from numpy.typing import NDArray

from smarttouch.errors import PageError, require_within
from smarttouch.texture.texture import COARSEST_PITCH_MM, FINEST_PITCH_MM, RidgeCrossing, Texture

_LEVELS = 256
_WAVE = np.asarray(
    np.rint(127.5 * (1 - np.cos(2 * np.pi * (np.arange(_LEVELS) + 0.5) / _LEVELS))), np.uint8
)
"""Grey levels of one period, dark on the ridge."""


class Grating(Texture):
    """Unbounded ridges at one pitch, turned clockwise from upright; one is at the origin."""

    def __init__(self, pitch_mm: float, angle_deg: float = 0.0) -> None:
        words = f"a grating of {pitch_mm:g} mm"
        require_within(PageError, "pitch_mm", pitch_mm, FINEST_PITCH_MM, COARSEST_PITCH_MM, words)
        require_within(PageError, "angle_deg", angle_deg, -360, 360)
        turned = f", turned by {angle_deg:g}°" if angle_deg else ""
        super().__init__(f"grating of {pitch_mm:g} mm{turned}", None)
        angle = math.radians(angle_deg)
        self.pitch_mm = pitch_mm
        self.per_mm = np.array([math.cos(angle), math.sin(angle)]) / pitch_mm
        """Cycles for each mm to the right and down, (2,)."""

    def feeler(self, position_mm: NDArray[np.float64]) -> "GratingFeeler":
        """Return a sampler of electrodes over it."""
        return GratingFeeler(self.per_mm, position_mm)

    def draw(
        self, left_mm: float, top_mm: float, shape: tuple[int, int], pixel_mm: float
    ) -> NDArray[np.uint8]:
        """Return a part of it as ink on paper, (H, W) uint8."""
        rows, columns = shape
        across = (left_mm + pixel_mm * (np.arange(columns) + 0.5)) * self.per_mm[0]
        down = (top_mm + pixel_mm * (np.arange(rows) + 0.5)) * self.per_mm[1]
        # Sums of bytes go round as phases do.
        across, down = ((each % 1 * _LEVELS).astype(np.uint8) for each in (across, down))
        return np.asarray(_WAVE[across[None] + down[:, None]])


class GratingFeeler:
    """Sampler of a grating: a ridge passes an electrode, (E, 2) mm, at whole numbers of its phase.

    The phase is the spatial frequency, (2,) cycles/mm, times the place in the world, so that an
    electrode pulses spatial frequency times speed times a second (paper, Section IV-C), at places
    that do not move with the hand.
    """

    def __init__(self, per_mm: NDArray[np.float64], position_mm: NDArray[np.float64]) -> None:
        self._per_x, self._per_y = per_mm.tolist()
        self._own = position_mm @ per_mm
        self._before = np.floor(self._own)

    def place(self, x_mm: float, y_mm: float) -> None:
        """Place the middle of the array."""
        self._before = np.floor(self._own + (x_mm * self._per_x + y_mm * self._per_y))

    def move(self, x_mm: float, y_mm: float) -> RidgeCrossing:
        """Move the middle of the array; the order of ridges on the way does not matter."""
        before = self._before
        self.place(x_mm, y_mm)
        ridges = np.abs(self._before - before)
        height = np.minimum(ridges, 1).astype(np.float32)
        return RidgeCrossing(height, int(ridges.sum() - height.sum()))
