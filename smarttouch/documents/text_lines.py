"""Lines of text on a page, and their reading order."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from smarttouch.documents.baselines import Baseline, curve_at, follow_baseline
from smarttouch.documents.ink import Paper, separate_ink
from smarttouch.documents.letters import (
    Spots,
    find_dividers,
    find_pictures,
    find_rules,
    find_spots,
    like_letters,
    usual_height,
)
from smarttouch.documents.marks import with_marks
from smarttouch.documents.page_image import Page
from smarttouch.documents.panels import turn_panels
from smarttouch.documents.print_size import reach_of_print, shared_x_heights
from smarttouch.documents.reading_order import reading_order
from smarttouch.documents.rows import find_rows
from smarttouch.documents.textlike import credible_lines, is_text, is_too_small, outside_pictures
from smarttouch.documents.touching import part_lines

_HOPELESS, _MISSES = 60, 3
"""Failed rows, and additional ones per line of text, after which the rest is a picture's."""
_SMALL_PX, _MOST_PIXELS = 9.0, 40_000_000
"""Usual height of spots below which a page is enlarged, and the largest it may become."""
_LONG_ROW = 10.0  # least length of a row, in letter heights, that determines its slope


@dataclass(frozen=True)
class TextLine:
    """Line of text, mm from the page's top left corner."""

    left_mm: float
    right_mm: float
    baseline: tuple[float, ...]  # coefficients of y, lowest first, over the distance from left_mm
    x_height_mm: float
    ascent_mm: float  # of all lines of one print, whichever letters they have
    descent_mm: float

    def baseline_mm(self, x_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the baseline's y at x, mm; straight beyond the line's ends."""
        length = self.right_mm - self.left_mm
        return curve_at(np.array(self.baseline), x_mm - self.left_mm, length)

    def slope(self, x_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the slope of the baseline at x, positive if it falls."""
        inside = np.clip(x_mm - self.left_mm, 0, self.right_mm - self.left_mm)
        return np.asarray(polynomial.polyval(inside, polynomial.polyder(self.baseline)))

    @property
    def height_mm(self) -> float:
        """Height from the lowest to the highest print."""
        return self.ascent_mm + self.descent_mm

    @property
    def top_mm(self) -> float:
        """Top of its print, on average over the line."""
        return self._mean_mm - self.ascent_mm

    @property
    def bottom_mm(self) -> float:
        """Bottom of its print, on average over the line."""
        return self._mean_mm + self.descent_mm

    @property
    def _mean_mm(self) -> float:
        length = self.right_mm - self.left_mm
        return sum(c * length**k / (k + 1) for k, c in enumerate(self.baseline))


def find_lines(page: Page, light_on_dark: bool | None = False) -> list[TextLine]:
    """Return the lines of text in reading order; find the polarity of the page if it is None."""
    page, paper = ink_of_lines(page, light_on_dark)
    return lines_in_ink(paper, page.mm_per_pixel)[0]


def ink_of_lines(page: Page, light_on_dark: bool | None) -> tuple[Page, Paper]:
    """Return a page and its ink, dark panels turned light.

    Small print is enlarged until its lines can be followed.
    """
    paper = separate_ink(page.grey, light_on_dark)
    height = usual_height(find_spots(paper.ink), paper.ink.shape)
    factor = 1 if height is None else math.ceil(_SMALL_PX / height)
    if 1 < factor**2 <= _MOST_PIXELS / page.grey.size:
        grey = cv2.resize(page.grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
        page = Page(np.asarray(grey, np.uint8), page.mm_per_pixel / factor)
        paper = separate_ink(page.grey, paper.light_on_dark)
    return page, turn_panels(paper)


def lines_in_ink(paper: Paper, mm_per_pixel: float) -> tuple[list[TextLine], str]:
    """Return the lines of text on a page with separated ink, and what is left out, in words."""
    spots = find_spots(paper.ink)
    height = usual_height(spots, paper.ink.shape)
    if height is None:
        return [], ""
    rules = find_rules(paper.ink, height)
    dividers = find_dividers(paper.ink, height)
    parted = part_lines(paper.ink & ~rules & ~dividers, spots, height)
    spots, pictures, count = find_pictures(parted, height)
    density = np.where(rules | dividers, np.uint8(0), 255 - paper.cleaned)
    found, small = _followed_rows(density, spots, height, dividers | pictures)
    baselines = with_marks(found, spots)
    left_out = _left_out(small, count)
    if not baselines:
        return [], left_out
    ascent, descent = reach_of_print(baselines)
    x_height = shared_x_heights(baselines, ascent)
    order = reading_order(
        np.array([baseline.left for baseline in baselines]),
        np.array([baseline.right for baseline in baselines]),
        np.array([baseline.middle_y for baseline in baselines]),
        (ascent + descent) * x_height,
    )
    lines = [_line(baselines[k], float(x_height[k]), ascent, descent, mm_per_pixel) for k in order]
    return lines, left_out


def _left_out(small: int, pictures: int) -> str:
    """Return in words what of a page is not among its lines; empty if nothing."""
    counts = ((small, "line", "too small"), (pictures, "picture", ""))
    return ", ".join(f"{n} {what}{'s' * (n > 1)} {why}".strip() for n, what, why in counts if n)


def _followed_rows(
    density: NDArray[np.uint8], spots: Spots, height: float, dividers: NDArray[np.bool_]
) -> tuple[list[Baseline], int]:
    """Return the baselines of rows that are text, and the number of those too small to be read."""
    small = 0
    letters = spots.of(like_letters(spots, height))
    rows = [letters.of(row) for row in find_rows(letters, spots, dividers)]
    rows.sort(key=_length, reverse=True)
    lines: list[tuple[Baseline, Spots]] = []
    guides: list[Baseline] = []
    for tried, row in enumerate(rows):
        if tried > _HOPELESS + _MISSES * len(lines):
            break
        is_long = _length(row) > _LONG_ROW
        baseline = follow_baseline(density, row, None if is_long else _slope_around(row, guides))
        small += is_too_small(baseline, row)
        if is_text(baseline, row):
            lines.append((baseline, row))
            if is_long:
                guides.append(baseline)
    return credible_lines(outside_pictures(lines, spots), int(spots.area.sum())), small


def _length(row: Spots) -> float:
    return float(row.right.max() - row.left.min()) / row.usual_height


def _slope_around(row: Spots, guides: list[Baseline]) -> float:
    """Return the slope of the line nearest to a short row; level if there is none."""
    x = float(row.left.min() + row.right.max()) / 2
    y = float((row.top + row.bottom).mean()) / 2

    def away(guide: Baseline) -> float:
        beyond = max(guide.left - x, x - guide.right, 0.0)
        # Columns bend differently: lines above and below are more reliable.
        return abs(float(guide.at(np.array(x))) - y) + 2 * beyond

    return min(guides, key=away).slope_at(x) if guides else 0.0


def _line(
    baseline: Baseline, x_height: float, ascent: float, descent: float, mm_per_pixel: float
) -> TextLine:
    scales = mm_per_pixel ** (1.0 - np.arange(len(baseline.baseline)))
    return TextLine(
        left_mm=baseline.left * mm_per_pixel,
        right_mm=baseline.right * mm_per_pixel,
        baseline=tuple(map(float, baseline.baseline * scales)),
        x_height_mm=x_height * mm_per_pixel,
        ascent_mm=ascent * x_height * mm_per_pixel,
        descent_mm=descent * x_height * mm_per_pixel,
    )
