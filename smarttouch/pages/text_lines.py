"""Where the lines of text are on a page."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.pages.page_image import Page

_PIXEL_MM = 0.2
"""Resolution at which lines are looked for."""
_BACKGROUND_MM = 8.0
"""Wider than any stroke: what is left after closing with it is paper."""
_INK = 0.75
"""Darker than this part of the paper is ink."""
_MOST_INK = 0.6
"""A page with more ink than this carries no text that could be told apart."""
_LEAST_HEIGHT_MM = 0.8


@dataclass(frozen=True)
class TextLine:
    """A line of text, mm from the page's top left corner."""

    top_mm: float
    bottom_mm: float
    left_mm: float
    right_mm: float


def find_lines(page: Page, light_on_dark: bool = False) -> list[TextLine]:
    """Return the lines of text from top to bottom; empty if none are found.

    The page is divided by its own background, so uneven light does not
    matter, and rows that carry ink are gathered into lines.
    """
    ink, pixel_mm = _ink(page, light_on_dark)
    profile = cv2.blur(ink.mean(axis=1, dtype=np.float32)[:, None], (1, 3)).ravel()
    crowded = float(np.percentile(profile, 90))
    if crowded < 0.002 or ink.mean() > _MOST_INK:
        return []
    lines = []
    for top, bottom in _runs(profile > 0.12 * crowded):
        if (bottom - top) * pixel_mm < _LEAST_HEIGHT_MM:
            continue
        columns = np.flatnonzero(ink[top:bottom].any(axis=0))
        left, right = int(columns[0]), int(columns[-1]) + 1
        lines.append(TextLine(*(edge * pixel_mm for edge in (top, bottom, left, right))))
    return lines


def _ink(page: Page, light_on_dark: bool) -> tuple[NDArray[np.bool_], float]:
    grey = 255 - page.grey if light_on_dark else page.grey
    width_mm, height_mm = page.size_mm
    size = (max(8, round(width_mm / _PIXEL_MM)), max(8, round(height_mm / _PIXEL_MM)))
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    side = round(_BACKGROUND_MM / _PIXEL_MM) | 1
    element = cv2.getStructuringElement(cv2.MORPH_RECT, (side, side))
    paper = cv2.GaussianBlur(cv2.morphologyEx(small, cv2.MORPH_CLOSE, element), (0, 0), side / 4)
    smooth = cv2.GaussianBlur(small, (0, 0), 0.8)
    ink = smooth < _INK * np.maximum(paper, 40)
    return np.asarray(ink), height_mm / size[1]


def _runs(on: NDArray[np.bool_]) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(on.astype(np.int8), prepend=0, append=0))
    return [(int(start), int(end)) for start, end in zip(edges[::2], edges[1::2], strict=True)]
