"""Pages: gray levels with a physical scale, and lines of text."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray
from PIL import Image

from smarttouch.base.errors import PageError
from smarttouch.pages.grey_image import MOST_PIXELS, read_pixels, to_grey

FEWEST_PIXELS = 8  # smallest side of a page
LARGEST_MM, SMALLEST_MM = 2000.0, 2.0
INCH_MM = 25.4
_LEAST_BELIEVED_DPI = 50.0
"""Lowest plausible resolution; files with unknown resolution state less, usually 1 or 72."""


def curve_at(
    coefficients: NDArray[np.float64], distance: NDArray[np.float64], length: float
) -> NDArray[np.float64]:
    """Return a polynomial at distances from its start, extrapolated linearly."""
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
    baseline: tuple[
        float, ...
    ]  # polynomial coefficients of y, lowest first, over the distance from left_mm
    x_height_mm: float
    ascent_mm: float  # ascender height of the font, whatever letters the line has
    descent_mm: float
    cell: int = 0  # index in a row of a table, from 1; 0 outside of tables

    def baseline_mm(self, x_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return y of the baseline at x, mm, extrapolated linearly."""
        length = self.right_mm - self.left_mm
        return curve_at(np.array(self.baseline), x_mm - self.left_mm, length)

    def slope(self, x_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the slope of the baseline at x, positive downward."""
        inside = np.clip(x_mm - self.left_mm, 0, self.right_mm - self.left_mm)
        return np.asarray(polynomial.polyval(inside, polynomial.polyder(self.baseline)))

    @property
    def height_mm(self) -> float:
        """Height from ascenders to descenders."""
        return self.ascent_mm + self.descent_mm

    @property
    def top_mm(self) -> float:
        """Mean y of the top of the print."""
        return self._mean_mm - self.ascent_mm

    @property
    def bottom_mm(self) -> float:
        """Mean y of the bottom of the print."""
        return self._mean_mm + self.descent_mm

    @property
    def _mean_mm(self) -> float:
        length = self.right_mm - self.left_mm
        return sum(c * length**k / (k + 1) for k, c in enumerate(self.baseline))


@dataclass(frozen=True, eq=False)
class Page:
    """Page as gray levels, (H, W) uint8, 255 is white, with its scale.

    A PDF also provides its lines in reading order, their texts, and notes on omitted parts. Without
    lines the picture must be recognized.
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


def check_scale_options(
    dpi: float | None, width_mm: float | None, width: str = "page_width_mm"
) -> None:
    """Raise PageError if the user's scale is invalid; ``width`` is the name of the second
    option."""
    if dpi is not None and width_mm is not None:
        raise PageError(f"dpi and {width} are both given: give one of them")
    for name, value in (("dpi", dpi), (width, width_mm)):
        if value is not None and not 0 < value < float("inf"):
            raise PageError(f"{name} {value:g} must be above 0")


def read_grey(
    path: Path, image: Image.Image, dpi: float | None = None, page_width_mm: float | None = None
) -> tuple[NDArray[np.uint8], float | None]:
    """Return an open image as gray levels, (H, W) uint8, and its scale, mm per pixel, or None."""
    require_pixels(str(path), *image.size)
    grey = to_grey(read_pixels(image))
    if page_width_mm is not None:
        return grey, page_width_mm / grey.shape[1]
    across, down = map(float, image.info.get("dpi") or (0, 0))
    is_believed = across >= _LEAST_BELIEVED_DPI and across != 72 and round(across) == round(down)
    dpi = dpi or (across if is_believed else None)
    return grey, INCH_MM / dpi if dpi else None


def require_pixels(name: str, width: int, height: int) -> None:
    """Raise PageError if a page has too many or too few pixels."""
    if width * height > MOST_PIXELS or min(width, height) < FEWEST_PIXELS:
        raise PageError(
            f"{name} has {width} x {height} pixels: a page needs at least {FEWEST_PIXELS} x "
            f"{FEWEST_PIXELS}, and at most {MOST_PIXELS // 10**6} megapixels"
        )


def require_size_mm(
    name: str, width_mm: float, height_mm: float, options: str = "dpi or page_width_mm"
) -> None:
    """Raise PageError if the size of a page is implausible."""
    if max(width_mm, height_mm) > LARGEST_MM or min(width_mm, height_mm) < SMALLEST_MM:
        raise PageError(
            f"{name} would be {width_mm:.4g} x {height_mm:.4g} mm: give a {options} "
            f"that makes it {SMALLEST_MM:g} to {LARGEST_MM:g} mm"
        )
