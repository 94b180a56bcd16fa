"""Dark panels of a page with light print in them, turned dark on light."""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.pages.components import Components, find_components, usual_height
from smarttouch.pages.ink import Paper, separate_ink

_LEAST_SIDES, _LEAST_BOX, _LEAST_INK = (2.5, 5.0), 0.8, 0.35
"""Least height and width of a panel, in letter heights, part of its box that it fills, and ink."""
_LETTER, _FEWEST_LETTERS = (0.5, 9.0), 4
"""Range of its letter height, in letter heights of the page: halftones have less, windows more."""


def turn_panels(
    grey: NDArray[np.uint8], paper: Paper, components: Components, height: float, scale: int
) -> tuple[Paper, list[list[int]]]:
    """Return a page with its panels made dark on light, and their boxes: left, top, right, bottom.

    ``components`` of its ink, their usual height and the boxes are ``scale`` times coarser.
    """
    wide, tall = components.width, components.height
    large = (tall > _LEAST_SIDES[0] * height) & (wide > _LEAST_SIDES[1] * height)
    chosen = components.of(large & (components.area > _LEAST_INK * wide * tall))
    sides = np.column_stack([chosen.left, chosen.top, chosen.right, chosen.bottom])
    ink, cleaned = paper.ink, paper.cleaned
    boxes: list[list[int]] = []
    for side in sides.tolist():
        left, top, right, bottom = (scale * each for each in side)
        box = np.s_[top:bottom, left:right]
        panel, edge = _panel(paper.ink[box], scale * _LETTER[1] * height)
        turned = separate_ink(np.ascontiguousarray(grey[box]), not paper.light_on_dark)
        letters, _ = find_components(turned.ink & panel)
        usual = usual_height(letters, panel.shape) or 0.0
        alike = np.count_nonzero((letters.height > usual / 2) & (letters.height < 2 * usual))
        if alike < _FEWEST_LETTERS or not _LETTER[0] < usual / height / scale < _LETTER[1]:
            continue
        if not boxes:
            ink, cleaned = ink.copy(), cleaned.copy()
        boxes.append(side)
        ink[box] = np.where(panel, turned.ink, ink[box] & ~edge)
        cleaned[box] = np.where(panel, turned.cleaned, cleaned[box] | 255 * edge)
    return (replace(paper, ink=ink, clean=lambda: cleaned) if boxes else paper), boxes


def _panel(ink: NDArray[np.bool_], window: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the inside of the panel that fills a box, (h, w), and its blurred edge.

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
