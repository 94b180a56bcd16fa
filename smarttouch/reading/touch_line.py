"""A line prepared for the finger."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Place:
    """Place of a line on its page, for a finger that moves over the page itself.

    Attributes
    ----------
    left_mm, right_mm, middle_mm : float, mm
        Its ends and its middle, from the page's top left corner.
    scale : float
        Millimeters under the array for one on the page.
    """

    left_mm: float
    right_mm: float
    middle_mm: float
    scale: float


@dataclass(frozen=True, eq=False)
class TouchLine:
    """A line of letter shapes or Braille cells, at the size of the array.

    Attributes
    ----------
    image : ndarray, (H, W) uint8
        Ink dark on 255; as high as the array.
    start_mm, end_mm : float, mm
        First and last place of the array's middle, from the image's left edge.
    text : str
        Text of the line, if known.
    cells : tuple of str
        Braille cells, a string for each line of them; empty for letter shapes.
    place : Place, optional
        Place on its page.
    """

    image: NDArray[np.uint8]
    start_mm: float
    end_mm: float
    text: str = ""
    cells: tuple[str, ...] = ()
    place: Place | None = None
