"""Reading of image files, and conversion of images to 8-bit gray levels."""

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
MOST_PIXELS = 100_000_000  # largest number of pixels of a page
_MIXES = np.vstack([(0.299, 0.587, 0.114), np.eye(3)[[1, 0, 2]], (1 - np.eye(3)) / 2])
"""Candidate weights of red, green and blue: luma (ITU-R BT.601), one channel, or mean of two."""
_AROUND = np.ones((5, 5), np.uint8)  # neighborhood of a pixel for the detection of edges
_EDGE_LEVELS = 40  # smallest difference of gray levels that counts as an edge
_FEWEST_EDGES = 50  # smallest number of edge pixels from which color weights are chosen
_PRINT_SHARE = 0.1  # an area shows print if its ratio of edge pixels to outline pixels exceeds this
_NO_PAGE = 1 | 4  # bits in a TIFF's NewSubfileType that mark thumbnails and masks
_DAMAGES = (OSError, SyntaxError, ValueError, TypeError, LookupError, EOFError, struct.error)
"""Exceptions of Pillow for damaged files."""


class GreyConverter:
    """Converter of the images of one source to gray levels.

    The converter chooses the level of white, the background of transparent pixels and the weights
    of colors when an image first needs them, and keeps them. If a later image is brighter, the
    converter raises the level of white. If edges would be lost, it chooses new weights.
    """

    def __init__(self) -> None:
        self._black, self._white = 0.0, np.float64(0)
        self._mix = 0
        self._ground: tuple[int, int | None] | None = None  # result of `_ground`

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
            # Ignore the colors of invisible pixels.
            colors = np.where(alpha > 0, colors, np.uint8(0))
        grey = colors[:, :, 0]
        if colors.shape[2] > 1:
            self._mix = _best_mix(colors, self._mix)
            grey = np.asarray(cv2.transform(colors, _MIXES[self._mix][None]), np.uint8)
        if not alpha.size or alpha.min() == 255:
            return grey
        if self._ground is None:
            self._ground = _ground(grey, alpha[:, :, 0])
        ground, level = self._ground
        contrast = (grey.astype(np.float32) if level is None else level) - np.float32(ground)
        return np.asarray(np.rint(ground + contrast * alpha[:, :, 0] / 255), np.uint8)


def _ground(grey: NDArray[np.uint8], alpha: NDArray[np.uint8]) -> tuple[int, int | None]:
    """Return two levels for a transparent image: for its background, and for all visible pixels.
    The second level is None if visible pixels show print on paper. They then keep their levels."""
    visible = np.asarray(alpha >= max(1, int(alpha.max()) // 2), np.uint8)
    inner = cv2.erode(visible, _AROUND) > 0
    edges = cv2.morphologyEx(grey, cv2.MORPH_GRADIENT, _AROUND)[inner] >= _EDGE_LEVELS
    if edges.sum() > _PRINT_SHARE * (visible.sum() - inner.sum()):
        # The visible pixels show print on paper. Paper is white or black.
        return (255, None) if np.median(grey[inner]) >= 128 else (0, None)
    return (0, 255) if alpha.mean() >= 128 else (255, 0)


def _best_mix(colors: NDArray[np.uint8], present: int) -> int:
    """Return the index of the weights that preserve edges best, or ``present`` if nearly as good.
    An edge is preserved if it has at least half of the largest contrast that any weights give."""
    mixed = cv2.transform(colors[:: 1 + len(colors) // 400], _MIXES)
    edges = cv2.morphologyEx(mixed, cv2.MORPH_GRADIENT, _AROUND)
    edges = edges[edges.max(axis=2) >= _EDGE_LEVELS].astype(np.float32)
    if len(edges) < _FEWEST_EDGES:
        return present
    shown = np.minimum(1, 2 * edges / edges.max(axis=1, keepdims=True)).mean(axis=0)
    return int(np.argmax(shown)) if shown[present] < 0.95 * shown.max() else present


def _white_level(values: Pixels, black: float = 0.0) -> np.float64:
    """Return the level of white, such as 255 for 8 bits; the largest level suggests the bit depth.
    If the smallest level, ``black``, is negative, return the largest level minus ``black``."""
    peak = float(values.max()) - black
    least = 1 if values.dtype.kind == "f" or peak <= 1 else 255
    # A level below 1e-30 would overflow single precision when gray levels are scaled to it.
    usual = max(least, 2 ** int(peak).bit_length() - 1)
    return np.float64(max(peak, 1e-30) if black < 0 < peak else usual)


def _scaled(values: Pixels, black: float, white: float) -> NDArray[np.uint8]:
    levels = (values - np.float32(black)) * np.float32(255 / white)
    return np.asarray(np.clip(np.rint(levels), 0, 255), np.uint8)


@contextmanager
def open_image(path: Path) -> Iterator[Image.Image]:
    """Open an image for a ``with`` block. Pillow's errors, also in the block, become PageErrors."""
    try:
        with warnings.catch_warnings():
            # Ignore warnings: sizes are checked later, and damage raises errors or is harmless.
            warnings.filterwarnings("ignore", module=r"PIL\.")
            # Do not let Pillow 13 open the file: it would map the file to memory, and read rotated
            # TIFFs wrongly.
            with open_file(path, PageError, MOST_DOCUMENT_BYTES) as file, Image.open(file) as image:
                yield image
    except UnidentifiedImageError:
        message = f"{path} is not a readable image or document: give a PDF, PNG, JPEG or TIFF"
        raise PageError(message) from None
    except Image.DecompressionBombError:
        message = f"{path} has over {MOST_PIXELS // 10**6} megapixels: reduce its size first"
        raise PageError(message) from None
    except _DAMAGES as error:
        raise PageError(f"{path} cannot be read: {error}") from None


def page_frames(image: Image.Image) -> list[int]:
    """Return the indexes of the pages in an open image. In a TIFF, pages are all frames except
    thumbnails and masks. In other images, the first frame is the only page."""
    frames: Any = ImageSequence.Iterator(image) if image.format == "TIFF" else []
    kinds = [frame.tag_v2.get(ExifTags.Base.NewSubfileType, 0) for frame in frames]
    return [k for k, kind in enumerate(kinds) if not kind & _NO_PAGE] or [*range(len(kinds) or 1)]


def read_pixels(image: Image.Image) -> Pixels:
    """Return the pixels of an open image, upright and at full depth: gray (H, W), RGB or RGBA."""
    is_deep = any(";16" in str(tile) for tile in getattr(image, "tile", ()))
    file, frame = getattr(image, "fp", None), image.tell()
    upright = ImageOps.exif_transpose(image)
    if image.mode[0] in "IF":
        pixels = np.asarray(upright)
        if getattr(image, "tag_v2", {}).get(ExifTags.Base.PhotometricInterpretation) != 0:
            return pixels
        # In this image 0 is white. Pillow inverts such images only if they have 8 bits.
        return np.asarray(_white_level(pixels).astype(pixels.dtype) - pixels)
    mode = "RGBA" if upright.has_transparency_data else "L" if upright.mode in ("1", "L") else "RGB"
    pixels = np.asarray(upright.convert(mode))
    if not is_deep or file is None:
        return pixels
    # Pillow reads only the upper byte of 16-bit colors, so read them with OpenCV.
    data, flags = np.fromfile(file.name, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH
    is_read, pages = cv2.imdecodemulti(data, flags, None, (frame, frame + 1))
    if not is_read:
        raise ValueError("the pixels are damaged")
    return np.dstack([pages[0][..., ::-1], pixels[..., 3:]])
