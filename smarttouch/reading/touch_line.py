"""A line prepared for the finger."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Place:
    """Place of a line from the page's top left corner, for a finger that moves over the page."""

    left_mm: float
    right_mm: float
    middle_mm: float
    scale: float  # millimeters under the array for one on the page


@dataclass(frozen=True, eq=False)
class TouchLine:
    """A line of letter shapes or Braille cells, at the size of the array."""

    image: NDArray[np.uint8]  # (H, W), dark on 255, as high as the array
    start_mm: float  # first and last place of the array's middle, from the image's left edge
    end_mm: float
    text: str = ""
    cells: tuple[str, ...] = ()  # a string for each line of Braille
    place: Place | None = None
