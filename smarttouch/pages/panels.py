"""Panels of the other polarity on a page, such as light print on a dark box."""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.pages.ink import Paper, separate_ink
from smarttouch.pages.spots import find_spots, usual_height

_LEAST_SIDE = 1.5  # least height of a panel, in letter heights, and half its least width
_LEAST_BOX = 0.8  # least part of its box that a panel fills; letters that touch fill less
_LETTER = (0.5, 9.0)
"""Range of its letter height, in letter heights of the page: halftones have less, windows more."""
_FEWEST_LETTERS = 4


def turn_panels(paper: Paper) -> Paper:
    """Return a page with its panels made dark on light as well."""
    spots, height = paper.spots, paper.letter_height
    if height is None:
        return paper
    large = (spots.height > _LEAST_SIDE * height) & (spots.width > 2 * _LEAST_SIDE * height)
    chosen = spots.of(large & (spots.area > 0.35 * spots.width * spots.height))
    boxes = np.column_stack([chosen.left, chosen.top, chosen.right, chosen.bottom])
    return turn_boxes(paper, boxes.tolist(), height)


def turn_boxes(paper: Paper, boxes: list[list[int]], height: float) -> Paper:
    """Return a page with the panels made dark on light that fill some boxes.

    The boxes are left, top, right, bottom, px, and ``height`` is that of the page's letters.
    """
    ink, panels, cleaned = paper.ink.copy(), [], paper.cleaned.copy()
    for left, top, right, bottom in boxes:
        box = np.s_[top:bottom, left:right]
        panel, edge = _panel(paper.ink[box], _LETTER[1] * height)
        turned = separate_ink(np.ascontiguousarray(paper.grey[box]), light_on_dark=True)
        letters = find_spots(turned.ink & panel)
        usual = usual_height(letters, panel.shape) or 0.0
        alike = np.count_nonzero((letters.height > usual / 2) & (letters.height < 2 * usual))
        if alike >= _FEWEST_LETTERS and _LETTER[0] * height < usual < _LETTER[1] * height:
            panels.append([left, top, right, bottom])
            ink[box] = np.where(panel, turned.ink, paper.ink[box] & ~edge)
            cleaned[box] = np.where(panel, turned.cleaned, cleaned[box] | 255 * edge)
    return replace(paper, ink=ink, clean=lambda: cleaned, panels=tuple(panels)) if panels else paper


def _panel(ink: NDArray[np.bool_], window: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the inside of the panel that fills a box, (h, w) bool, and its blurred edge.

    Holes larger than a window stay as they are. Both are empty if no panel fills the box.
    """
    mode, method = cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE
    outlines, nested = cv2.findContours(ink.view(np.uint8), mode, method)
    filled = np.zeros(ink.shape, np.uint8)
    outer = max(range(len(outlines)), key=lambda k: cv2.contourArea(outlines[k]))
    if cv2.contourArea(outlines[outer]) > _LEAST_BOX * ink.size:
        cv2.drawContours(filled, outlines, outer, 1, cv2.FILLED)
    for k, outline in enumerate(outlines):
        if nested[0, k, 3] == outer and max(cv2.boundingRect(outline)[2:]) > window:
            cv2.drawContours(filled, outlines, k, 0, cv2.FILLED)
    inside = cv2.erode(filled, np.ones((3, 3), np.uint8), borderValue=0)
    return inside > 0, filled > inside
