"""Panels: dark areas with light print on a page that is dark on light."""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.documents.ink import Paper
from smarttouch.documents.letters import find_spots, usual_height

_LEAST_SIDE = 1.5  # least side of a panel, in usual heights of letters
_LEAST_DARK = 0.35  # least part of a panel's box that is dark
_LEAST_BOX = 0.8
"""Least part of its box that a panel and its contents fill; touching letters have less."""
_FEWEST_LIGHT = 4  # fewest light letters; two large touching letters have at most as many holes
_LETTER = (0.5, 9.0)
"""Range of their usual height, in usual heights of the letters of the page: halftones have less,
and what is larger is a window in the panel."""
_BLACK = np.uint8(40)  # level below which a panel's grain is cut off


def turn_panels(paper: Paper) -> Paper:
    """Return a page with its panels made dark on light as well."""
    spots = find_spots(paper.ink)
    height = usual_height(spots, paper.ink.shape)
    if height is None:
        return paper
    large = np.minimum(spots.width, spots.height) > _LEAST_SIDE * height
    large &= spots.width > 2 * _LEAST_SIDE * height
    large &= spots.area > _LEAST_DARK * spots.width * spots.height
    ink, cleaned = paper.ink, paper.cleaned
    for k in np.flatnonzero(large):
        box = np.s_[spots.top[k] : spots.bottom[k], spots.left[k] : spots.right[k]]
        panel = _panel(paper.ink[box], int(spots.area[k]), height)
        if panel is None:
            continue
        if ink is paper.ink:
            ink, cleaned = ink.copy(), cleaned.copy()
        ink[box] ^= panel
        # Its blurred edge would become a frame.
        inside = cv2.erode(panel.view(np.uint8), np.ones((3, 3), np.uint8), borderValue=0) > 0
        ink[box] &= inside | ~panel
        above = np.maximum(cleaned[box], _BLACK) - _BLACK
        negative = 255 - cv2.convertScaleAbs(above, alpha=255 / (255 - int(_BLACK)))
        cleaned[box] = np.where(panel, np.where(inside, negative, 255), cleaned[box])
    return paper if ink is paper.ink else replace(paper, ink=ink, cleaned=cleaned)


def _panel(ink: NDArray[np.bool_], area: int, height: float) -> NDArray[np.bool_] | None:
    """Return the mask of a panel, without windows, in a spot's box of ink, (h, w) bool, or None."""
    outlines, nested = cv2.findContours(ink.view(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    outer = max(
        (k for k in range(len(outlines)) if nested[0, k, 3] < 0),
        key=lambda k: cv2.contourArea(outlines[k]),
    )
    filled = cv2.drawContours(np.zeros(ink.shape, np.uint8), outlines, outer, 1, cv2.FILLED)
    if filled.sum() < max(_LEAST_BOX * ink.size, area):
        return None
    holes = find_spots((filled > 0) & ~ink)
    usual = usual_height(holes, ink.shape)
    if usual is None or not _LETTER[0] * height < usual < _LETTER[1] * height:
        return None
    if np.count_nonzero((holes.height > usual / 2) & (holes.height < 2 * usual)) < _FEWEST_LIGHT:
        return None
    for k, outline in enumerate(outlines):
        _, _, wide, high = cv2.boundingRect(outline)
        window = high > _LETTER[1] * height or wide > 2 * _LETTER[1] * height
        if window and nested[0, k, 3] == outer:
            cv2.drawContours(filled, outlines, k, 0, cv2.FILLED)
    return np.asarray(filled > 0, np.bool_)
