"""Base classes of textures under the hand, and gratings."""

import math
from abc import ABC, abstractmethod
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import PageError, require_within

FINEST_PITCH_MM = 0.1
COARSEST_PITCH_MM = 200.0


class RidgeCrossing(NamedTuple):
    """Ridges that passed under the electrodes in one move of the array."""

    height: NDArray[np.float32]
    """Height of the last ridge that passed each electrode, (E,) in [0, 1]; 0 without a ridge."""
    merged: int  # ridges without a pulse, because one move passed several ridges


class TextureSampler(Protocol):
    """Detector of the ridges of a texture that pass under moving electrodes."""

    def place(self, x_mm: float, y_mm: float) -> None:
        """Set the place of the array's center without counting ridges."""

    def move(self, x_mm: float, y_mm: float) -> RidgeCrossing:
        """Move the array's center in a straight line, and return the ridges on the way."""


class Texture(ABC):
    """Fixed surface with ridges. `size_mm` is width and height, None if unbounded. `middle_mm` is
    the middle, where a hand starts by default. `notes` are assumptions, one sentence each."""

    def __init__(
        self,
        title: str,
        size_mm: tuple[float, float] | None,
        middle_mm: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.title = title
        self.size_mm = size_mm
        self.middle_mm = middle_mm
        self.notes: list[str] = []

    @abstractmethod
    def feeler(self, position_mm: NDArray[np.float64]) -> TextureSampler:
        """Return a sampler for electrodes at ``position_mm``, (E, 2). The origin is the middle of
        the array."""

    @abstractmethod
    def draw(
        self, left_mm: float, top_mm: float, shape: tuple[int, int], pixel_mm: float
    ) -> NDArray[np.uint8]:
        """Draw a part of the texture, (H, W) uint8. Dark pixels are high places."""


class Grating(Texture):
    """Unbounded grating with a ridge at the origin. ``angle_deg`` is the clockwise angle from the
    vertical to the ridges."""

    def __init__(self, pitch_mm: float, angle_deg: float = 0.0) -> None:
        words = f"a grating of {pitch_mm:g} mm"
        require_within(PageError, "pitch_mm", pitch_mm, FINEST_PITCH_MM, COARSEST_PITCH_MM, words)
        require_within(PageError, "angle_deg", angle_deg, -360, 360)
        turned = f", turned by {angle_deg:g}°" if angle_deg else ""
        super().__init__(f"grating of {pitch_mm:g} mm{turned}", None)
        angle = math.radians(angle_deg)
        self.pitch_mm = pitch_mm
        self.per_mm: NDArray[np.float64] = np.array([math.cos(angle), math.sin(angle)]) / pitch_mm
        """Spatial frequency, (2,) cycles/mm right and down."""

    def feeler(self, position_mm: NDArray[np.float64]) -> "GratingFeeler":
        """Return a sampler for electrodes that move over this grating."""
        return GratingFeeler(self.per_mm, position_mm)

    def draw(
        self, left_mm: float, top_mm: float, shape: tuple[int, int], pixel_mm: float
    ) -> NDArray[np.uint8]:
        """Return a part of the grating as gray levels, (H, W) uint8. Ridges are dark."""
        rows, columns = shape
        across = (left_mm + pixel_mm * (np.arange(columns) + 0.5)) * self.per_mm[0]
        down = (top_mm + pixel_mm * (np.arange(rows) + 0.5)) * self.per_mm[1]
        phase = across + down[:, None]
        return np.asarray(np.rint(127.5 * (1 - np.cos(2 * np.pi * phase))), np.uint8)


class GratingFeeler:
    """Sampler of a grating. A ridge passes when the phase of an electrode crosses an integer.

    The phase of an electrode is its place on the texture times the spatial frequency. So the pulse
    rate is speed times spatial frequency (paper, Section IV-C).
    """

    def __init__(self, per_mm: NDArray[np.float64], position_mm: NDArray[np.float64]) -> None:
        self._per_x, self._per_y = per_mm.tolist()
        self._own = position_mm @ per_mm
        self._before = np.floor(self._own)

    def place(self, x_mm: float, y_mm: float) -> None:
        """Set the place of the array's center without counting ridges."""
        self._before = np.floor(self._own + (x_mm * self._per_x + y_mm * self._per_y))

    def move(self, x_mm: float, y_mm: float) -> RidgeCrossing:
        """Move the array, and count the ridges between its old and its new place."""
        before = self._before
        self.place(x_mm, y_mm)
        ridges = np.abs(self._before - before)
        height = np.minimum(ridges, 1).astype(np.float32)
        return RidgeCrossing(height, int(ridges.sum() - height.sum()))
