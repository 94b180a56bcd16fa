"""Lines of text on a page: their size of print and reading order."""

import math
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from smarttouch.pages.baselines import Baseline, Floats, curve_at, follow_baseline, with_marks
from smarttouch.pages.initials import part_initials
from smarttouch.pages.ink import Paper, separate_ink
from smarttouch.pages.letter_rows import find_rows
from smarttouch.pages.page_image import Page
from smarttouch.pages.panels import turn_boxes, turn_panels
from smarttouch.pages.reading_order import find_captions, reading_order
from smarttouch.pages.spots import (
    Spots,
    find_dividers,
    find_frames,
    find_pictures,
    find_rules,
    find_spots,
    like_letters,
    part_lines,
)
from smarttouch.pages.text_blocks import blocks_of_lines
from smarttouch.pages.text_tests import credible_lines, is_text, is_too_small, outside_pictures

ASCENT, DESCENT = 1.5, 0.45
"""Usual heights of a b above and of a p below the baseline, in x-heights."""
_SAME = 0.15  # difference of x-heights that may be a measurement error
_NEAREST = 9  # number of neighboring lines with which a line shares its x-height
_LOW_EDGE = 0.12  # ink at the end of the ascenders, relative to their middle
_FEWEST = 0.03
"""Least ink of ascenders or descenders, relative to the line, by which they are measured."""
_FARTHER = 1.2
"""Ratio by which tall letters reach beyond the usual ascenders, and are those of other scripts."""
_CAPITALS = 0.08
"""Ink above its letters below which a line has no ascenders: it is capitals or figures."""


def reach_of_print(baselines: list[Baseline]) -> tuple[float, float]:
    """Return the reach of ascenders and descenders from the baseline, in x-heights.

    It is measured over all lines of a page: few single ones have enough of either.
    """
    length = np.array([(each.right - each.left) / each.x_height for each in baselines])
    height = np.arange(-1.0, 2.2, 0.02)
    profiles = [np.interp(height, each.heights[::-1], each.profile[::-1]) for each in baselines]
    ink = np.average(profiles, axis=0, weights=length)
    zone = ink[(height > 0.05) & (height < 0.95)].mean()
    ascent = _end(height, ink, (1.2, 1.35), zone)
    descent = _end(-height[::-1], ink[::-1], (0.15, 0.3), zone)
    reach = np.array([each.reach for each in baselines]).T
    tall, deep = (_weighted_median(each, length) for each in reach)
    # Other scripts reach farther, with ink at any height.
    ascent, descent = ascent or ASCENT, descent or DESCENT
    return (
        tall if tall > _FARTHER * ascent else ascent,
        deep if deep > _FARTHER * descent + _SAME else descent,
    )


def _end(height: Floats, ink: Floats, middle: tuple[float, float], zone: float) -> float | None:
    """Return where ink ends outward from some height."""
    there = float(ink[(height >= middle[0]) & (height <= middle[1])].mean())
    if there < _FEWEST * zone:
        return None
    outside = (height > middle[1]) & (ink < _LOW_EDGE * there)
    return float(height[outside][0]) if outside.any() else None


def shared_x_heights(baselines: list[Baseline], ascent: float) -> Floats:
    """Return the x-height of each line, shared with neighbors of the same print, (N,) px.

    Lines of capitals and figures measure taller: they get the x-height of their print.
    """
    size = np.array([baseline.x_height for baseline in baselines])
    length = np.array([baseline.right - baseline.left for baseline in baselines])
    y = np.array([baseline.middle_y for baseline in baselines])
    above = np.array(
        [
            baseline.ink_between(1.1, 1.4) / baseline.ink_between(0.05, 0.95)
            for baseline in baselines
        ]
    )
    most = _weighted_median(size, length)
    capitals = (above < _CAPITALS) & (np.abs(size / most / ascent - 1) < _SAME)
    size = np.where(capitals, size / ascent, size)
    shared = np.empty_like(size)
    for k in range(len(size)):
        near = np.flatnonzero(np.abs(size / size[k] - 1) < _SAME)
        near = near[np.argsort(np.abs(y[near] - y[k]))][:_NEAREST]
        shared[k] = _weighted_median(size[near], length[near])
    return shared


def _weighted_median(values: Floats, weight: Floats) -> float:
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)])


_HOPELESS, _MISSES = 60, 3
"""Failed rows, and additional ones per line of text, after which the rest is a picture's."""
_SMALL_PX, _MOST_PIXELS = 9.0, 40_000_000
"""Usual height of spots below which a page is enlarged, and the largest it may become."""
_ENOUGH_PX, _WORTH_HALVING, _MOST_HALVED = 10.0, 1_000_000, 3
"""Usual height of letters at which lines are found as well as at a larger one, least pixels of a
page that is halved for that, and most of its sizes."""
_PLACES = 20  # along a line, at which its block is looked up
_PARTING = 12.0  # least length of a printed rule that parts a page, in letter heights
_TERMS = 4  # coefficients of a baseline at most
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
    cell: int = 0  # its place in a row of a table, from 1; 0 elsewhere
    initial_mm: tuple[float, ...] = ()
    """Left, top, right and bottom of a letter over several lines that begins its first word."""

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
    return page_lines(page, light_on_dark)[2].lines


@dataclass(frozen=True)
class PageLines:
    """Lines of a page in reading order, what was left out, in words, and whether the order is
    doubtful."""

    lines: list[TextLine]
    left_out: str = ""
    doubtful: bool = False


def page_lines(
    page: Page, light_on_dark: bool | None, leftward: bool = False
) -> tuple[Page, Paper, PageLines]:
    """Return a page, its ink, dark panels turned light, and its lines.

    Small print is enlarged until its lines can be followed; those of large print are found in an
    image of half or a quarter of its size.
    """
    paper = separate_ink(page.grey, light_on_dark)
    coarser = [paper]
    while len(coarser) < _MOST_HALVED and coarser[-1].ink.size > _WORTH_HALVING:
        coarser.append(coarser[-1].halved())
    while len(coarser) > 1 and (coarser[-1].letter_height or 0) < _ENOUGH_PX:
        coarser.pop()
    coarse, scale = coarser[-1], 1 << len(coarser) - 1
    if scale > 1:
        coarse = turn_panels(coarse)
        boxes = [[scale * side for side in panel] for panel in coarse.panels]
        paper = turn_boxes(paper, boxes, scale * (coarse.letter_height or 0))
        found = _lines_in_ink(coarse, scale * page.mm_per_pixel, leftward, coarser[-2].cleaned)
        return page, paper, found
    height = paper.letter_height
    factor = 1 if height is None else math.ceil(_SMALL_PX / height)
    if 1 < factor**2 <= _MOST_PIXELS / page.grey.size:
        grey = cv2.resize(page.grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
        page = Page(np.asarray(grey, np.uint8), page.mm_per_pixel / factor)
        paper = separate_ink(page.grey, paper.light_on_dark)
    paper = turn_panels(paper)
    return page, paper, _lines_in_ink(paper, page.mm_per_pixel, leftward, paper.cleaned)


def _lines_in_ink(
    paper: Paper, mm_per_pixel: float, leftward: bool, finer: NDArray[np.uint8]
) -> PageLines:
    spots, height = paper.spots, paper.letter_height
    if height is None:
        return PageLines([])
    rules = find_rules(paper.ink, height)
    dividers = find_dividers(paper.ink, height)
    parted = part_lines(paper.ink & ~rules & ~dividers, spots, height)
    frames = find_frames(paper.ink, spots, height)
    spots, pictures, shown = find_pictures(parted, height)
    density = np.where(rules | dividers, np.uint8(0), 255 - paper.cleaned)
    found, small = _followed_rows(density, spots, height, dividers | pictures)
    baselines, initials = part_initials(with_marks(found, spots), spots)
    left_out = _left_out(small, len(shown.area))
    if not baselines:
        return PageLines([], left_out)
    ascent, descent = reach_of_print(baselines)
    x_height = shared_x_heights(baselines, ascent)
    left, right, y = np.array([[each.left, each.right, each.middle_y] for each in baselines]).T
    high = (ascent + descent) * x_height
    boxes = np.concatenate(
        [frames, np.array(paper.panels).reshape(-1, 4), find_captions(left, right, y, high, shown)]
    )
    long = find_spots(rules)
    long = long.of((long.width > _PARTING * height) & (long.height < height))
    parting = np.column_stack([long.left, long.right, long.bottom]).astype(np.float64)
    for _, top, _, bottom in frames:
        parting = parting[np.abs(parting[:, 2:] - (top, bottom)).min(axis=1) > height]
    x = np.linspace(left, right, _PLACES, axis=1)
    middles = [each.at(x[k]) - each.x_height / 2 for k, each in enumerate(baselines)]
    ratio = finer.shape[1] / paper.ink.shape[1]
    blocks = partial(blocks_of_lines, finer, ratio * height, *ratio * np.stack([x, middles]))
    order = reading_order(left, right, y, high, boxes, parting, leftward, blocks)
    lines = [
        _line(baselines[k], float(x_height[k]), ascent, descent, mm_per_pixel, int(order.cell[k]))
        for k in order.indices
    ]
    for place, k in enumerate(order.indices):
        if k in initials:
            letter = spots.of(np.array([initials[k]]))
            sides = (letter.left, letter.top, letter.right, letter.bottom)
            box = tuple(float(side[0]) * mm_per_pixel for side in sides)
            lines[place] = replace(lines[place], initial_mm=box)
    return PageLines(lines, left_out, order.doubtful)


def _left_out(small: int, pictures: int) -> str:
    """Return in words what of a page is not among its lines; empty if nothing."""
    counts = ((small, "line", "too small"), (pictures, "picture", ""))
    return ", ".join(f"{n} {what}{'s' * (n > 1)} {why}".strip() for n, what, why in counts if n)


def _followed_rows(
    density: NDArray[np.uint8], spots: Spots, height: float, dividers: NDArray[np.bool_]
) -> tuple[list[Baseline], int]:
    """Return the baselines of rows that are text, and the number of those too small to be read."""
    small = 0
    table: Floats | None = None
    letters = spots.of(like_letters(spots, height))
    rows = [letters.of(row) for row in find_rows(letters, spots, dividers)]
    rows.sort(key=_length, reverse=True)
    lines: list[tuple[Baseline, Spots]] = []
    guides: list[Baseline] = []
    for tried, row in enumerate(rows):
        if tried > _HOPELESS + _MISSES * len(lines):
            break
        is_long = _length(row) > _LONG_ROW
        if not is_long and table is None:
            # Rows come by their length: all guides are known.
            table = _guide_table(guides)
        slope = None if is_long or table is None else _slope_around(row, table)
        baseline = follow_baseline(density, row, slope)
        small += is_too_small(baseline, row)
        if is_text(baseline, row):
            lines.append((baseline, row))
            if is_long:
                guides.append(baseline)
    return credible_lines(outside_pictures(lines, spots), int(spots.area.sum())), small


def _length(row: Spots) -> float:
    return float(row.right.max() - row.left.min()) / row.usual_height


def _guide_table(guides: list[Baseline]) -> Floats:
    """Return ends and coefficients of lines, (2 + _TERMS, N)."""
    rows = [
        [each.left, each.right, *each.baseline, *[0.0] * (_TERMS - len(each.baseline))]
        for each in guides
    ]
    return np.array(rows).reshape(-1, 2 + _TERMS).T


def _slope_around(row: Spots, guides: Floats) -> float:
    """Return the slope of the line nearest to a short row; level if there is none."""
    if not guides.size:
        return 0.0
    left, right, *terms = guides
    x = float(row.left.min() + row.right.max()) / 2
    y = float((row.top + row.bottom).mean()) / 2
    inside = np.clip(x - left, 0, right - left)
    beyond = np.maximum(np.maximum(left - x, x - right), 0.0)
    base, slope = np.zeros_like(left), np.zeros_like(left)
    for each in reversed(terms):
        base, slope = base * inside + each, slope * inside + base
    # Columns bend differently: lines above and below are more reliable.
    away = np.abs(base + slope * (x - left - inside) - y) + 2 * beyond
    return float(slope[away.argmin()])


def _line(
    baseline: Baseline,
    x_height: float,
    ascent: float,
    descent: float,
    mm_per_pixel: float,
    cell: int,
) -> TextLine:
    scales = mm_per_pixel ** (1.0 - np.arange(len(baseline.baseline)))
    return TextLine(
        left_mm=baseline.left * mm_per_pixel,
        right_mm=baseline.right * mm_per_pixel,
        baseline=tuple(map(float, baseline.baseline * scales)),
        x_height_mm=x_height * mm_per_pixel,
        ascent_mm=ascent * x_height * mm_per_pixel,
        descent_mm=descent * x_height * mm_per_pixel,
        cell=cell,
    )
