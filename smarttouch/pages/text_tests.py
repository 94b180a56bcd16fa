"""Tests whether a row of spots is a line of text."""

import numpy as np
from numpy.typing import NDArray

from smarttouch.pages.baselines import Baseline
from smarttouch.pages.spots import Spots

_LEAST_X_HEIGHT_PX = 3.5  # least x-height of readable print
_SURE = 3  # fewest letters of a line; with fewer, specks form lines by chance
_TEXT = 10  # lines of a page beside which one or two single letters are rejected
_SIMILAR = 1.7  # ratio of x-heights of lines on a page; capitals and figures measure taller
_MOST_OF_ALL = 0.8  # part of the page's ink in one or two letters, on a page without other text
_ZONE = (0.15, 0.9)
"""Ink of the letters between baseline and top of an x; thin print has 0.3, bold 0.6."""
_MOST_BETWEEN = 0.35  # least ink between this line and its neighbors, relative to that in the line
_MOST_BESIDE = 0.65
"""Ink beside ascenders or descenders, relative to that in the line; print has 0.1 to 0.5."""
_LEAST_EDGE = 2.0
"""Fall of the ink at the baseline per x-height, of the ink in the line; print has 4 and more."""
_FEWEST_STROKES, _MOST_STROKES = 0.75, 2.6
"""Strokes per x-height of letters; print has 0.9 to 1.9, specks have fewer."""
_FEWER_STROKES = 0.45  # factor of strokes where letters run together
_STROKE_MORE = 0.7
"""Additional strokes per x-height of a single digit, which has no space beside it."""
_TOPS, _BOTTOMS = (1.0, 1.45), (0.0, -0.42)
"""Heights at which letters begin and end, in x-heights over the baseline."""
_MANY = 8  # number of letters in a line that must have some white between them
_SOLID = 0.75  # filled part of a spot's box: letters have 0.4 to 0.65, a disc 0.79
_LEAST_OWN = 0.6
"""Letters' part of the ink between baseline and top of an x: print has 1.0 and more."""
_NEAR, _NEAR_PX = 0.2, 0.5
"""Distance within which a letter begins or ends at such a height: in x-heights, plus pixels."""
_LEAST_ON_LEVELS, _RUN_TOGETHER_ON_LEVELS = 0.6, 0.5
"""Least part of such letters, and of words run together; print has 0.9 and more, words run
together 0.5 and more, specks 0.3 to 0.7."""
_FEWEST_JOINED, _SHARP, _CLEAR = 6, 3.5, 0.3
"""Least number of letters, and fall of the ink at the baseline, and most ink between lines, both as
above, by which a line of another script is known, whose letters end at other levels."""
_LEAST_WHITE = 0.06
"""Least white between letters that do not touch, of the line's length; print has 0.1 and more, but
what is left between light letters on dark has not."""
_IN_BLACK_LETTER = 0.85
"""Part of letters at their levels from which they need no white between them: those of old print
nearly touch."""
_FEWEST_CAPITALS, _IN_LINE, _MOSTLY, _WIDE = 5, 0.07, 0.7, (0.3, 1.35)
"""Capitals or figures of a line: their number, how even they are in their heights, which part of
them at least, and their usual width in heights; bars of a code are narrower."""
_OWN, _BAND = (-0.7, 1.9), 2.1
"""Extent of a line over its baseline, and of the bands beside it, in x-heights."""
_FOREIGN = 0.4  # most ink of no line in either band, relative to that of its letters
_BESIDE_A_PICTURE = 1.0
"""The same in one band, for rows of one or two with few strokes: specks at a picture's edge."""
_TOUCHING = 1.3  # usual width of spots in which letters run together, in x-heights


def is_too_small(baseline: Baseline, letters: Spots) -> bool:
    """Return whether a row may be a line of text that is too small to be read."""
    return baseline.x_height < _LEAST_X_HEIGHT_PX and len(letters.area) >= _MANY


def is_text(baseline: Baseline, letters: Spots) -> bool:
    """Return whether a row of letters that was followed is a line of text."""
    if baseline.x_height < _LEAST_X_HEIGHT_PX:
        return False
    # Dashes and wide spaces have little ink.
    covered = min(1.0, float(letters.width.sum()) / (baseline.right - baseline.left))
    if _are_capitals(baseline, letters):
        return True
    return _has_profile_of_text(baseline, covered) and _are_letters(baseline, letters, covered)


def _are_capitals(baseline: Baseline, letters: Spots) -> bool:
    """Return whether letters are capitals or figures in line, however near other lines are."""
    if len(letters.area) < _FEWEST_CAPITALS:
        return False
    near = _IN_LINE * letters.usual_height + _NEAR_PX
    base = baseline.at((letters.left + letters.right) / 2)
    even = [
        np.abs(edge - np.median(edge)) < near
        for edge in (base - letters.top, base - letters.bottom)
    ]
    wide = float(np.median(letters.width / letters.height))
    return bool(
        np.mean(even[0] & even[1]) > _MOSTLY
        and _WIDE[0] < wide < _WIDE[1]
        and (wide < 1 or not _are_solid(letters))
        and baseline.strokes > _FEWEST_STROKES
        and baseline.strokes < _MOST_STROKES
    )


def _has_profile_of_text(baseline: Baseline, covered: float) -> bool:
    """Return whether ink lies between baseline and top of an x, and little around."""
    zone = baseline.ink_between(0.05, 0.95)
    beside = max(baseline.ink_between(1.05, 1.45), baseline.ink_between(-0.45, -0.05))
    return (
        _ZONE[0] < zone / covered < _ZONE[1]
        and _ends_sharply(baseline, _LEAST_EDGE, _MOST_BETWEEN)
        and beside < _MOST_BESIDE * zone
    )


def _ends_sharply(baseline: Baseline, edge: float = _SHARP, between: float = _CLEAR) -> bool:
    """Return whether ink falls at the baseline, and there is little to the next lines."""
    zone = baseline.ink_between(0.05, 0.95)
    least = max(baseline.least_ink(1.2, 2.1), baseline.least_ink(-1.1, -0.1))
    fall = -float(np.diff(baseline.profile).min()) / baseline.step
    return least < between * zone and fall > edge * zone


def _are_letters(baseline: Baseline, letters: Spots, covered: float) -> bool:
    """Return whether spots have the strokes and positions of letters."""
    length_px = baseline.right - baseline.left
    length = length_px / baseline.x_height
    base = baseline.at((letters.left + letters.right) / 2)
    tops, bottoms = (base - edge for edge in (letters.top, letters.bottom))
    # Where most letters are tall, they were measured as an x.
    on_levels = max(
        min(_on_a_level(tops, _TOPS, x), _on_a_level(bottoms, _BOTTOMS, x))
        for x in (baseline.x_height, baseline.x_height / _TOPS[1])
    )
    line_px = baseline.ink_between(0.05, 0.95) * baseline.x_height * length_px
    run_together = float(np.median(letters.width)) > _TOUCHING * baseline.x_height
    parted = covered < 1 - _LEAST_WHITE or run_together or len(letters.area) < _MANY
    parted |= on_levels > _IN_BLACK_LETTER and _ends_sharply(baseline)
    return (
        parted
        and not (len(letters.area) >= _MANY and _are_solid(letters))
        and float(letters.area.sum()) > _LEAST_OWN * line_px
        and baseline.strokes > (_FEWER_STROKES if run_together else _FEWEST_STROKES) * covered
        and baseline.strokes < _MOST_STROKES + _STROKE_MORE / length
        and (
            on_levels > (_RUN_TOGETHER_ON_LEVELS if run_together else _LEAST_ON_LEVELS)
            or (len(letters.area) >= _FEWEST_JOINED and _ends_sharply(baseline))
        )
    )


def _on_a_level(height: NDArray[np.float64], levels: tuple[float, ...], x_height: float) -> float:
    """Return the part of some heights that is near one of the levels; all in pixels but these."""
    away = np.abs(height[:, None] - np.array(levels) * x_height).min(axis=1)
    return float(np.mean(away < _NEAR * x_height + _NEAR_PX))


def _are_solid(letters: Spots) -> bool:
    """Return whether spots are solid squares and discs, as of a halftone."""
    broad = letters.width > letters.height / 2
    if not broad.any():
        return False
    filled = letters.area[broad] / (letters.width[broad] * letters.height[broad])
    return bool(np.median(filled) > _SOLID)


def outside_pictures(
    lines: list[tuple[Baseline, Spots]], spots: Spots
) -> list[tuple[Baseline, Spots]]:
    """Return the lines without those amid other ink on both sides, which are parts of pictures.

    One or two that have fewer strokes than letters are so with ink on one side, too.
    """
    x, y = (spots.left + spots.right) / 2, (spots.top + spots.bottom) / 2
    size = spots.width * spots.height
    of_a_line = np.zeros(len(x), np.bool_)
    for baseline, _ in lines:
        above = (baseline.at(x) - y) / baseline.x_height
        inside = (x > baseline.left) & (x < baseline.right)
        of_a_line |= inside & (above > _OWN[0]) & (above < _OWN[1])

    def foreign(baseline: Baseline, low: float, high: float) -> float:
        top, bottom = (baseline.middle_y - height * baseline.x_height for height in (high, low))
        across = np.minimum(spots.right, baseline.right) - np.maximum(spots.left, baseline.left)
        down = np.minimum(spots.bottom, bottom) - np.maximum(spots.top, top)
        part = np.maximum(across, 0) * np.maximum(down, 0) / size
        return float((part * spots.area)[~of_a_line].sum())

    def belongs(baseline: Baseline, row: Spots) -> bool:
        above = foreign(baseline, _OWN[1], _OWN[1] + _BAND)
        below = foreign(baseline, _OWN[0] - _BAND, _OWN[0])
        own = int(row.area.sum())
        # Figures at the axis of a diagram have the strokes of letters.
        speck = len(row.area) < _SURE and baseline.strokes < _FEWEST_STROKES
        most = _BESIDE_A_PICTURE if speck else np.inf
        return min(above, below) < _FOREIGN * own and max(above, below) < most * own

    return [(baseline, row) for baseline, row in lines if belongs(baseline, row)]


def credible_lines(lines: list[tuple[Baseline, Spots]], ink: int) -> list[Baseline]:
    """Return the lines without specks that look like one letter; ``ink`` is that of the page, px.

    One or two letters alone are accepted if they are as large as a line of the page, or are most of
    its ink.
    """
    sure = [
        len(row.area) >= _MANY or (len(row.area) >= _SURE and baseline.strokes > _FEWEST_STROKES)
        for baseline, row in lines
    ]
    found = [baseline for (baseline, _), is_sure in zip(lines, sure, strict=True) if is_sure]
    sizes = np.array([baseline.x_height for baseline in found])
    if not found:
        alone = sum(int(row.area.sum()) for _, row in lines)
        return [baseline for baseline, _ in lines] if alone > _MOST_OF_ALL * ink else []
    left, right = min(each.left for each in found), max(each.right for each in found)
    kept = []
    for (baseline, _), is_sure in zip(lines, sure, strict=True):
        ratio = np.maximum(baseline.x_height / sizes, sizes / baseline.x_height)
        # Edges of sheets lie beside all text.
        beside = len(found) >= _TEXT and not left <= baseline.left <= right
        if is_sure or (ratio.min() < _SIMILAR and not beside):
            kept.append(baseline)
    return kept
