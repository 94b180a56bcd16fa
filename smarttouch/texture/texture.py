"""Interface of textures under the hand."""

from abc import ABC, abstractmethod
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

FINEST_PITCH_MM = 0.1
COARSEST_PITCH_MM = 200.0


class RidgeCrossing(NamedTuple):
    """Ridges that passed under the electrodes since the last call."""

    height: NDArray[np.float32]
    """Height of the last ridge that passed each electrode, (E,) in [0, 1]; 0 where none did."""
    merged: int
    """Number of ridges that passed together with another one of the same electrode."""


class TextureSampler(Protocol):
    """Sampler of electrodes over a texture, which stores their last place."""

    def place(self, x_mm: float, y_mm: float) -> None:
        """Place the middle of the array; no ridge counts as passed."""

    def move(self, x_mm: float, y_mm: float) -> RidgeCrossing:
        """Move the middle of the array in a straight line."""


class Texture(ABC):
    """Surface with ridges that stays in place.

    `size_mm` is its width and height, None where it has no ends; `middle_mm` the middle of it or of
    one tile; `notes` are assumptions that were made, a sentence each.
    """

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
        """Return a sampler for electrodes at (E, 2) mm from the middle of the array."""

    @abstractmethod
    def draw(
        self, left_mm: float, top_mm: float, shape: tuple[int, int], pixel_mm: float
    ) -> NDArray[np.uint8]:
        """Return a part of it as ink on paper, (H, W) uint8: dark is high."""
