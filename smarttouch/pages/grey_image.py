"""Conversion of images from files, cameras and programs to 8-bit gray levels."""

import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image, ImageOps, UnidentifiedImageError

from smarttouch.base.errors import PageError
from smarttouch.base.files import MOST_DOCUMENT_BYTES, open_file

Pixels = NDArray[Any]

MOST_PIXELS = 100_000_000  # of a page
LUMA = np.array([0.299, 0.587, 0.114])
"""Weights of red, green and blue, ITU-R BT.601."""
_MIXES = np.vstack([LUMA, np.eye(3)[[1, 0, 2]], (1 - np.eye(3)) / 2])
"""Weights that may show colored print, luma first; white stays white."""
_KEPT = 1.05  # factor by which other weights must be better
_EDGE_LEVELS, _EDGE_PIXELS, _FEWEST_EDGES = 40, 3, 50
"""Smallest difference in a channel, distance of the two pixels, and number of edges considered."""
_SAMPLED_ROWS = 400
_BRIGHTEST = 0.999  # quantile of floating-point levels that is white, below highlights
_CONTRAST = 64  # range of levels of a picture that contains print
_THICK = 8  # strokes are thinner than the shorter side divided by this
_WHITE_IS_ZERO = 262, 0  # photometric interpretation of a TIFF
_SUBFILE, _NO_PAGE = 254, 1 | 4  # tag of a TIFF; bits of reduced images and masks
_DAMAGES = (OSError, SyntaxError, ValueError, TypeError, LookupError, EOFError, struct.error)
"""Exceptions of Pillow for damaged files."""


class GreyConverter:
    """Converts the images of one source to gray levels.

    Images may not state the level of white, the background of transparency and the weights of
    colors. These are chosen for the first image that needs them, and kept for later ones. White and
    weights change only if a later image requires it.
    """

    def __init__(self) -> None:
        self._white = self._black = 0.0
        self._ground: int | None = None
        self._alpha_is_ink = False
        self._mix = 0

    def convert(self, pixels: Pixels) -> NDArray[np.uint8]:
        """Convert an image to gray levels, (H, W) uint8.

        Parameters
        ----------
        pixels : ndarray, (H, W) or (H, W, C)
            Grey, grey and alpha, RGB or RGBA: bool, integers of any depth, or floating point.
        """
        if pixels.ndim == 2:
            pixels = pixels[:, :, None]
        if pixels.dtype.kind == "f":
            pixels = np.where(np.isfinite(pixels), pixels, 0)
        colors = pixels[:, :, : pixels.shape[2] - 1 | 1]
        if colors.dtype != np.uint8:
            self._black = min(self._black, float(colors.min(initial=0)))
            self._white = max(self._white, _white_level(colors, self._black))
            colors = _scaled(colors, self._black, self._white)
        if colors.shape[2] == pixels.shape[2]:
            return self._mixed(colors)
        alpha = _scaled(pixels[:, :, -1], 0.0, _white_level(pixels[:, :, -1]))
        if self._ground is None and alpha.min(initial=255) < 255:
            self._choose_ground(colors, alpha)
        if self._alpha_is_ink:
            return np.asarray(255 - alpha, np.uint8)
        # Ignore invisible colors.
        ground = self._ground or 0
        grey = self._mixed(np.where(alpha[:, :, None] > 0, colors, np.uint8(ground)))
        laid = ground + (grey.astype(np.float32) - ground) * (alpha / np.float32(255))
        return np.asarray(np.rint(laid), np.uint8)

    def _choose_ground(self, colors: NDArray[np.uint8], alpha: NDArray[np.uint8]) -> None:
        """Choose a background on which the print of a transparent image is visible."""
        visible = alpha >= max(1, int(alpha.max()) // 2)
        deepest = cv2.distanceTransform(np.pad(visible, 1).astype(np.uint8), cv2.DIST_C, 3).max()
        # Thin print may have several colors, even black and white: use its alpha as ink.
        self._alpha_is_ink = bool(0 < 2 * deepest <= max(3, min(alpha.shape) // _THICK))
        low, middle, high = np.percentile(colors[visible], (0.5, 50, 99.5)) if visible.any() else (
            0, 255, 255
        )  # fmt: skip
        # A picture with print continues around itself; a uniform one is print, or cut-out print.
        self._ground = 255 if (middle >= 128) == (high - low >= _CONTRAST) else 0

    def _mixed(self, colors: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Convert colors to gray, by luma or by weights that show the print better."""
        if colors.shape[2] == 1:
            return colors[:, :, 0]
        colors = np.ascontiguousarray(colors)
        self._mix = _best_mix(colors, self._mix)
        if self._mix == 0:
            return np.asarray(cv2.cvtColor(colors, cv2.COLOR_RGB2GRAY), np.uint8)
        return np.asarray(cv2.transform(colors, _MIXES[self._mix][None]), np.uint8)


def to_grey(pixels: Pixels) -> NDArray[np.uint8]:
    """Convert one image to gray levels, (H, W) uint8, see `GreyConverter.convert`."""
    return GreyConverter().convert(pixels)


def _best_mix(colors: NDArray[np.uint8], present: int) -> int:
    """Return the index of the weights that show most edges of a colored image.

    An edge counts fully at half of its contrast in the best channel. The present weights stay if
    they are nearly as good as the best.
    """
    far, step = _EDGE_PIXELS, 1 + len(colors) // _SAMPLED_ROWS
    # Diagonal differences show edges in both directions.
    first, second = colors[far::step, far:], colors[:-far:step, :-far]
    height = min(len(first), len(second))
    edges = first[:height].astype(np.int16) - second[:height]
    edges = edges[np.abs(edges).max(axis=2) >= _EDGE_LEVELS]
    if len(edges) < _FEWEST_EDGES:
        return present
    contrast = np.abs(edges @ _MIXES.T) / np.abs(edges).max(axis=1, keepdims=True)
    shown = np.minimum(1, 2 * contrast).mean(axis=0)
    shown[present] *= _KEPT
    return int(np.argmax(shown.round(2)))


def _white_level(values: Pixels, black: float = 0.0) -> float:
    """Return the level of white of images that do not state it: the largest value of the fewest
    bits that hold their levels.

    Integers have at least 8 bits, unless they are only 0 and 1.
    """
    if values.dtype.kind == "f":
        some = values.ravel()[:: max(1, values.size // 1_000_000)].astype(np.float64)
        peak = float(np.quantile(some, _BRIGHTEST)) - black if some.size else 0.0
        return peak if black < 0 < peak else float(max(1, 2 ** int(peak).bit_length() - 1))
    peak = int(values.max(initial=0)) - int(black)
    return 1.0 if peak <= 1 else float(max(255, 2 ** int(peak).bit_length() - 1))


def _scaled(values: Pixels, black: float, white: float) -> NDArray[np.uint8]:
    # The difference of float32 numbers may overflow float32.
    kind: Any = np.float64 if values.dtype.kind == "f" else np.float32
    levels = (values.astype(kind) - kind(black)) * kind(255 / white)
    return np.asarray(np.clip(np.rint(levels, out=levels), 0, 255), np.uint8)


@contextmanager
def open_image(path: Path) -> Iterator[Image.Image]:
    """Open an image file; exceptions of Pillow, also within the block, become PageErrors."""
    try:
        with warnings.catch_warnings():
            # Sizes are checked later; damage raises errors or is harmless.
            warnings.filterwarnings("ignore", module=r"PIL\.")
            # Open the file here: with a path, Pillow 13 maps it to memory and reads rotated TIFFs
            # wrongly.
            with open_file(path, PageError, MOST_DOCUMENT_BYTES) as file, Image.open(file) as image:
                yield image
    except Image.DecompressionBombError:
        message = f"{path} is above {MOST_PIXELS // 10**6} megapixels: make it smaller first"
        raise PageError(message) from None
    except UnidentifiedImageError:
        message = f"{path} is not a readable image or document: give a PDF, PNG, JPEG or TIFF"
        raise PageError(message) from None
    except _DAMAGES as error:
        raise PageError(f"{path} cannot be read: {error}") from None


def page_frames(image: Image.Image) -> list[int]:
    """Return the frames of an open image that are pages: for a TIFF without thumbnails and masks;
    for an animation the first."""
    frames = range(getattr(image, "n_frames", 1) if image.format == "TIFF" else 1)
    pages = []
    for frame in frames:
        image.seek(frame)
        if not getattr(image, "tag_v2", {}).get(_SUBFILE, 0) & _NO_PAGE:
            pages.append(frame)
    return pages or list(frames)


def read_pixels(image: Image.Image) -> Pixels:
    """Return the pixels of an open image, upright and at full depth: gray (H, W), gray with alpha,
    RGB or RGBA."""
    if any(";16" in str(tile) for tile in getattr(image, "tile", ())) and image.mode[0] not in "IF":
        return _deep_color(image)
    upright = ImageOps.exif_transpose(image)
    if image.mode[0] in "IF":
        values = np.asarray(upright)
        tag, zero = _WHITE_IS_ZERO
        if getattr(image, "tag_v2", {}).get(tag) == zero:
            # Pillow inverts such images only with 8 bits.
            values = np.asarray(_white_level(values)).astype(values.dtype) - values
        hidden = image.info.get("transparency")
        return np.dstack([values, values != hidden]) if isinstance(hidden, int) else values
    mode = "RGBA" if upright.has_transparency_data else "L" if upright.mode in ("1", "L") else "RGB"
    return np.asarray(upright.convert(mode))


def _deep_color(image: Image.Image) -> Pixels:
    """Read a color image of 16 bits by OpenCV, as Pillow reads only the upper bytes."""
    file: Any = getattr(image, "fp", None)
    file.seek(0)
    data, page = np.frombuffer(file.read(), np.uint8), image.tell()
    is_read, pages = cv2.imdecodemulti(data, cv2.IMREAD_UNCHANGED, None, (page, page + 1))
    if not is_read:
        raise ValueError("its pixels are damaged")
    pixels = np.asarray(pages[0])[..., [2, 1, 0, 3][: pages[0].shape[2]]]
    # OpenCV rotates TIFFs itself.
    turn = 1 if image.format == "TIFF" else image.getexif().get(ExifTags.Base.Orientation, 1)
    pixels = pixels.swapaxes(0, 1) if turn > 4 else pixels
    return pixels[:: -1 if turn in (3, 4, 7, 8) else 1, :: -1 if turn in (2, 3, 6, 7) else 1]
