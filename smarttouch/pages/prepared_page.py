"""Pages prepared for reading: straight, dark on white, with their lines in reading order."""

import math
import textwrap
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.polynomial import Polynomial
from PIL import Image, ImageDraw, ImageFont

from smarttouch.base.errors import PageError
from smarttouch.pages.ink import Grey, separate_ink
from smarttouch.pages.letter_rows import (
    MANY,
    Baseline,
    Components,
    Floats,
    Ink,
    find_components,
    find_rows,
    find_rules,
    like_letters,
    measure_row,
    part_lines,
    usual_height,
    weighted_median,
)
from smarttouch.pages.page_and_lines import INCH_MM, Page, TextLine, require_size_mm
from smarttouch.pages.reading_order import DOUBTFUL, Segment, reading_order
from smarttouch.pages.straighten import cut_strip, find_sheet, flattened, turned

LAID_FLAT = "the sheet of paper was cut out of the photograph and laid flat"
FAINT = "faint marks, such as print on the back of the sheet"
_SMALL_PX = 9.0  # letter height below which a page is enlarged
_LARGEST_PIXELS = 40_000_000  # largest number of pixels of an enlarged page
_PICTURE = 9.0  # smallest width and height of a picture, in letter heights
_FILLED = 0.15  # smallest share of ink in the box of a picture
_FEWEST_PIXELS = 3  # smallest area of a component of print, pixels
_HEIGHT = 0.96  # distance from ascender to descender, in font sizes


@dataclass(frozen=True, eq=False)
class PreparedPage:
    """Straight page, dark on pure white, with lines in reading order."""

    page: Page
    cleaned: Grey
    lines: tuple[TextLine, ...]
    light_on_dark: bool
    notes: tuple[str, ...] = ()
    words: tuple[str, ...] = ()  # text of each line, if the page provides it
    known: dict[int, tuple[str, float]] = field(default_factory=dict)
    """Recognized text of a line, with its confidence in [0, 1], by line index."""

    def strip(self, index: int, height_px: int) -> Grey:
        """Return a straightened line, (height_px, W) uint8, from ascenders to descenders."""
        return cut_strip(self.cleaned, self.page.mm_per_pixel, self.lines[index], height_px)


def find_lines(page: Page, light_on_dark: bool | None = False) -> list[TextLine]:
    """Return a page's lines in reading order. If ``light_on_dark`` is None, detect it."""
    return list(_with_lines(page, light_on_dark).lines)


def prepare_page(
    page: Page, light_on_dark: bool | None = None, leftward: bool = False
) -> PreparedPage:
    """Prepare a scan, photograph or picture of print for reading. By default, detect whether print
    is light on dark. Columns of ``leftward`` scripts are read from right to left."""
    corners = find_sheet(page.grey)
    if corners is None:
        return _with_lines(page, light_on_dark, leftward, turn=True)
    sheet = Page(flattened(page.grey, corners), page.mm_per_pixel)
    prepared = _with_lines(sheet, light_on_dark, leftward, turn=True)
    return replace(prepared, notes=(LAID_FLAT, *prepared.notes))


def _with_lines(
    page: Page, light_on_dark: bool | None, leftward: bool = False, turn: bool = False
) -> PreparedPage:
    """Find the lines of a page.

    With ``turn``, correct the skew of the page first. Invert dark panels. Enlarge small print.
    """
    paper = separate_ink(page.grey, light_on_dark)
    light_on_dark, ink, cleaned = paper.light_on_dark, paper.ink, paper.cleaned
    components, labels = find_components(ink)
    height = usual_height(components, ink.shape)
    if height is None:
        notes = ("left out: " + FAINT,) * paper.faint
        return PreparedPage(page, cleaned, (), light_on_dark, notes)
    skew_deg = skew_of(components.of(like_letters(components, height)), height)
    if turn and skew_deg:
        level = Page(turned(page.grey, skew_deg), page.mm_per_pixel)
        prepared = _with_lines(level, light_on_dark, leftward)
        note = f"the text was tilted by {abs(skew_deg):.1f}° and was turned level"
        return replace(prepared, notes=(note, *prepared.notes))
    factor = math.ceil(_SMALL_PX / height)
    if 1 < factor**2 <= _LARGEST_PIXELS / page.grey.size:
        grey = cv2.resize(page.grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
        larger = Page(np.asarray(grey, np.uint8), page.mm_per_pixel / factor)
        return _with_lines(larger, light_on_dark, leftward)
    panels = _panels(ink, components, height)
    if panels.any():
        ink, cleaned = ink ^ panels, np.where(panels, ~cleaned, cleaned)
    rules, dividers = find_rules(ink, height)
    ink &= ~rules & ~dividers
    components, _ = find_components(ink)
    ink = part_lines(ink, components, height)
    components, labels = find_components(ink)
    large = np.minimum(components.width, components.height) > _PICTURE * height
    pictures = large & (components.area > _FILLED * components.width * components.height)
    walls = dividers | np.append(False, pictures)[labels]
    components = components.of(components.area >= _FEWEST_PIXELS)
    letters = components.of(like_letters(components, height))
    slope = math.tan(math.radians(skew_deg))
    lines, small = _measured(ink, find_rows(letters, ink, walls, height), slope)
    order, is_doubtful = _ordered(lines, components, page, slope, leftward)
    counts = ((small, "line", "too small"), (int(pictures.sum()), "picture", ""))
    left_out = [f"{n} {what}{'s' * (n > 1)} {why}".strip() for n, what, why in counts if n]
    left_out += [FAINT] * paper.faint
    notes = (DOUBTFUL,) * is_doubtful + ("left out: " + ", ".join(left_out),) * bool(left_out)
    return PreparedPage(page, cleaned, order, light_on_dark, notes)


_SKEWS_DEG = np.linspace(-16, 16, 321)
_LEAST_SKEW_DEG = 0.2  # smallest skew to correct
_PEAK_DEG = 0.6  # candidate skews within this distance of the best candidate are averaged
_BIN = 0.25  # bin size of the histogram of letter bottoms, in letter heights
_FEWEST = 30  # smallest number of letters with which the skew is measured
_SURE = 2.0  # the skew is certain if its score exceeds the median score by this factor


def skew_of(letters: Components, height: float) -> float:
    """Return the clockwise skew of a page, degrees, or 0 if uncertain. At this skew, letter
    bottoms align best. ``height`` is the typical letter height, px."""
    x = (letters.left + letters.right) / 2
    if len(x) < _FEWEST:
        return 0.0
    rows = (letters.bottom - np.tan(np.radians(_SKEWS_DEG))[:, None] * x) / (_BIN * height)
    rows = (rows - rows.min()).astype(int)
    count = np.array([float(np.square(np.bincount(row)).sum()) for row in rows])
    near = np.abs(_SKEWS_DEG - _SKEWS_DEG[count.argmax()]) < _PEAK_DEG
    skew_deg = np.average(_SKEWS_DEG, weights=near * np.maximum(count - 0.7 * count.max(), 0))
    sure = count.max() > _SURE * np.median(count)
    return float(skew_deg) if sure and abs(skew_deg) >= _LEAST_SKEW_DEG else 0.0


_LEAST_SIDES = (2.5, 5.0)  # smallest height and width of a dark panel, in letter heights
_LEAST_INK = 0.6  # smallest share of ink in a dark panel
_LIGHT_LETTER = (0.5, 9.0)  # range of letter heights in dark panels, relative to the page's letters
_FEWEST_LETTERS = 4  # smallest number of letters in a dark panel


def _panels(ink: Ink, components: Components, height: float) -> Ink:
    """Return a mask of dark panels with light print, (H, W)."""
    wide, tall = components.width, components.height
    large = (tall > _LEAST_SIDES[0] * height) & (wide > _LEAST_SIDES[1] * height)
    panels = np.zeros_like(ink)
    for k in np.flatnonzero(large & (components.area > _LEAST_INK * wide * tall)).tolist():
        box = components.box(k)
        letters, _ = find_components(~ink[box])
        typical = usual_height(letters, ink.shape) or 0.0
        alike = np.count_nonzero((letters.height > typical / 2) & (letters.height < 2 * typical))
        right_size = _LIGHT_LETTER[0] * height < typical < _LIGHT_LETTER[1] * height
        panels[box] |= right_size and alike >= _FEWEST_LETTERS
    return panels


_HOPELESS = 60  # if none of this many rows is text, the other rows are not measured
_MISSES = 3  # number of rows by which each row that is text raises the limit `_HOPELESS`
_LEAST_X_HEIGHT_PX = 3.5  # smallest x-height of readable print
_SHORT = 11.0  # a row shorter than this, in letter heights, gets the slope of the nearest line


def _measured(ink: Ink, rows: list[Components], slope: float) -> tuple[list[Baseline], int]:
    """Measure rows; return the rows that are text, and the number of rows too small to read."""
    measured: list[Baseline] = []
    small = 0
    for tried, row in enumerate(sorted(rows, key=lambda row: -row.length)):
        if tried > _HOPELESS + _MISSES * len(measured):
            break
        if row.length < _SHORT and measured:
            x, y = float(np.median(row.left)), float(np.median(row.bottom))
            off = [
                abs(line.middle_y - y) + max(line.left - x, x - line.right, 0) for line in measured
            ]
            slope = float(np.diff(measured[int(np.argmin(off))].at(np.array([x, x + 1])))[0])
        line = measure_row(ink, row, slope)
        if line.x_height < _LEAST_X_HEIGHT_PX:
            small += len(row.area) >= MANY
        elif line.is_text:
            measured.append(line)
    return _credible(ink, measured), small


_EVEN = 0.85  # smallest share of letters with typical heights in a uniform line
_FEW = 4  # a line with uniform heights (`_EVEN`) and at least this many letters is surely text
_SIMILAR = 1.7  # a line of text has an x-height within this factor of a line that is certainly text
_MOST_OF_ALL = 0.8  # if no line is certainly text, lines must contain this share of the page's ink
_OWN = (-1.8, 0.6)  # top and bottom of a line relative to the baseline, in x-heights
_AROUND = (-1.7, 0.5)  # area around a line: top and bottom from the baseline, in letter heights
_FOREIGN = 0.1  # largest other ink around a line of one letter, relative to the line's ink; lines
# of N letters may have N times as much, of more than `MANY` letters `MANY` times as much
_NEAR_FOREIGN = 0.5  # replaces `_FOREIGN` in a uniform line (`_EVEN`) of at least `_FEW` letters


def _credible(ink: Ink, lines: list[Baseline]) -> list[Baseline]:
    """Return the lines that are not parts of a picture. A line in a picture is surrounded by other
    ink, or has few letters, or has letters of many different heights."""
    rest = ink.astype(np.uint8)
    for line in (line for line in lines if len(line.rise) > 1):
        x = np.linspace(line.left, line.right, 20)
        top, bottom = (line.at(x) + reach * line.x_height for reach in _OWN)
        corners = np.column_stack([np.append(x, x[::-1]), np.append(top, bottom[::-1])])
        cv2.fillPoly(rest, [np.rint(corners).astype(np.int32)], (0,))
    credible, sure = [], []
    for line in lines:
        size, count, even = line.letters.usual_height, len(line.rise), line.on_levels >= _EVEN
        top, bottom = np.maximum(line.middle_y + np.multiply(_AROUND, size), 0).astype(int)
        left, right = max(0, round(line.left - size)), round(line.right + size)
        limit = _NEAR_FOREIGN if even and count >= _FEW else _FOREIGN
        area = int(line.letters.area.sum())
        # A line of one letter that mostly lies in another line is a part of a letter of that line.
        is_part = count == 1 and 2 * np.count_nonzero(rest[line.letters.box(0)]) < area
        limit = (limit * min(count, MANY) + (count == 1)) * area
        if np.count_nonzero(rest[top:bottom, left:right]) < limit and not is_part:
            credible.append(line)
            sure += [line.x_height] if count >= (_FEW if even else MANY) else []
    if not sure:
        area = sum(int(line.letters.area.sum()) for line in credible)
        return credible if area > _MOST_OF_ALL * np.count_nonzero(ink) else []
    return [
        line for line in credible
        if np.abs(np.log(np.divide(sure, line.x_height))).min() < math.log(_SIMILAR)
    ]  # fmt: skip


def _ordered(
    lines: list[Baseline], components: Components, page: Page, slope: float, leftward: bool
) -> tuple[tuple[TextLine, ...], bool]:
    """Return the lines in reading order, and whether this order is doubtful."""
    if not lines:
        return (), False
    x_height, ascent, descent = _sizes(lines)
    levels = [line.middle_y - slope * (line.left + line.right) / 2 for line in lines]
    sizes = ((ascent + descent) * x_height / _HEIGHT).tolist()
    ends = _ends(lines, components)
    words = [
        Segment("", left, right, level, size, -1 - k)
        for k, ((left, right), level, size) in enumerate(zip(ends, levels, sizes, strict=True))
    ]
    ordered, scale = reading_order(words, len(page.grey), leftward), page.mm_per_pixel
    found = []
    for row in ordered:
        for cell, word in enumerate(row.segments, 1):
            k = -1 - word.place
            size = float(x_height[k]) * scale
            moved = Polynomial(lines[k].curve)(Polynomial([word.left - lines[k].left, 1]))
            curve = np.asarray(moved.coef, np.float64)
            found.append(
                TextLine(
                    left_mm=word.left * scale,
                    right_mm=word.right * scale,
                    baseline=tuple((curve * scale ** (1.0 - np.arange(len(curve)))).tolist()),
                    x_height_mm=size,
                    ascent_mm=ascent * size,
                    descent_mm=descent * size,
                    cell=cell if row.is_cells else 0,
                )
            )
    return tuple(found), any(row.is_doubtful for row in ordered)


_REACH = 1.2  # largest gap between a line and a mark at its end, in x-heights
_FARTHEST = 3.5  # largest extension of a line by the marks at one end, in x-heights
_ABOVE, _BELOW = 1.6, 0.5  # largest distances of marks above and below the baseline, in x-heights
_LONGEST = 2.5  # largest side of a dot, dash or single letter, in x-heights


def _ends(lines: list[Baseline], components: Components) -> list[tuple[float, float]]:
    """Return the left and right ends of lines, including marks such as periods and dashes."""
    letters = np.concatenate([line.letters.left + 1j * line.letters.top for line in lines])
    free = components.of(~np.isin(components.left + 1j * components.top, letters))
    x, y = (free.left + free.right) / 2, (free.top + free.bottom) / 2
    long = np.maximum(free.width, free.height)
    ends = []
    for line in lines:
        size = line.x_height
        above = (line.at(x) - y) / size
        marks = free.of((above < _ABOVE) & (above > -_BELOW) & (long < _LONGEST * size))
        left, right = line.left, line.right
        for _ in range(8):
            near = (marks.left < right + _REACH * size) & (marks.right > left - _REACH * size)
            left = float(np.min(marks.left[near], initial=left))
            right = float(np.max(marks.right[near], initial=right))
        # If marks make a line much longer, the marks are leader dots: leave these marks out.
        left = left if line.left - left < _FARTHEST * size else line.left
        ends.append((left, right if right - line.right < _FARTHEST * size else line.right))
    return ends


_SAME = 0.15  # largest relative difference between x-heights of one font size
_CAPITALS = 0.08  # in a line of capitals, largest share of letters much taller than the others
_CAPITAL = 1.42  # height of a capital, in x-heights
_ASCENT, _DESCENT = (1.25, 1.65), (0.35, 0.65)
"""Plausible ranges of ascent and descent, in x-heights."""


def _sizes(lines: list[Baseline]) -> tuple[Floats, float, float]:
    """Return the x-height of each line, (N,) px, and the common ascent and descent, in x-heights.

    Lines of one font size get the same x-height. In a line of capitals and digits, the measured
    height is the height of capitals. The x-height is computed from this height.
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


PRINT_DPI = 300
_WIDTH_MM, _MARGIN_MM, _LINE_MM, _STEP_MM = 92.0, 7.0, 4.2, 8.0
"""Printed page: width, margins, height of lines, and distance from line to line."""
_COLUMNS = 30
_INK_LEVEL = 15
_PER_MM = PRINT_DPI / INCH_MM


def print_text(text: str) -> Page:
    """Print a text at 300 dpi, black on white. Return the page with its lines and their texts."""
    wrapped = [row for part in text.splitlines() for row in textwrap.wrap(part, _COLUMNS) or [""]]
    if not any(wrapped):
        raise PageError("the text is empty: write words after text:, for example text:Hello")
    height_mm = 2 * _MARGIN_MM + (len(wrapped) - 1) * _STEP_MM + _LINE_MM
    require_size_mm(f"the text of {len(wrapped)} lines", _WIDTH_MM, height_mm, "shorter text")
    sheet = Image.new("L", (round(_WIDTH_MM * _PER_MM), round(height_mm * _PER_MM)), 255)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=_LINE_MM * _PER_MM * 1.26)
    # heights above the baseline, mm: ascender, descender (negative), x-height
    high, low, x_high = (-font.getbbox(signs, anchor="ls")[k] / _PER_MM
                         for signs, k in (("dlA", 1), ("gpy", 3), ("x", 1)))  # fmt: skip
    lines = []
    for number, row in enumerate(wrapped):
        baseline_mm = _MARGIN_MM + number * _STEP_MM + font.getbbox("x")[3] / _PER_MM
        origin = _MARGIN_MM * _PER_MM, baseline_mm * _PER_MM
        draw.text(origin, row, fill=_INK_LEVEL, font=font, anchor="ls")
        if row:
            left, _, right, _ = (side / _PER_MM for side in font.getbbox(row))
            lines.append(TextLine(
                _MARGIN_MM + left, _MARGIN_MM + right, (baseline_mm,), x_high, high, -low
            ))  # fmt: skip
    words = tuple(row.strip() for row in wrapped if row)
    return Page(np.asarray(sheet), 1 / _PER_MM, tuple(lines), words)


def prepare_text(text: str) -> PreparedPage:
    """Print a text; return it as a prepared page with its lines and their texts."""
    page = print_text(text)
    return PreparedPage(page, page.grey, page.lines, False, words=page.words)
