"""Pages: gray levels with a physical scale, and lines of text."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import PageError
from smarttouch.imaging.grey_image import MOST_PIXELS

FEWEST_PIXELS = 8  # smallest side of a page, pixels
LARGEST_MM, SMALLEST_MM = 2000.0, 2.0
INCH_MM = 25.4


def curve_at(
    coefficients: NDArray[np.float64], distance: NDArray[np.float64], length: float
) -> NDArray[np.float64]:
    """Evaluate a polynomial at ``distance``; outside 0 to ``length``, extrapolate linearly."""
    inside = np.clip(distance, 0, length)
    y, slope = np.zeros_like(inside), np.zeros_like(inside)
    for coefficient in coefficients[::-1].tolist():
        # Horner's method is several times faster than numpy's polynomials.
        y, slope = y * inside + coefficient, slope * inside + y
    return np.asarray(y + slope * (distance - inside), np.float64)


@dataclass(frozen=True)
class TextLine:
    """Line of text; coordinates are mm from the page's top left corner."""

    left_mm: float
    right_mm: float
    baseline: tuple[float, ...]  # polynomial coefficients, lowest first; argument: x - left_mm
    x_height_mm: float
    ascent_mm: float  # height of the font's ascenders, even if the line has none
    descent_mm: float
    cell: int = 0  # index of the cell in its table row, from 1; 0 outside tables

    def baseline_mm(self, x_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return y of the baseline at x, mm, linearly extrapolated beyond the line's ends."""
        length = self.right_mm - self.left_mm
        return curve_at(np.array(self.baseline), x_mm - self.left_mm, length)

    @property
    def height_mm(self) -> float:
        """Height from ascenders to descenders."""
        return self.ascent_mm + self.descent_mm

    @property
    def top_mm(self) -> float:
        """y of the ascenders' top, halfway along the line."""
        return float(self.baseline_mm(np.array(self.left_mm + self.right_mm) / 2)) - self.ascent_mm

    @property
    def bottom_mm(self) -> float:
        """y of the descenders' bottom, halfway along the line."""
        return self.top_mm + self.height_mm


@dataclass(frozen=True, eq=False)
class Page:
    """Picture of a page, (H, W) uint8, with its scale; 255 is white.

    A page of a PDF also has its lines in reading order, the text of each line, and notes on omitted
    parts. If a page has no lines, its text must be recognized.
    """

    grey: NDArray[np.uint8]
    mm_per_pixel: float
    lines: tuple[TextLine, ...] = ()
    words: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height, mm."""
        height, width = self.grey.shape
        return width * self.mm_per_pixel, height * self.mm_per_pixel


def require_pixels(name: str, width: int, height: int) -> None:
    """Raise PageError if a page has too many or too few pixels."""
    if width * height > MOST_PIXELS or min(width, height) < FEWEST_PIXELS:
        raise PageError(
            f"{name} has {width} x {height} pixels: a page needs at least {FEWEST_PIXELS} x "
            f"{FEWEST_PIXELS}, and at most {MOST_PIXELS // 10**6} megapixels"
        )


def require_size_mm(
    name: str, width_mm: float, height_mm: float, options: str = "dpi or a width in mm"
) -> None:
    """Raise PageError if a page's size is implausible. The message asks for ``options``."""
    if not all(SMALLEST_MM <= side <= LARGEST_MM for side in (width_mm, height_mm)):
        raise PageError(
            f"{name} would be {width_mm:.4g} x {height_mm:.4g} mm: give a {options} "
            f"that makes it {SMALLEST_MM:g} to {LARGEST_MM:g} mm"
        )
