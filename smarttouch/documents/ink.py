"""Separation of ink from paper: a page as black on white, under any light."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.documents.letters import find_spots, usual_height

Grey = NDArray[np.uint8]

_REDUCED_PIXELS = 700_000
"""Size of the image in which paper is estimated; light changes slowly."""
_WIDEST = 12
"""Divisor of the page's side for the first window of paper: wider than any stroke."""
_WINDOW = 3.0
"""Second window, in letter heights: shadows are followed, a bold headline is bridged."""
_ROUGHLY_INK = 0.75
"""Part of the paper's level below which is ink, while the height of letters is estimated."""
_GRAIN_PX = 1.2
"""Standard deviation of the blur that reduces the grain of the paper."""
_LEAST_LIGHT = 0.2
"""Part of the brightest paper below which an area is no paper, but the table."""
_DARKEST = 20.0
"""Grey level below which an area is too dark to contain ink."""
_PAPER = 210
"""Level of the paper in the image divided by it: leaves room for noise above."""
_LEAST_CONTRAST = 0.12
"""Least contrast of ink against the paper around it."""
_LEAST_NOISES = 6.0
"""Least contrast of ink, in standard deviations of the paper's grain."""
_WINDOWS = 16
"""Windows across a page in which ink is tested to be darker or lighter than paper."""
_LEAST_SKEW = 0.8
"""Skewness above which print is light on dark: print has 1.5 and more, photographs have less."""
_QUARTILES = 1.349
"""Between the quartiles of a normal distribution, in standard deviations."""
_BRIGHT = 0.7
"""Part of the paper's level above which is mostly paper."""


@dataclass(frozen=True, eq=False)
class Paper:
    """Ink of a page, and its levels.

    Attributes
    ----------
    cleaned : ndarray, (H, W) uint8
        The page as dark on light: paper is exactly 255, ink is near 0, edges keep their grades.
    ink : ndarray, (H, W) bool
        Mask of ink; empty on blank paper.
    light_on_dark : bool
        Whether it was printed light on dark, and is inverted here.
    """

    cleaned: Grey
    ink: NDArray[np.bool_]
    light_on_dark: bool


def separate_ink(grey: Grey, light_on_dark: bool | None = None) -> Paper:
    """Separate ink from paper.

    The page is divided by its paper, as it would look without ink; then the
    threshold is Otsu's, over ink and as much of the paper.

    Parameters
    ----------
    grey : ndarray, (H, W) uint8
        Bright is white.
    light_on_dark : bool, optional
        Whether it is printed light on dark; found out if not given.
    """
    if light_on_dark is None:
        light_on_dark = is_light_on_dark(grey)
    if light_on_dark:
        grey = np.asarray(cv2.bitwise_not(grey), np.uint8)
    flat = _divided(grey, paper_of(grey))
    levels = _levels(flat)
    if levels is None:
        blank = np.full_like(grey, 255)
        return Paper(blank, np.zeros(grey.shape, np.bool_), light_on_dark)
    black, threshold, white = levels
    stretch = np.clip((np.arange(256) - black) * (255 / (white - black)), 0, 255)
    cleaned = np.asarray(cv2.LUT(flat, np.rint(stretch).astype(np.uint8)), np.uint8)
    return Paper(cleaned, flat <= threshold, light_on_dark)


def paper_of(grey: Grey) -> Grey:
    """Return the page without ink, reduced in size, inverted if ink is light.

    Dark spots narrower than a window are closed. The window is taken
    from the height of the letters, which are first looked for with a wide one.
    """
    small = reduced(grey, _REDUCED_PIXELS)
    side = math.sqrt(small.size) / _WIDEST
    paper = _closed(small, side)
    spots = find_spots(small < _ROUGHLY_INK * paper)
    height = usual_height(spots, small.shape)
    if height is not None and _WINDOW * height < side:
        paper = _closed(small, max(_WINDOW * height, 9.0))
    return paper


def is_light_on_dark(grey: Grey) -> bool:
    """Return whether a page is printed light on dark.

    Around print most is paper: the few levels of ink lie far from the mean,
    on the dark side of it for dark print. The third moment of the levels in a
    window gives the side; where there is no print, or the edge of a sheet on a
    darker table, it is small or cancels.
    """
    small = reduced(grey, _REDUCED_PIXELS).astype(np.float32)
    side = max(3, round(math.sqrt(small.size) / _WINDOWS)) | 1
    window = (side, side)
    mean = cv2.blur(small, window)
    square = cv2.blur(small * small, window)
    cube = cv2.blur(small * small * small, window)
    variance = np.maximum(square - mean * mean, 1.0)
    third = cube - 3 * mean * square + 2 * mean**3
    return bool((third / variance).sum() > _LEAST_SKEW * np.sqrt(variance).sum())


def reduced(grey: Grey, pixels: int) -> Grey:
    """Return an image of at most so many pixels, averaged."""
    factor = math.sqrt(grey.size / pixels)
    if factor <= 1:
        return grey
    size = (max(1, round(grey.shape[1] / factor)), max(1, round(grey.shape[0] / factor)))
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)


def _closed(small: Grey, side_px: float) -> Grey:
    """Return the image without dark spots narrower than a window."""
    side = max(3, round(side_px)) | 1
    square = cv2.getStructuringElement(cv2.MORPH_RECT, (side, side))
    # Closing follows the brightest grains: smooth them first.
    calm = cv2.GaussianBlur(small, (0, 0), _GRAIN_PX)
    closed = cv2.morphologyEx(calm, cv2.MORPH_CLOSE, square, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(cv2.GaussianBlur(closed, (0, 0), side / 6), np.uint8)


def _divided(grey: Grey, paper: Grey) -> Grey:
    """Return the page divided by its paper; blank where it is too dark to be paper."""
    darkest = max(_DARKEST, _LEAST_LIGHT * float(np.percentile(paper, 95)))
    wide = cv2.resize(paper, grey.shape[::-1], interpolation=cv2.INTER_LINEAR)
    flat = cv2.divide(grey, wide, scale=_PAPER)
    _, no_paper = cv2.threshold(wide, darkest, 255, cv2.THRESH_BINARY_INV)
    return np.asarray(cv2.max(flat, no_paper), np.uint8)


def _levels(flat: Grey) -> tuple[float, float, float] | None:
    """Return the levels of full ink, of the threshold and of paper; None without ink."""
    counts = np.bincount(flat.ravel(), minlength=256).astype(np.float64)
    level = np.arange(256)
    # The last level is where no paper was to be seen.
    bright = np.where((level > _BRIGHT * _PAPER) & (level < 255), counts, 0)
    low, middle, high = np.searchsorted(np.cumsum(bright), np.array([1, 2, 3]) / 4 * bright.sum())
    grain = max(float(high - low) / _QUARTILES, 1.0)
    dark = level < middle - max(_LEAST_CONTRAST / 2 * _PAPER, 4 * grain)
    if not (counts[dark].any() and bright.any()):
        return None
    counts[~dark] *= min(1.0, 2 * counts[dark].sum() / counts[~dark].sum())
    threshold = _otsu(counts)
    ink = counts[: threshold + 1]
    mean = float((ink * level[: threshold + 1]).sum() / ink.sum())
    if middle - mean < max(_LEAST_CONTRAST * _PAPER, _LEAST_NOISES * grain):
        return None
    black = float(np.searchsorted(np.cumsum(ink), 0.2 * ink.sum()))
    white = middle - max(2.5 * grain, 0.03 * _PAPER)
    return black, threshold, white


def _otsu(counts: NDArray[np.float64]) -> int:
    """Return the last level of the darker class (Otsu 1979: most variance between classes)."""
    level = np.arange(len(counts))
    below = np.cumsum(counts)
    moment = np.cumsum(counts * level)
    above = below[-1] - below
    both = below * above
    between = (moment * below[-1] - below * moment[-1]) ** 2
    return int(np.divide(between, both, out=np.zeros_like(both), where=both > 0).argmax())
