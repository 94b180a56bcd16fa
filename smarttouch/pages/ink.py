"""Separation of ink from paper in uneven light, for dark print and for light print."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Grey = NDArray[np.uint8]

_WINDOW_PX = 41  # narrower dark spots, such as strokes, are removed to find the paper
_PAPER = 210.0  # gray level of paper after normalization
_CONTRAST = 0.12  # smallest contrast of ink, relative to paper
_PALE = 0.2  # smallest contrast of pale print on a digital page, relative to paper
_GRAINS = 6.0  # smallest contrast of ink, in standard deviations of the paper's grain
_FEWEST = 2e-4  # a page with a smaller share of ink pixels is blank
_CALM = 5.0  # paper with a smaller standard deviation of gray levels has a local threshold
_GRAINY = 9.0  # paper with a larger standard deviation of gray levels has a single threshold


@dataclass(frozen=True, eq=False)
class Paper:
    """Page converted to dark on light, with a mask of its ink."""

    ink: NDArray[np.bool_]  # (H, W); all False on blank paper
    cleaned: Grey  # (H, W), with paper exactly 255 and ink near 0
    light_on_dark: bool
    faint: bool = False  # whether faint marks, such as print on the back, were left out


def separate_ink(grey: Grey, light_on_dark: bool | None = None) -> Paper:
    """Separate ink from paper in an image, (H, W) uint8. By default, detect whether print is light.

    The threshold is about halfway between paper and ink. It follows the contrast of nearby ink, but
    not on grainy paper. Pale print beside black print counts as ink only on paper without grain.
    """
    light_on_dark = is_light_on_dark(grey) if light_on_dark is None else light_on_dark
    grey = ~grey if light_on_dark else grey
    factor = 1 if grey.size < 80_000 else 2 if grey.size < 320_000 else 4
    height, width = (side // factor for side in grey.shape)
    whole = grey[: height * factor, : width * factor]  # OpenCV is fastest with an integer factor
    small = np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    paper = _find_paper(small, min(_WINDOW_PX / factor, math.sqrt(small.size) / 12))
    # Sample single pixels: averages would hide the grain of the paper.
    flat = cv2.resize(grey, paper.shape[::-1], interpolation=cv2.INTER_NEAREST)
    flat = np.where(paper > 0, cv2.divide(flat, paper, scale=_PAPER), np.uint8(255))
    pixels, level = np.append(flat[paper > 0], np.uint8(_PAPER)), np.arange(256)
    counts = np.bincount(pixels, minlength=256)
    bright = np.where(level > 0.7 * _PAPER, counts, 0).cumsum()
    low, middle, high = np.interp(np.array([1, 2, 3]) / 4 * bright[-1], bright, level + 0.5)
    grain = max((high - low) / 1.349, 1.0)  # standard deviation of gray levels, from quartiles
    sure, pale = (middle - max(part * middle, _GRAINS * grain) for part in (_CONTRAST, _PALE))
    otsu, _ = cv2.threshold(pixels, 0, 255, cv2.THRESH_OTSU)
    first = int(min(otsu if grain > 1 else max(otsu, pale), middle - 4 * grain))
    mean = counts[: first + 1] @ level[: first + 1] / max(counts[: first + 1].sum(), 1)
    # A few pixels of high contrast are enough.
    enough = counts[level < sure].sum() >= _FEWEST * flat.size
    enough |= counts[level < 1.4 * sure - 0.4 * middle].sum() >= 4
    if not enough or middle - mean < 0.85 * (middle - sure):
        white = np.full_like(grey, 255)
        return Paper(white < 255, white, light_on_dark)
    window = (round(20 / factor) | 1,) * 2
    # Average the contrast of ink, weighted by contrast: pale edges of strokes count little.
    depth = np.where(flat <= first, np.float32(middle) - flat, np.float32(0))
    typical = np.vdot(depth, depth) / depth.sum()
    around = cv2.blur(depth * depth, window) + 0.02 * typical**2
    around /= cv2.blur(depth, window) + 0.02 * typical
    calm = min(max((_GRAINY - grain) / (_GRAINY - _CALM), 0.0), 1.0)
    contrast, light = typical + calm * (around - typical), np.float32(paper) / _PAPER
    part = 0.5 - 0.04 * calm * (grain > 1)
    limit = cv2.convertScaleAbs((middle - part * contrast + 0.5) * light)
    ink = grey < cv2.resize(limit, grey.shape[::-1])
    white = cv2.convertScaleAbs((middle - max(2.5 * grain, 0.03 * middle)) * light)
    gain = 255 / np.maximum(white - light * (middle - 1.1 * contrast), 1)
    faint = ((flat < sure) & (cv2.blur(depth, (5, 5)) < 1)).mean() > 5 * _FEWEST
    below = cv2.subtract(cv2.resize(white, grey.shape[::-1]), grey)
    dark = cv2.multiply(below, cv2.resize(gain, grey.shape[::-1]), dtype=cv2.CV_8U)
    return Paper(ink, np.asarray(cv2.bitwise_not(dark), np.uint8), light_on_dark, bool(faint))


def _find_paper(small: Grey, side: float) -> Grey:
    """Estimate the gray level of the paper under the ink, (h, w); 0 where there is no paper."""
    near = _closed(small, side)
    far = cv2.resize(_closed(near[::4, ::4], 5 * side / 4), near.shape[::-1])
    # A dark area wider than ``side`` is large print or, at the page's edge, background.
    count, labels = cv2.connectedComponents((near < 0.4 * far).view(np.uint8))
    at_edge = np.arange(count) < 1
    for side_labels in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        at_edge[side_labels] = True
    paper = np.where(at_edge[labels], near, far) if count > 1 else near
    # At the edge of a sheet or shadow, use the level of the darker side.
    paper = cv2.erode(paper, np.ones((5, 5), np.uint8))
    least = max(40, np.percentile(paper[::2, ::2], 95) / 4)
    return np.where(paper < least, np.uint8(0), paper)


def _closed(image: Grey, side_px: float) -> Grey:
    """Remove dark spots narrower than ``side_px`` (morphological closing)."""
    square = np.ones((max(3, round(side_px)) | 1,) * 2, np.uint8)
    calm = cv2.blur(image, (3, 3))  # otherwise the brightest grains would determine the level
    return np.asarray(cv2.blur(cv2.erode(cv2.dilate(calm, square), square), (3, 3)), np.uint8)


def is_light_on_dark(grey: Grey) -> bool:
    """Return whether a page is printed light on dark, from the skewness of its gray levels."""
    step = max(1, round(math.sqrt(grey.size / 6000)))
    small = grey[::step, ::step].astype(np.float32)
    window = (max(3, round(math.sqrt(small.size) / 16)) | 1,) * 2
    off = small - cv2.blur(small, window)
    variance = np.maximum(cv2.blur(off * off, window), 1.0)
    return bool((cv2.blur(off**3, window) / variance).sum() > 0.8 * np.sqrt(variance).sum())
