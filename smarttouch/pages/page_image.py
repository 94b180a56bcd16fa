"""Pages: image files with a physical scale, and pages printed from a text."""

import textwrap
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont, ImageOps, UnidentifiedImageError

from smarttouch.errors import PageError

MOST_PIXELS = 100_000_000
FEWEST_PIXELS = 8
"""A page with a shorter side is no page."""
LARGEST_MM = 2000.0
SMALLEST_MM = 2.0
_INCH_MM = 25.4
_LEAST_BELIEVED_DPI = 50.0
"""Files that say less (1 or 72 by default) mean that nobody measured."""

PRINT_DPI = 300
_PRINT_WIDTH_MM = 92.0
_MARGIN_MM = 7.0
_LINE_MM = 4.2
"""Ascender to descender."""
_LINE_STEP_MM = 8.0
_COLUMNS = 30


@dataclass(frozen=True, eq=False)
class Page:
    """A page as it lies there.

    Attributes
    ----------
    grey : ndarray, (H, W) uint8
        Bright is white.
    mm_per_pixel : float, mm
        Its scale.
    """

    grey: NDArray[np.uint8]
    mm_per_pixel: float

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height, mm."""
        height, width = self.grey.shape
        return width * self.mm_per_pixel, height * self.mm_per_pixel


def load_page(path: Path, dpi: float | None = None, page_width_mm: float | None = None) -> Page:
    """Load an image of a page.

    Any kind of image works: grey, color, palette, 16 bit, transparent (laid on
    white). The scale is the one given, else the file's own.

    Parameters
    ----------
    path : Path
        The image file.
    dpi : float, optional
        Pixels per inch.
    page_width_mm : float, optional, mm
        Or the width of the whole image.

    Raises
    ------
    PageError
        If there is no such page, or no way to know its size.
    """
    if dpi is not None and page_width_mm is not None:
        raise PageError("--dpi and --page-width-mm both given: one of them is enough")
    try:
        with warnings.catch_warnings():
            # Pillow warns of large images before we have looked at the size ourselves.
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(path) as image:
                _require_size(path, image.size)
                stated = image.info.get("dpi")
                grey = _to_grey(image)
    except FileNotFoundError:
        raise PageError(f"no file {path}: check its name") from None
    except IsADirectoryError:
        raise PageError(f"{path} is a folder: give an image file") from None
    except Image.DecompressionBombError:
        raise PageError(
            f"{path} is above {MOST_PIXELS // 10**6} megapixels: make it smaller first"
        ) from None
    except UnidentifiedImageError:
        raise PageError(
            f"{path} is not an image that can be read: give a PNG, JPEG or TIFF"
        ) from None
    except (OSError, SyntaxError, ValueError, EOFError) as error:
        raise PageError(f"{path} cannot be read: {error}") from None
    return Page(grey, _scale(path, grey.shape[1], grey.shape[0], dpi, page_width_mm, stated))


def print_text(text: str) -> Page:
    """Print a text as black on white at 300 dots per inch.

    Raises
    ------
    PageError
        If there is nothing to print.
    """
    lines = [line for part in text.splitlines() for line in textwrap.wrap(part, _COLUMNS) or [""]]
    if not any(line.strip() for line in lines):
        raise PageError("text: has nothing to print: give some words after the colon")
    per_mm = PRINT_DPI / _INCH_MM
    font = ImageFont.load_default(size=_LINE_MM * per_mm * 1.26)
    height_mm = 2 * _MARGIN_MM + (len(lines) - 1) * _LINE_STEP_MM + _LINE_MM
    if height_mm > LARGEST_MM:
        raise PageError(
            f"the text has {len(lines)} lines, a page of {height_mm:.0f} mm: shorten it"
        )
    sheet = Image.new("L", (round(_PRINT_WIDTH_MM * per_mm), round(height_mm * per_mm)), 255)
    draw = ImageDraw.Draw(sheet)
    for index, line in enumerate(lines):
        top = (_MARGIN_MM + index * _LINE_STEP_MM) * per_mm
        draw.text((_MARGIN_MM * per_mm, top), line, fill=15, font=font)
    return Page(np.asarray(sheet), 1 / per_mm)


def _require_size(path: Path, size: tuple[int, int]) -> None:
    width, height = size
    if width * height > MOST_PIXELS:
        raise PageError(
            f"{path} has {width} x {height} pixels, above the limit of "
            f"{MOST_PIXELS // 10**6} megapixels: make it smaller first"
        )
    if min(size) < FEWEST_PIXELS:
        raise PageError(
            f"{path} has {width} x {height} pixels: a page needs at least "
            f"{FEWEST_PIXELS} x {FEWEST_PIXELS}"
        )


def _to_grey(image: Image.Image) -> NDArray[np.uint8]:
    image = ImageOps.exif_transpose(image)
    if image.mode.startswith("I") or image.mode == "F":
        return _from_deep(np.asarray(image, np.float64))
    if image.has_transparency_data:
        image = image.convert("RGBA")
        white = Image.new("RGBA", image.size, (255, 255, 255, 255))
        image = Image.alpha_composite(white, image)
    return np.array(image.convert("L"))


def _from_deep(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    values = np.nan_to_num(values)
    peak = values.max(initial=0)
    # Which white a deep file means is not written in it: the smallest usual one that holds it.
    full = next((each for each in (1.0, 255.0, 65535.0) if peak <= each), peak)
    return np.asarray(np.clip(np.rint(values * (255 / full)), 0, 255), np.uint8)


def _scale(
    path: Path,
    width: int,
    height: int,
    dpi: float | None,
    page_width_mm: float | None,
    stated: object,
) -> float:
    if dpi is not None:
        if not 0 < dpi < float("inf"):
            raise PageError(f"--dpi {dpi:g} must be above 0")
        scale = _INCH_MM / dpi
    elif page_width_mm is not None:
        if not 0 < page_width_mm < float("inf"):
            raise PageError(f"--page-width-mm {page_width_mm:g} must be above 0")
        scale = page_width_mm / width
    else:
        own = float(stated[0]) if isinstance(stated, tuple) else 0.0
        if not own >= _LEAST_BELIEVED_DPI or own == 72:
            raise PageError(f"{path} does not say how large it is: give --dpi or --page-width-mm")
        scale = _INCH_MM / own
    width_mm, height_mm = width * scale, height * scale
    if max(width_mm, height_mm) > LARGEST_MM or min(width_mm, height_mm) < SMALLEST_MM:
        raise PageError(
            f"{path} would be {width_mm:.4g} x {height_mm:.4g} mm: give a --dpi or "
            f"--page-width-mm that makes it {SMALLEST_MM:g} to {LARGEST_MM:g} mm"
        )
    return scale
