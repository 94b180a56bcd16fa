"""Recognition of Braille on a photographed page."""

import math
from collections import Counter
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.braille.cells import BLANK
from smarttouch.braille.lattice import cell_lines
from smarttouch.braille.search import find_view, look_closer, octaves, shows_both_sides
from smarttouch.braille.view import View
from smarttouch.documents.page_image import Page
from smarttouch.errors import PageError

WORKING_SIDE_PX = 2400
"""Longer side to which finer photographs are reduced. A page is some 110 dot pitches high."""
GLANCE_SIDE_PX = 1200
LEAST_CERTAINTY = 0.6
"""Least certainty of Braille; texts and photographs have less."""
CERTAIN = 0.7
"""Certainty of Braille on a page that was not announced as Braille."""
_FEWEST_CELLS = 12
_MOST_ALIKE = 0.8
"""Share of the three commonest kinds of cells above which it is no text: texts have a third to a
half.
"""
_DISTURBED = 0.85
"""Certainty below which the reader is warned."""


@dataclass(frozen=True, eq=False)
class BraillePage:
    """Cells of a page of Braille, with their places.

    Attributes
    ----------
    lines : list of str
        Cells of each line, without blanks at its end; empty where there is
        room for a line without dots.
    dots_px : ndarray, (N, 2) px
        Places of the dots, column and row.
    dot_pitch_px : float, px
        Distance of two dots of a cell, in the middle of the page.
    skew_deg : float, °
        Positive when lines rise to the right.
    certainty : float, in [0, 1]
        Fit of dots to cells, beyond chance; 1 if each strong one does.
    notes : list of str
        Warnings for the reader.
    """

    lines: list[str]
    dots_px: NDArray[np.float64]
    dot_pitch_px: float
    skew_deg: float
    certainty: float
    notes: list[str]


def read_braille(
    page: Page, light_from_deg: float | None = None, turned: bool = False
) -> BraillePage:
    """Read a photograph or scan of a page of Braille, raised or printed.

    Raised dots must be lit from one side. The page's scale is not used: cells
    show their own. A page may be turned by up to 30°.

    Parameters
    ----------
    page : Page
        The photograph.
    light_from_deg : float, °, optional
        Direction of the light: 0 is the right, 90 the top of the picture.
        It separates dots of the front from those of the back; not needed for pages
        embossed from one side.
    turned : bool
        The page lies upside down in the picture; cells do not tell.

    Raises
    ------
    PageError
        If the page shows no Braille, or the direction of the light is none.
    """
    if light_from_deg is not None and not math.isfinite(light_from_deg):
        raise PageError(
            f"light from {light_from_deg:g}°: give 0 for the right, 90 for the top",
            about="light_from_deg",
            problem="malformed",
            value=light_from_deg,
        )
    grey = page.grey
    if turned:
        grey = np.ascontiguousarray(grey[::-1, ::-1])
        light_from_deg = None if light_from_deg is None else (light_from_deg + 180) % 360
    images = octaves(_at_most(grey, WORKING_SIDE_PX))
    view = find_view(images, light_from_deg)
    if view is None:
        raise PageError(
            "no dots are found that make cells: is it a page of Braille, lit from one side?",
            about="page",
            problem="empty",
        )
    view = look_closer(images, view, light_from_deg)
    if view.certainty < LEAST_CERTAINTY:
        raise PageError(
            f"of {view.strong.sum()} dots found, {view.proven.sum()} fit cells, too few: is it a "
            "page of Braille, lit from one side?",
            about="page",
            problem="too few",
            value=view.certainty,
            allowed=LEAST_CERTAINTY,
        )
    read = view.read()
    lines = cell_lines(view.names[read])
    if _is_ornament(lines):
        raise PageError(
            f"the {read.sum()} dots found are a pattern, no text: is it a page of Braille, lit "
            "from one side?",
            about="page",
            problem="pattern",
            value=int(read.sum()),
        )
    # The size of a pixel of the view, in those of the page.
    pixel = grey.shape[1] / view.image.shape[1]
    dots_px = (view.dots.px[read] + 0.5) * pixel - 0.5
    if turned:
        dots_px = np.array(grey.shape[::-1]) - 1 - dots_px
    right = view.lattice.steps()[0]
    return BraillePage(
        lines=lines,
        dots_px=dots_px,
        dot_pitch_px=view.lattice.pitch_px() * pixel,
        skew_deg=math.degrees(math.atan2(-right[1], right[0])),
        certainty=view.certainty,
        notes=_notes(view, light_from_deg),
    )


def looks_like_braille(page: Page) -> bool:
    """Return whether a page is certainly Braille, by a quick look.

    Texts and photographs are not, nor is Braille that is hard to read.
    """
    view = find_view(octaves(_at_most(page.grey, GLANCE_SIDE_PX)), None)
    if view is None or view.certainty < CERTAIN:
        return False
    return not _is_ornament(cell_lines(view.names[view.read()]))


def _at_most(grey: NDArray[np.uint8], side_px: int) -> NDArray[np.uint8]:
    shrink = side_px / max(grey.shape)
    if shrink >= 1:
        return grey
    rows, columns = (max(1, round(shrink * side)) for side in grey.shape)
    return np.asarray(cv2.resize(grey, (columns, rows), interpolation=cv2.INTER_AREA), np.uint8)


def _is_ornament(lines: list[str]) -> bool:
    """Return whether nearly all cells are of three kinds: a grid of dots, or tiles."""
    kinds = Counter("".join(lines).replace(BLANK, ""))
    most = sum(count for _, count in kinds.most_common(3))
    return kinds.total() >= _FEWEST_CELLS and most > _MOST_ALIKE * kinds.total()


def _notes(view: View, light_from_deg: float | None) -> list[str]:
    notes = []
    if view.certainty < _DISTURBED:
        notes.append(f"dots make cells with a certainty of {view.certainty:.0%} only")
    if light_from_deg is None and shows_both_sides(view):
        light_deg = (view.dots.look.light_from_deg or 0.0) % 360
        notes.append(
            f"dots of both sides are seen; those read are raised if the light comes from "
            f"{light_deg:.0f}° (0 is the right, 90 the top): say where from if it does not"
        )
    return notes
