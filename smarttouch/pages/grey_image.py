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
from PIL import ExifTags, Image, ImageOps, ImageSequence, UnidentifiedImageError

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
_CONTRAST = 64  # range of levels of a picture that contains print
_THICK = 8  # strokes are thinner than the shorter side divided by this
_ALPHA_IS_INK = -1
"""Ground of thin print, which may have several colors, even black and white: use its alpha."""
_NO_PAGE = 1 | 4  # bits of reduced images and masks in the NewSubfileType of a TIFF
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
        self._mix = 0
        self._ground: int | None = None

    def convert(self, pixels: Pixels) -> NDArray[np.uint8]:
        """Convert an image to gray levels, (H, W) uint8.

        Parameters
        ----------
        pixels : ndarray, (H, W) or (H, W, C)
            Grey, grey and alpha, RGB or RGBA: bool, integers of any depth, or floating point.
        """
        pixels = np.atleast_3d(pixels)
        if pixels.dtype.kind == "f":
            # The difference of float32 numbers may overflow float32.
            pixels = np.nan_to_num(pixels.astype(np.float64), nan=0, posinf=0, neginf=0)
        colors, alpha = np.split(pixels, [pixels.shape[2] - 1 | 1], axis=2)
        if colors.dtype != np.uint8:
            self._black = min(self._black, float(colors.min()))
            self._white = max(self._white, _white_level(colors, self._black))
            colors = _scaled(colors, self._black, self._white)
        if alpha.size:
            alpha = _scaled(alpha, 0.0, _white_level(alpha))
            # Ignore invisible colors.
            colors = np.where(alpha > 0, colors, np.uint8(0))
        grey = colors[:, :, 0]
        if colors.shape[2] > 1:
            self._mix = _best_mix(colors, self._mix)
            grey = np.asarray(cv2.transform(colors, _MIXES[self._mix][None]), np.uint8)
        return self._opaque(grey, alpha[:, :, 0]) if alpha.size and alpha.min() < 255 else grey

    def _opaque(self, grey: NDArray[np.uint8], alpha: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Lay a transparent image on a ground on which its print is visible."""
        if self._ground is None:
            visible = alpha >= max(1, int(alpha.max()) // 2)
            depth = cv2.distanceTransform(np.pad(visible, 1).astype(np.uint8), cv2.DIST_C, 3)
            levels = grey[visible] if visible.any() else (0, 255, 255)
            low, middle, high = np.percentile(levels, (0.5, 50, 99.5))
            # A picture with print continues around itself; a uniform one is (cut-out) print.
            self._ground = 255 if (middle >= 128) == (high - low >= _CONTRAST) else 0
            if 0 < 2 * depth.max() <= max(3, min(alpha.shape) // _THICK):
                self._ground = _ALPHA_IS_INK
        if self._ground == _ALPHA_IS_INK:
            return np.asarray(255 - alpha, np.uint8)
        laid = self._ground + (grey.astype(np.float32) - self._ground) * (alpha / np.float32(255))
        return np.asarray(np.rint(laid), np.uint8)


def to_grey(pixels: Pixels) -> NDArray[np.uint8]:
    """Convert one image to gray levels, (H, W) uint8, see `GreyConverter.convert`."""
    return GreyConverter().convert(pixels)


def _best_mix(colors: NDArray[np.uint8], present: int) -> int:
    """Return the index of the weights that show most edges of a colored image.

    An edge counts fully at half of its contrast in the best channel. The present weights stay if
    they are nearly as good as the best.
    """
    rows = colors[:: 1 + len(colors) // _SAMPLED_ROWS].astype(np.int16)
    # Diagonal differences show edges in both directions.
    edges = rows[1:, _EDGE_PIXELS:] - rows[:-1, :-_EDGE_PIXELS]
    largest = np.abs(edges).max(axis=2, keepdims=True, initial=0)
    edges, largest = edges[largest[..., 0] >= _EDGE_LEVELS], largest[largest >= _EDGE_LEVELS]
    if len(edges) < _FEWEST_EDGES:
        return present
    shown = np.minimum(1, 2 * np.abs(edges @ _MIXES.T) / largest[:, None]).mean(axis=0)
    shown[present] *= _KEPT
    return int(np.argmax(shown.round(2)))


def _white_level(values: Pixels, black: float = 0.0) -> float:
    """Return the level of white of images that do not state it: the largest value of the fewest
    bits that hold their levels.

    Integers have at least 8 bits, unless they are only 0 and 1.
    """
    peak = float(values.max()) - black
    least = 1 if values.dtype.kind == "f" or peak <= 1 else 255
    return peak if black < 0 < peak else float(max(least, 2 ** int(peak).bit_length() - 1))


def _scaled(values: Pixels, black: float, white: float) -> NDArray[np.uint8]:
    levels = (values - np.float32(black)) * (255 / white)
    return np.asarray(np.clip(np.rint(levels), 0, 255), np.uint8)


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
    if image.format != "TIFF":
        return [0]
    frames: Any = ImageSequence.Iterator(image)
    kinds = [frame.tag_v2.get(ExifTags.Base.NewSubfileType, 0) for frame in frames]
    return [k for k, kind in enumerate(kinds) if not kind & _NO_PAGE] or list(range(len(kinds)))


def read_pixels(image: Image.Image) -> Pixels:
    """Return the pixels of an open image, upright and at full depth: gray (H, W), gray with alpha,
    RGB or RGBA."""
    is_deep = any(";16" in str(tile) for tile in getattr(image, "tile", ()))
    colors = _deep_colors(image) if is_deep and image.mode[0] not in "IF" else None
    upright = ImageOps.exif_transpose(image)
    if image.mode[0] in "IF":
        values = np.asarray(upright)
        if getattr(image, "tag_v2", {}).get(ExifTags.Base.PhotometricInterpretation) == 0:
            # Pillow inverts such images only with 8 bits.
            values = np.asarray(_white_level(values)).astype(values.dtype) - values
        hidden = image.info.get("transparency")
        return np.dstack([values, values != hidden]) if isinstance(hidden, int) else values
    mode = "RGBA" if upright.has_transparency_data else "L" if upright.mode in ("1", "L") else "RGB"
    pixels = np.asarray(upright.convert(mode))
    return pixels if colors is None else np.dstack([colors, pixels[..., 3:]])


def _deep_colors(image: Image.Image) -> Pixels:
    """Read the colors of a 16-bit image by OpenCV, upright. Pillow reads only the upper bytes."""
    file: Any = getattr(image, "fp", None)
    place = file.tell()
    file.seek(0)
    data, flags = np.frombuffer(file.read(), np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH
    file.seek(place)
    is_read, pages = cv2.imdecodemulti(data, flags, None, (image.tell(), image.tell() + 1))
    if not is_read:
        raise ValueError("its pixels are damaged")
    return np.asarray(pages[0])[..., ::-1]
