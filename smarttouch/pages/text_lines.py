"""Lines of text on a page: their size of print and reading order."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from smarttouch.pages.ink import Paper, separate_ink
from smarttouch.pages.letter_rows import (
    Baseline,
    Components,
    Floats,
    Ink,
    are_pictures,
    find_components,
    find_rows,
    find_rules,
    like_letters,
    measure_row,
    part_lines,
    usual_height,
    weighted_median,
)
from smarttouch.pages.page_image import Page, TextLine
from smarttouch.pages.reading_order import Segment, reading_order
from smarttouch.pages.straighten import skew_of, turned


@dataclass(frozen=True)
class PageLines:
    """Straight page, its ink, its lines in reading order, what was left out, in words, and whether
    the order is doubtful."""

    page: Page
    paper: Paper
    lines: list[TextLine]
    left_out: str = ""
    is_doubtful: bool = False
    skew_deg: float = 0.0  # by which the page was turned level, clockwise before


_SMALL_PX, _LARGEST_PIXELS = 9.0, 40_000_000
"""Height of letters below which a page is enlarged, and the largest enlarged page."""


def find_lines(page: Page, light_on_dark: bool | None = False) -> list[TextLine]:
    """Return the lines of text in reading order; find the polarity of the page if it is None."""
    return page_lines(page, light_on_dark).lines


def page_lines(
    page: Page, light_on_dark: bool | None, leftward: bool = False, turn: bool = False
) -> PageLines:
    """Return a page, turned level if asked for, its ink, dark panels turned light, and its lines.

    Small print is enlarged until its lines can be followed.
    """
    paper = separate_ink(page.grey, light_on_dark)
    components, _ = find_components(paper.ink)
    height = usual_height(components, paper.ink.shape)
    if height is None:
        return PageLines(page, paper, [])
    letters = components.of(like_letters(components, height))
    skew_deg = skew_of((letters.left + letters.right) / 2, letters.bottom, height) if turn else 0.0
    if skew_deg:
        page = Page(turned(page.grey, skew_deg), page.mm_per_pixel)
        return replace(page_lines(page, paper.light_on_dark, leftward), skew_deg=skew_deg)
    factor = math.ceil(_SMALL_PX / height)
    if 1 < factor**2 <= _LARGEST_PIXELS / page.grey.size:
        grey = cv2.resize(page.grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
        larger = Page(np.asarray(grey, np.uint8), page.mm_per_pixel / factor)
        return page_lines(larger, paper.light_on_dark, leftward)
    panels = _panels(paper.ink, components, height)
    if panels.any():
        cleaned = np.where(panels, ~paper.cleaned, paper.cleaned)
        paper = replace(paper, ink=paper.ink ^ panels, clean=lambda: cleaned)
    return _lines_in_ink(page, paper, height, leftward)


_LEAST_SIDES, _LEAST_BOX, _LEAST_INK = (2.5, 5.0), 0.8, 0.35
"""Least height and width of a panel, in letter heights, part of its box that it fills, and ink."""
_LIGHT_LETTER, _FEWEST_LETTERS = (0.5, 9.0), 4
"""Range of its letter height, in letter heights of the page: halftones have less."""


def _panels(ink: Ink, components: Components, height: float) -> Ink:
    """Return where dark panels with light print are, (H, W)."""
    wide, tall = components.width, components.height
    large = (tall > _LEAST_SIDES[0] * height) & (wide > _LEAST_SIDES[1] * height)
    panels = np.zeros_like(ink)
    for k in np.flatnonzero(large & (components.area > _LEAST_INK * wide * tall)):
        rows = slice(components.top[k], components.bottom[k])
        columns = slice(components.left[k], components.right[k])
        dark = ink[rows, columns].view(np.uint8)
        outlines, _ = cv2.findContours(dark, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        filled = cv2.drawContours(np.zeros_like(dark), outlines, -1, 1, cv2.FILLED)
        letters, _ = find_components((filled > dark).view(np.bool_))
        typical = usual_height(letters, dark.shape) or 0.0
        alike = np.count_nonzero((letters.height > typical / 2) & (letters.height < 2 * typical))
        right_size = _LIGHT_LETTER[0] * height < typical < _LIGHT_LETTER[1] * height
        if filled.mean() > _LEAST_BOX and right_size and alike >= _FEWEST_LETTERS:
            panels[rows, columns] |= filled > 0
    return panels


_FEWEST_PIXELS = 3  # least area of a part of print
_HOPELESS, _MISSES = 60, 3
"""Failed rows, and additional ones per line of text, after which the rest is a picture's."""
_HEIGHT = 0.96  # from ascender to descender, in sizes of the font
_LONG_ROW = 11.0  # least length of a row, in letter heights, that determines its slope
_EVEN, _FEW, _MANY, _SIMILAR, _MOST_OF_ALL = 0.85, 4, 8, 1.7, 0.8
"""Part of the letters at their levels of a line that needs few to be sure, and letters of one that
needs many; ratio of sizes at which others are lines, and their part of all ink without any sure."""
_OWN, _AROUND, _FOREIGN, _NEAR_FOREIGN = (-1.8, 0.6), (-1.7, 0.5), 0.1, 0.5
"""Extent of a line around its baseline, in x-heights, and of the ink around it, in letter heights;
most foreign ink there, relative to its own and for each of its letters, also of an even line."""
_PLACES = 20  # points along a line


def _lines_in_ink(page: Page, paper: Paper, height: float, leftward: bool) -> PageLines:
    ink, mm_per_pixel = paper.ink, page.mm_per_pixel
    rules, dividers = find_rules(ink, height)
    ink = ink & ~rules & ~dividers
    components, labels = find_components(ink)
    parted = part_lines(ink, components, height)
    if parted is not ink:
        components, labels = find_components(parted)
    pictures = are_pictures(components, height)
    walls = dividers | np.append(False, pictures)[labels]
    components = components.of(components.area >= _FEWEST_PIXELS)
    letters = components.of(like_letters(components, height))
    rows = [letters.of(row) for row in find_rows(letters, parted, walls, height)]
    baselines, small = _measured(parted, rows)
    left_out = _left_out(small, int(pictures.sum()))
    if not baselines:
        return PageLines(page, paper, [], left_out)
    baselines = _with_marks(_joined(parted, baselines), components)
    x_height, ascent, descent = _sizes(baselines)
    y, size = _levels(baselines), (ascent + descent) * x_height / _HEIGHT
    words = [
        Segment("", baseline.left, baseline.right, float(y[k]), float(size[k]), -1 - k)
        for k, baseline in enumerate(baselines)
    ]
    order, lines = reading_order(words, len(ink), leftward), []
    for row in order:
        for cell, word in enumerate(row.segments, 1):
            k = -1 - word.place
            curve = baselines[k].curve * mm_per_pixel ** (1.0 - np.arange(len(baselines[k].curve)))
            x_height_mm = float(x_height[k]) * mm_per_pixel
            line = TextLine(
                left_mm=word.left * mm_per_pixel,
                right_mm=word.right * mm_per_pixel,
                baseline=tuple(map(float, curve)),
                x_height_mm=x_height_mm,
                ascent_mm=ascent * x_height_mm,
                descent_mm=descent * x_height_mm,
                cell=cell if row.is_cells else 0,
            )
            lines.append(line)
    return PageLines(page, paper, lines, left_out, any(row.is_doubtful for row in order))


def _left_out(small: int, pictures: int) -> str:
    """Return in words what of a page is not among its lines; empty if nothing."""
    counts = ((small, "line", "too small"), (pictures, "picture", ""))
    return ", ".join(f"{n} {what}{'s' * (n > 1)} {why}".strip() for n, what, why in counts if n)


def _measured(ink: Ink, rows: list[Components]) -> tuple[list[Baseline], int]:
    """Return the baselines of rows that are text, and the number of those too small to be read."""
    measured: list[Baseline] = []
    slope_at: Callable[[Floats, Floats], Floats] | None = None
    small = 0
    for tried, row in enumerate(sorted(rows, key=_length, reverse=True)):
        if tried > _HOPELESS + _MISSES * len(measured):
            break
        slope = None
        if measured and _length(row) <= _LONG_ROW:
            # Rows come by their length: all long ones are known.
            slope_at = slope_at or _slopes(measured)
            slope = float(slope_at(np.array(np.median(row.left)), np.array(np.median(row.bottom))))
        baseline = measure_row(ink, row, slope)
        small += baseline.is_too_small
        if baseline.is_text:
            measured.append(baseline)
    return _credible(ink, measured), small


def _credible(ink: Ink, lines: list[Baseline]) -> list[Baseline]:
    """Return lines that are no part of a picture. These are amid other ink, have few letters, or
    letters of many heights."""
    rest, covered = ink.astype(np.uint8), np.zeros(ink.shape, np.uint8)
    for line in lines:
        x = np.linspace(line.left, line.right, _PLACES)
        top, bottom = (line.at(x) + reach * line.x_height for reach in _OWN)
        corners = np.column_stack([np.append(x, x[::-1]), np.append(top, bottom[::-1])])
        outline = [np.rint(corners).astype(np.int32)]
        if len(line.rise) > 1:
            cv2.fillPoly(rest, outline, (0,))
        if len(line.rise) >= _FEW:
            cv2.fillPoly(covered, outline, (1,))
    total = cv2.integral(rest)
    credible, sure = [], []
    for line in lines:
        size, count, even = line.letters.usual_height, len(line.rise), line.on_levels >= _EVEN
        rows = np.clip(line.middle_y + np.multiply(_AROUND, size), 0, len(ink)).astype(int)
        ends = np.clip([line.left - size, line.right + size], 0, ink.shape[1]).astype(int)
        around = total[np.ix_(rows, ends)].astype(np.float64)
        area = int(line.letters.area.sum())
        foreign = around[1, 1] - around[0, 1] - around[1, 0] + around[0, 0] - area * (count == 1)
        limit = _NEAR_FOREIGN if even and count >= _FEW else _FOREIGN
        # A few letters amid a line are its dots and accents.
        middle = min(round(line.middle_y - size / 2), len(ink) - 1)
        amid = count < _FEW and covered[middle, round((line.left + line.right) / 2)]
        if not amid and foreign < limit * area * min(count, _MANY):
            credible.append(line)
            sure += [line.x_height] if count >= (_FEW if even else _MANY) else []
    if not sure:
        area = sum(int(line.letters.area.sum()) for line in credible)
        return credible if area > _MOST_OF_ALL * np.count_nonzero(ink) else []
    sizes = np.array([line.x_height for line in credible])
    alike = np.abs(np.log(sizes[:, None] / sure)).min(axis=1) < math.log(_SIMILAR)
    return [credible[k] for k in np.flatnonzero(alike)]


def _length(row: Components) -> float:
    return float(row.right.max() - row.left.min()) / row.usual_height


def _slopes(guides: list[Baseline]) -> Callable[[Floats, Floats], Floats]:
    """Return the slope of lines at x and y, smooth over the page; level without guides."""
    if not guides:
        return lambda x, y: np.zeros_like(x)
    x = np.array([np.linspace(guide.left, guide.right, 7) for guide in guides])
    y = np.array([guide.at(along) for guide, along in zip(guides, x, strict=True)])
    slope = np.gradient(y, axis=1) / np.gradient(x, axis=1)
    size = max(float(x.max()), float(y.max()))

    def terms(x: Floats, y: Floats) -> Floats:
        return np.stack([np.ones_like(x), x, y, x * x, x * y], axis=-1)

    places = terms(x.ravel() / size, y.ravel() / size)
    solution = np.linalg.lstsq(places, slope.ravel(), rcond=0.05)[0]
    return lambda x, y: np.asarray(terms(x / size, y / size) @ solution)


def _levels(lines: list[Baseline]) -> Floats:
    """Return the y of lines, (N,), with the bend of the page taken out."""
    slope_at = _slopes([line for line in lines if _length(line.letters) > _LONG_ROW])
    x = np.array([(line.left + line.right) / 2 for line in lines])
    y = np.array([line.middle_y for line in lines])
    middle = (x.min() + x.max()) / 2
    return np.asarray(y - slope_at((x + middle) / 2, y) * (x - middle))


_REACH, _FARTHEST, _ABOVE, _BELOW = 1.2, 3.5, 1.6, 0.5
"""Largest distance of a mark from its line's end, of the last one, and of one above and below the
baseline, in x-heights."""
_THINNEST, _SHORTEST, _LONGEST = 0.06, 0.15, 2.5
"""Shorter and longer side of a dot, a dash or a single letter, in x-heights."""
_MEETING, _ONE_BASELINE, _ONE_SIZE = 1.2, 0.35, 1.5
"""White, offset of baselines, in x-heights, and ratio of sizes up to which two lines are one."""


def _with_marks(lines: list[Baseline], components: Components) -> list[Baseline]:
    """Return lines, each with the marks at its ends."""
    x, y = ((components.left + components.right) / 2, (components.top + components.bottom) / 2)
    thin, long = (side(components.width, components.height) for side in (np.minimum, np.maximum))
    letters = np.concatenate([line.letters.left + 1j * line.letters.top for line in lines])
    free = ~np.isin(components.left + 1j * components.top, letters)
    extended = []
    for line in lines:
        size = line.x_height
        above = (line.at(x) - y) / size
        mark = free & (above < _ABOVE) & (above > -_BELOW) & (thin > _THINNEST * size)
        mark &= (long > _SHORTEST * size) & (long < _LONGEST * size)
        starts, ends = components.left[mark], components.right[mark]
        left = -_reached(-line.left, -ends, -starts, size)
        right = _reached(line.right, starts, ends, size)
        moved = np.linspace(left, right, 4 * len(line.curve))
        degree = max(1, len(line.curve) - 1)
        curve = np.asarray(polynomial.polyfit(moved - left, line.at(moved), degree), np.float64)
        extended.append(replace(line, left=left, right=right, curve=curve))
    return extended


def _reached(end: float, starts: NDArray[np.int_], ends: NDArray[np.int_], size: float) -> float:
    """Return the end of a line with marks from ``starts`` to ``ends`` beside it."""
    reached = end
    for k in np.argsort(starts):
        if reached - size < starts[k] < reached + _REACH * size:
            reached = max(reached, float(ends[k]))
    # Longer rows of marks are leaders.
    return reached if reached - end < _FARTHEST * size else end


def _joined(ink: Ink, lines: list[Baseline]) -> list[Baseline]:
    """Return lines, those that meet as one."""
    joined: list[Baseline] = []
    for line in sorted(lines, key=lambda line: line.left):
        start = np.array(line.left)
        for k, other in enumerate(joined):
            size = min(line.x_height, other.x_height)
            if (
                line.left - other.right < _MEETING * size
                and max(line.x_height, other.x_height) < _ONE_SIZE * size
                and np.abs(other.at(start) - line.at(start)) < _ONE_BASELINE * size
            ):
                joined[k] = measure_row(ink, other.letters.joined(line.letters))
                break
        else:
            joined.append(line)
    return joined


_SAME, _CAPITALS, _CAPITAL = 0.15, 0.08, 1.42
"""Difference of x-heights of one print; part of tall letters below which all are capitals; height
of a capital, in x-heights."""
_ASCENT, _DESCENT = (1.25, 1.65), (0.35, 0.65)
"""Ranges of ascent and descent, in x-heights."""


def _sizes(lines: list[Baseline]) -> tuple[Floats, float, float]:
    """Return the x-height of each line, (N,) px, and the reach of all above and below, in those.

    Lines of one print share their size; those of capitals and figures measure taller.
    """
    size, length = np.array([(line.x_height, line.right - line.left) for line in lines]).T
    tall = np.array([np.mean(line.rise > 1.25 * line.x_height) for line in lines])
    capitals = np.abs(size / weighted_median(size, length) / _CAPITAL - 1) < _SAME
    size = np.where(capitals & (tall < _CAPITALS), size / _CAPITAL, size)
    near = np.abs(size[:, None] / size - 1) < _SAME
    size = np.array([weighted_median(size[k], length[k]) for k in near])
    above = np.concatenate([line.rise / x for line, x in zip(lines, size, strict=True)])
    below = np.concatenate([line.fall / x for line, x in zip(lines, size, strict=True)])
    ascent = float(np.clip(np.quantile(above, 0.93) + 0.03, *_ASCENT))
    return size, ascent, float(np.clip(np.quantile(below, 0.97) + 0.03, *_DESCENT))
