"""Marks of a line, such as dots, dashes and quotes at its ends, and lines that they join."""

from dataclasses import replace

import numpy as np
from numpy.polynomial import Polynomial, polynomial

from smarttouch.documents.baselines import Baseline
from smarttouch.documents.letters import Spots, widest_white

_THINNEST, _SHORTEST, _LONGEST = 0.06, 0.15, 2.5
"""Shorter and longer side of a dot, a dash or a single letter, in x-heights."""
_REACH = 1.2  # largest distance of a mark from its line's end, in x-heights
_ABOVE, _BELOW = 1.6, 0.5
"""Largest distance of a mark's middle above and below the baseline, in x-heights."""
_FARTHEST = 5.0
"""Longest row of marks, or gap to a line's other part, beyond a line's end, in x-heights."""
_MEETING = 1.2  # widest white between two parts of a line that is no gutter, in x-heights
_OF_A_LINE = 0.7  # least height of a line of its own, as a part of an x beside it
_OF_TWO_LINES = 2.0  # length of letters of two lines that touch, in x-heights
_OF_TEXT = 0.75  # strokes per x-height of a line of text; dots and accents have fewer
_HANGING = 1.2  # lowest end below a line of a mark that hangs from it, in x-heights
_ONE_BASELINE = 0.35  # largest offset of the baselines of two parts of a line, in x-heights
_ONE_SIZE = 1.5  # largest ratio of their x-heights


def with_marks(baselines: list[Baseline], spots: Spots) -> list[Baseline]:
    """Extend lines by the marks at their ends, and join those that then meet."""
    lines = sorted(_lengthened(baselines, spots), key=lambda line: line.left)
    joined: list[Baseline] = []
    for line in lines:
        before = [k for k, other in enumerate(joined) if _continues(other, line, spots)]
        if before:
            nearest = max(before, key=lambda k: joined[k].right)
            joined[nearest] = _joined(joined[nearest], line)
        else:
            joined.append(line)
    return [line for line in joined if not any(_belongs(line, other) for other in joined)]


def _lengthened(baselines: list[Baseline], spots: Spots) -> list[Baseline]:
    """Return the lines with the marks beside them; each mark goes to the nearest line."""
    x, y = (spots.left + spots.right) / 2, (spots.top + spots.bottom) / 2
    nearest = np.full(len(x), -1)
    least = np.full(len(x), np.inf)
    for index, baseline in enumerate(baselines):
        size = baseline.x_height
        above = (baseline.at(x) - y) / size
        beyond = np.maximum(np.maximum(baseline.left - x, x - baseline.right), 0) / size
        smaller = np.minimum(spots.width, spots.height) / size
        larger = np.maximum(spots.width, spots.height) / size
        mark = (above < _ABOVE) & (above > -_BELOW)
        mark &= (smaller > _THINNEST) & (larger > _SHORTEST) & (larger < _LONGEST)
        away = np.abs(above - 0.5) + beyond
        nearer = mark & (beyond < _FARTHEST) & (away < least)
        nearest[nearer] = index
        least[nearer] = away[nearer]
    return [_reaching(baseline, spots.of(nearest == k)) for k, baseline in enumerate(baselines)]


def _reaching(baseline: Baseline, marks: Spots) -> Baseline:
    """Extend a line from mark to mark, on either side."""
    left, right = baseline.left, baseline.right
    reach = _REACH * baseline.x_height
    for k in np.argsort(marks.left):
        if marks.left[k] < right + reach:
            right = max(right, float(marks.right[k]))
    for k in np.argsort(-marks.right):
        if marks.right[k] > left - reach:
            left = min(left, float(marks.left[k]))
    moved = Polynomial(baseline.baseline)(Polynomial([left - baseline.left, 1]))
    return replace(baseline, left=left, right=right, baseline=np.asarray(moved.coef, np.float64))


def _continues(line: Baseline, other: Baseline, spots: Spots) -> bool:
    """Return whether another line continues one, directly or by ink between them."""
    size = min(line.x_height, other.x_height)
    if other.left - line.right > _FARTHEST * size or other.right <= line.right:
        return False
    if max(line.x_height, other.x_height) > _ONE_SIZE * size:
        return False
    meeting = np.array((other.left + min(line.right, other.right)) / 2)
    base = float(line.at(meeting))
    if abs(base - float(other.at(meeting))) > _ONE_BASELINE * size:
        return False
    if other.left <= line.right:
        return True
    white = widest_white(spots, line.right, other.left, base - size, base)
    return white[1] - white[0] < _MEETING * size


def _joined(line: Baseline, other: Baseline) -> Baseline:
    """Return two lines as one."""
    longer = max(line, other, key=lambda each: each.right - each.left)
    x = np.linspace(line.left, other.right, 50)
    y = np.where(x < (line.right + other.left) / 2, line.at(x), other.at(x))
    degree = len(longer.baseline) - 1 or 1
    baseline = np.asarray(polynomial.polyfit(x - line.left, y, degree), np.float64)
    return replace(longer, left=line.left, right=other.right, baseline=baseline)


def _belongs(line: Baseline, other: Baseline) -> bool:
    """Return whether a line consists of dots and accents of another one."""
    size = other.x_height
    if line is other or (
        line.x_height > _OF_A_LINE * size and line.right - line.left > _OF_TWO_LINES * size
    ):
        return False
    middle = (line.left + line.right) / 2
    at = np.array(middle)
    above = float(other.at(at) - line.at(at)) / size
    if line.strokes > _OF_TEXT and not 0 < above < 1:
        # Small print under a headline.
        return False
    return other.left < middle < other.right and -_HANGING < above < _ABOVE
