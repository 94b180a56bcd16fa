"""Dots of Braille in a photograph: a bright and a dark side each, or spots of ink."""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.floating[Any]]

MOST_DOTS = 8000
"""Largest number of dots: a page of 25 lines of 40 full cells has 6000."""
WEAKEST = 0.3
"""Least strength of a dot, relative to the usual one."""
_PAPER_PART = 0.05
"""Part of the longer side over which the light is even."""
_DEEPEST = 0.6
"""Largest relative difference from the paper that counts: the edge of a table is no stronger."""
_USUAL_OF = 60
"""Number of the strongest dots that define the usual strength."""
_FEWEST = 8
_GAP = 1.25
"""Ratio of successive strengths after which the dots of a short label end."""
_LEAST_CONTRAST = 0.004
"""Least contrast, as a part of the paper's grey: the noise of a good camera."""


@dataclass(frozen=True)
class Look:
    """Expected appearance of a dot.

    Attributes
    ----------
    sigma_px : float, px
        Width of the Gaussian that it is sought with.
    light_from_deg : float, °, optional
        Raised dots, lit from here: 0 is the right, 90 the top of the picture.
        Without it, dots are spots of ink.
    ink_is_dark : bool
        Or light on dark.
    """

    sigma_px: float
    light_from_deg: float | None = None
    ink_is_dark: bool = True


@dataclass(frozen=True, eq=False)
class FoundDots:
    """Places that look like dots, the strongest first.

    Attributes
    ----------
    px : ndarray, (N, 2) float, px
        Centers: column, row; pixel centers are at whole numbers.
    strength : ndarray, (N,) float
        Strength of their match, 1 is usual here.
    usual : float
        Usual strength, as a part of the paper's grey.
    look : Look
        Appearance by which they were found.
    """

    px: NDArray[np.float64]
    strength: NDArray[np.float64]
    usual: float
    look: Look


def even_light(grey: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the relative difference of each place from the paper around it."""
    rows, columns = grey.shape
    small = cv2.resize(
        grey, (max(1, columns // 8), max(1, rows // 8)), interpolation=cv2.INTER_AREA
    )
    sigma = max(1.0, _PAPER_PART * max(small.shape))
    paper = cv2.GaussianBlur(small.astype(np.float32), (0, 0), sigma)
    paper = cv2.resize(paper, (columns, rows), interpolation=cv2.INTER_LINEAR)
    contrast = grey / np.maximum(paper, 8) - 1
    return np.asarray(np.clip(contrast, -_DEEPEST, _DEEPEST), np.float32)


def light_axis(contrast: Image, sigma_px: float) -> tuple[float, float]:
    """Return the axis along which the light falls, and its certainty.

    Paper lit from one side shows its slope along the light. Of the gradients
    of that, three quarters of the power lie along the light too if the relief
    is round, as the dots of Braille are.

    Returns
    -------
    axis_deg : float, °
        In [0, 180], as in `Look`.
    ratio : float
        Power of the gradients along it, of that across: 1 for spots of ink.
    """
    to_right, to_top = _slopes(contrast, sigma_px)
    steep = np.hypot(to_right, to_top)
    # Long straight edges (of the sheet, of its shadow) may not outvote the dots.
    usual = float(np.percentile(steep[::4, ::4], 95))
    weight = 1 / np.maximum(steep, max(_LEAST_CONTRAST, usual))
    x, y = to_right * weight, to_top * weight
    along, across = float((x * x - y * y).mean()), float(2 * (x * y).mean())
    part = math.hypot(along, across) / max(float((x * x + y * y).mean()), 1e-9)
    axis_deg = math.degrees(math.atan2(across, along)) / 2 % 180
    return axis_deg, (1 + part) / max(1 - part, 1e-9)


def find_dots(contrast: Image, look: Look) -> FoundDots:
    """Return the places that look most like dots.

    Parameters
    ----------
    contrast : ndarray, (H, W) float32
        Made by `even_light`.
    look : Look
        Appearance to search for.
    """
    response = _respond(contrast, look)
    reach = math.ceil(1.8 * look.sigma_px)
    around = cv2.getStructuringElement(cv2.MORPH_RECT, (2 * reach + 1, 2 * reach + 1))
    peak = response >= np.maximum(cv2.dilate(response, around), _LEAST_CONTRAST)
    edge = reach
    peak[:edge] = peak[-edge:] = False
    peak[:, :edge] = peak[:, -edge:] = False
    rows, columns = np.nonzero(peak)
    strength = response[rows, columns].astype(np.float64)
    order = np.argsort(-strength, kind="stable")[:MOST_DOTS]
    usual = _usual(strength[order[:_USUAL_OF]])
    order = order[strength[order] > WEAKEST * usual]
    rows, columns = rows[order], columns[order]
    px = np.column_stack(
        [
            columns + _vertex(response, rows, columns, 0, 1),
            rows + _vertex(response, rows, columns, 1, 0),
        ]
    )
    return FoundDots(px, strength[order] / usual, usual, look)


def light_at(contrast: Image, px: NDArray[np.float64], sigma_px: float) -> float:
    """Return the direction of the light on raised dots, (N, 2) px, ° as in `Look`."""
    to_right, to_top = _slopes(contrast, sigma_px)
    columns, rows = np.rint(px).astype(int).T
    right, top = to_right[rows, columns].sum(), to_top[rows, columns].sum()
    return math.degrees(math.atan2(top, right)) % 360


def _respond(contrast: Image, look: Look) -> Image:
    """Return the match of each place, in units of the paper's grey.

    Under light from one side paper shows the slope of its relief along the
    light; the slope of that along the light again is greatest on top of a dot.
    """
    if look.light_from_deg is None:
        inner = cv2.GaussianBlur(contrast, (0, 0), look.sigma_px)
        outer = cv2.GaussianBlur(contrast, (0, 0), 1.6 * look.sigma_px)
        return np.asarray(outer - inner if look.ink_is_dark else inner - outer)
    to_right, to_top = _slopes(contrast, look.sigma_px)
    angle = math.radians(look.light_from_deg)
    return np.asarray(math.cos(angle) * to_right + math.sin(angle) * to_top)


def _slopes(contrast: Image, sigma_px: float) -> tuple[Image, Image]:
    """Return the increase in brightness to the right and to the top, over one sigma."""
    reach = math.ceil(3 * sigma_px)
    x = np.arange(-reach, reach + 1, dtype=np.float32)
    smooth = np.exp(-((x / sigma_px) ** 2) / 2)
    smooth /= smooth.sum()
    slope = x * smooth / sigma_px
    to_right = cv2.sepFilter2D(contrast, -1, slope, smooth, borderType=cv2.BORDER_REPLICATE)
    to_top = cv2.sepFilter2D(contrast, -1, smooth, -slope, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(to_right, np.float32), np.asarray(to_top, np.float32)


def _usual(strength: NDArray[np.float64]) -> float:
    """Return the strength of most dots, given the strongest in falling order."""
    if not len(strength):
        return 1.0
    gaps = np.flatnonzero(strength[_FEWEST - 1 : -1] > _GAP * strength[_FEWEST:])
    dots = _FEWEST + int(gaps[0]) if len(gaps) else len(strength)
    return float(np.median(strength[:dots]))


def _vertex(
    response: Image, rows: NDArray[np.intp], columns: NDArray[np.intp], down: int, right: int
) -> NDArray[np.float64]:
    """Return the offset of a parabola's top from each peak, in [-0.5, 0.5]."""
    before = response[rows - down, columns - right].astype(np.float64)
    after = response[rows + down, columns + right]
    curve = before + after - 2 * response[rows, columns]
    shift = np.divide(before - after, 2 * curve, out=np.zeros_like(before), where=curve < 0)
    return np.clip(shift, -0.5, 0.5)
