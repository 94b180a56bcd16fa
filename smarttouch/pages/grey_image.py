"""Grey levels of 8 bits from any image of a file, a camera or a program."""

import itertools
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

Pixels = NDArray[Any]

LUMA = np.array([0.299, 0.587, 0.114])
"""Weights of red, green and blue, ITU-R BT.601."""
_STEPS = (0.0, 0.25, 0.5, 0.75, 1.0)
_MIXES = np.array([mix for mix in itertools.product(_STEPS, repeat=3) if sum(mix) == 1])
_MIXES = np.vstack([LUMA, _MIXES[np.abs(_MIXES - LUMA).sum(axis=1).argsort(kind="stable")]])
"""Weights that may show colored print, the nearest to luma first: paper stays white."""
_KEPT = 0.95  # share of the best contrast from which the present weights stay
_AS_GOOD = 0.01  # difference of contrast below which mixes are equally good
_EDGE_LEVELS = 40  # difference of a channel from which two pixels are an edge
_EDGE_PIXELS = 3  # distance of the two pixels
_FEWEST_EDGES, _MOST_EDGES = 50, 4000
_SAMPLED = 40_000  # pairs of pixels across, and as many down, that are looked at
_BRIGHTEST = 0.999  # quantile of floating-point levels that is white: highlights may be above
_CONTRAST = 64  # levels between the darkest and the brightest of a picture that carries print
_THICK = 8
"""Strokes are thinner than the image's shorter side divided by this."""
_WHITE_IS_ZERO = 262, 0  # photometric interpretation of a TIFF
ORIENTATION = 0x0112  # EXIF tag; 5 and above lay the rows of the file upright
_MIRRORED = {
    2: (-1, 1), 3: (-1, -1), 4: (1, -1), 5: (1, 1), 6: (-1, 1), 7: (-1, -1), 8: (1, -1),
}  # fmt: skip
"""Steps across and down for each orientation; from 5 on after rows are made columns."""


class GreyConverter:
    """Converts the images of one source to grey levels.

    What images do not state is decided by the first one that needs it, and kept for the next:
    the level of white, the ground below transparent images, and the weights of the colors. White
    and the weights change only where a later image requires it.
    """

    def __init__(self) -> None:
        self._white = self._black = 0.0
        self._alpha_is_ink: bool | None = None
        self._ground = 255
        self._weights = LUMA

    def convert(self, pixels: Pixels) -> NDArray[np.uint8]:
        """Return an image in grey, (H, W) uint8.

        Parameters
        ----------
        pixels : ndarray, (H, W) or (H, W, C)
            Grey, grey and alpha, RGB or RGBA: bool, integers of any depth, or floating point.
        """
        if pixels.ndim == 2:
            pixels = pixels[:, :, None]
        if pixels.dtype.kind == "f":
            pixels = np.where(np.isfinite(pixels), pixels, 0)
        channels = pixels.shape[2]
        alpha = None
        if channels in (2, 4):
            alpha = _scaled(pixels[:, :, -1], 0.0, _white_level(pixels[:, :, -1]))
            channels -= 1
        levels = self._levels(pixels[:, :, :channels])
        if alpha is not None and alpha.size and alpha.min() < 255:
            return self._laid_down(levels, alpha)
        return self._mixed(levels)

    def _levels(self, colors: Pixels) -> NDArray[np.uint8]:
        """Return an image of any depth in 8 bits."""
        if colors.dtype == np.uint8:
            return np.ascontiguousarray(colors)
        self._black = min(self._black, float(colors.min(initial=0)))
        self._white = max(self._white, _white_level(colors, self._black))
        return _scaled(colors, self._black, self._white)

    def _laid_down(self, levels: NDArray[np.uint8], alpha: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a transparent image on a ground on which its print is seen."""
        if self._alpha_is_ink is None:
            self._choose_ground(levels, alpha)
        if self._alpha_is_ink:
            return np.asarray(255 - alpha, np.uint8)
        # Colors that nobody sees do not count.
        seen = np.where(alpha[:, :, None] > 0, levels, np.uint8(self._ground))
        grey = self._mixed(seen).astype(np.float32) - self._ground
        return np.asarray(np.rint(self._ground + grey * (alpha / np.float32(255))), np.uint8)

    def _choose_ground(self, levels: NDArray[np.uint8], alpha: NDArray[np.uint8]) -> None:
        visible = alpha >= max(1, int(alpha.max()) // 2)
        side = max(3, min(alpha.shape) // _THICK)
        # Without a border, so that print that touches the edge is thin as well.
        thick = cv2.erode(
            visible.astype(np.uint8), np.ones((side, side), np.uint8), borderValue=0,
            borderType=cv2.BORDER_CONSTANT,
        )  # fmt: skip
        # Thin print may be of any color, also black and white at once: its alpha is its ink.
        self._alpha_is_ink = bool(visible.any() and not thick.any())
        if visible.any():
            low, middle, high = np.percentile(levels[visible], (0.5, 50, 99.5))
            # A picture with print goes on around itself; an even one is print, or print cut out.
            self._ground = 255 if (middle >= 128) == (high - low >= _CONTRAST) else 0

    def _mixed(self, levels: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return colors as grey; where luma shows no print, by weights that do."""
        if levels.shape[2] == 1:
            return levels[:, :, 0]
        self._weights = _weights(levels, self._weights)
        if self._weights is LUMA:
            return np.asarray(cv2.cvtColor(levels, cv2.COLOR_RGB2GRAY), np.uint8)
        return np.asarray(cv2.transform(levels, self._weights[None]), np.uint8)


def to_grey(pixels: Pixels) -> NDArray[np.uint8]:
    """Return one image in grey, (H, W) uint8; see `GreyConverter.convert`."""
    return GreyConverter().convert(pixels)


def _weights(levels: NDArray[np.uint8], present: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the weights by which most edges of a colored image are seen, (3,).

    An edge counts in full with half the contrast that it has in its best channel. The present
    weights stay if they show nearly as much as the best.
    """
    step = max(1, levels.shape[0] * levels.shape[1] // _SAMPLED)
    across, down = levels[::step], levels[:, ::step]
    edges = np.concatenate([
        _edges(across[:, _EDGE_PIXELS:], across[:, :-_EDGE_PIXELS]),
        _edges(down[_EDGE_PIXELS:], down[:-_EDGE_PIXELS]),
    ])  # fmt: skip
    if len(edges) < _FEWEST_EDGES:
        return present
    edges = edges[:: 1 + len(edges) // _MOST_EDGES]
    contrast = np.abs(edges @ np.vstack([present, _MIXES]).T)
    contrast /= np.abs(edges).max(axis=1, keepdims=True)
    now, *shown = np.minimum(1, 2 * contrast).mean(axis=0)
    if now >= _KEPT * max(shown):
        return present
    best = int(np.argmax(np.array(shown) >= max(shown) - _AS_GOOD))
    return _MIXES[best] if best else LUMA


def _edges(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the differences of color where they are large, (N, 3)."""
    red, green, blue = np.moveaxis(np.maximum(first, second) - np.minimum(first, second), 2, 0)
    is_edge = np.maximum(np.maximum(red, green), blue) >= _EDGE_LEVELS
    return np.asarray(first[is_edge].astype(np.float32) - second[is_edge])


def _white_level(values: Pixels, black: float = 0.0) -> float:
    """Return the white of images that do not state it: the fewest bits that hold their levels.

    Integers have at least 8 bits, unless they are 0 and 1 alone.
    """
    if values.dtype.kind == "f":
        some = values.ravel()[:: max(1, values.size // 1_000_000)].astype(np.float64)
        peak = float(np.quantile(some, _BRIGHTEST)) - black if some.size else 0.0
        if black < 0 < peak:
            return peak
        if 0 < peak < 1:
            return float(2.0 ** np.ceil(np.log2(peak)))
        return float(max(1, 2 ** int(peak).bit_length() - 1))
    peak = int(values.max(initial=0)) - int(black)
    return 1.0 if peak <= 1 else float(max(255, 2 ** peak.bit_length() - 1))


def _scaled(values: Pixels, black: float, white: float) -> NDArray[np.uint8]:
    if values.dtype == np.uint8 and white == 255:
        return np.asarray(values)
    # The span of numbers in single precision is beyond single precision.
    kind: Any = np.float64 if values.dtype.kind == "f" else np.float32
    levels = (values.astype(kind) - kind(black)) * kind(255 / white)
    return np.asarray(np.clip(np.rint(levels, out=levels), 0, 255), np.uint8)


def read_pixels(image: Image.Image) -> Pixels:
    """Return an open image upright, at its full depth: grey (H, W), with alpha, RGB or RGBA."""
    if image.mode.startswith("I") or image.mode == "F":
        return _deep_grey(image)
    if any(";16" in str(tile) for tile in getattr(image, "tile", ())):
        return _deep_color(image)
    upright = ImageOps.exif_transpose(image)
    if upright.mode == "LAB":
        return np.asarray(upright.getchannel("L"))
    if upright.has_transparency_data:
        # Plain alpha, instead of colors that are multiplied by it.
        plain = upright.convert({"La": "LA", "RGBa": "RGBA"}.get(upright.mode, upright.mode))
        return np.asarray(plain.convert("RGBA"))
    return np.asarray(upright.convert("L" if upright.mode in ("1", "L") else "RGB"))


def _deep_grey(image: Image.Image) -> Pixels:
    values = np.asarray(ImageOps.exif_transpose(image))
    tag, zero = _WHITE_IS_ZERO
    if getattr(image, "tag_v2", {}).get(tag) == zero:
        # Pillow inverts such images of 8 bits only.
        values = np.asarray(_white_level(values)).astype(values.dtype) - values
    hidden = image.info.get("transparency")
    return np.dstack([values, values != hidden]) if isinstance(hidden, int) else values


def _deep_color(image: Image.Image) -> Pixels:
    """Return an image of 16 bits in color by OpenCV: Pillow reads their upper bytes only."""
    file: Any = getattr(image, "fp", None)
    page, orientation = image.tell(), image.getexif().get(ORIENTATION, 1)
    file.seek(0)
    data = np.frombuffer(file.read(), np.uint8)
    found, pages = cv2.imdecodemulti(data, cv2.IMREAD_UNCHANGED, None, (page, page + 1))
    if not found:
        raise ValueError("its pixels are damaged")
    pixels = np.asarray(pages[0])
    pixels = pixels[..., [2, 1, 0, 3][: pixels.shape[2]]]
    if image.format == "TIFF" or orientation not in _MIRRORED:
        # OpenCV has turned it.
        return pixels
    across, down = _MIRRORED[orientation]
    return (pixels.swapaxes(0, 1) if orientation >= 5 else pixels)[::down, ::across]
