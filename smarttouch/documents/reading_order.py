"""The order in which lines are read: down the page, column after column."""

import numpy as np
from numpy.typing import NDArray

from smarttouch.documents.baselines import Floats

Flags = NDArray[np.bool_]

_LEAST_SHARED = 0.2
"""Least overlap of lines, one above the other, as a part of the shorter one's length."""
_HEADLINE, _SAME_SIZE = 1.3, 0.15
"""Least height of a headline, in usual ones of the page, and difference between its lines."""
_LEVEL = 1.5  # distance, in line heights, within which two lines are side by side
_SAME_LEVEL = 0.5  # difference of baselines, in line heights, of parts of one title or foot


def reading_order(left: Floats, right: Floats, y: Floats, height: Floats) -> list[int]:
    """Return the indices of lines in reading order, from their ends, baselines and heights, (N,).

    Two rules give the order of two lines (after Breuel, High performance document layout analysis,
    2003): the upper one comes first where one is above the other; the left one where they are in
    columns side by side and no line between them spans both.
    """
    left, right = _of_headlines(left, right, y, height)
    shared = np.minimum(right[:, None], right) - np.maximum(left[:, None], left)
    shorter = np.minimum((right - left)[:, None], right - left)
    over = shared > _LEAST_SHARED * shorter
    first = over & (y[:, None] < y)
    first |= _left_column(left, y, height, over)
    _put_outermost(first, left, y, height)
    return _sorted(first, np.lexsort((left, y)))


def _put_outermost(first: Flags, left: Floats, y: Floats, height: Floats) -> None:
    """Put a title far above all columns first, and numbers far below them last."""
    above = _far_above(y, height)
    first[above], first[:, above] = True, False
    below = _far_above(-y, height)
    first[:, below], first[below] = True, False
    for far in (above, below):
        first[np.ix_(far, far)] = left[far][:, None] < left[far]


def _far_above(y: Floats, height: Floats) -> Flags:
    """Return the uppermost line and those on its level, if they stand far above the others."""
    top = int(y.argmin())
    level = y < y[top] + _SAME_LEVEL * height[top]
    if level.all():
        return np.zeros(len(y), np.bool_)
    others = np.where(level, np.inf, y)
    far = float(others.min() - y[level].max()) > _LEVEL * height[int(others.argmin())]
    return np.asarray(level & far)


def _of_headlines(left: Floats, right: Floats, y: Floats, height: Floats) -> tuple[Floats, Floats]:
    """Return the ends of lines; the lines of one headline all reach as far as those above."""
    left, right = left.copy(), right.copy()
    large = height > _HEADLINE * np.median(height)
    for line in np.flatnonzero(large)[np.argsort(y[large])]:
        above = large & (y < y[line]) & (y > y[line] - _LEVEL * height[line])
        above &= (left < right[line]) & (right > left[line])
        above &= np.abs(height / height[line] - 1) < _SAME_SIZE
        if above.any():
            left[line] = min(left[line], left[above].min())
            right[line] = max(right[line], right[above].max())
    return left, right


def _left_column(left: Floats, y: Floats, height: Floats, over: Flags) -> Flags:
    """Return for each pair, (N, N), whether one is read first because it is on the left."""
    beside = ~over & (left[:, None] < left)
    level = np.abs(y[:, None] - y) < _LEVEL * np.maximum(height[:, None], height)
    # Each column must have lines beside the other one.
    columns = (over.astype(np.uint8) @ level.astype(np.uint8)) > 0
    columns |= columns.T
    first = beside & columns
    for line in np.flatnonzero(first.any(axis=1)):
        between = (np.minimum(y[line], y)[:, None] < y) & (y < np.maximum(y[line], y)[:, None])
        # Rows: the other line; columns: a line that may separate the two.
        first[line] &= ~(between & over[line] & over).any(axis=1)
    return first


def _sorted(first: Flags, usual: NDArray[np.int_]) -> list[int]:
    """Return an order that keeps the given precedence, and otherwise the usual one."""
    waiting = list(map(int, usual))
    order = []
    while waiting:
        blocked = first[np.ix_(waiting, waiting)].any(axis=0)
        # Contradictory rules leave none free: the usual order decides.
        order.append(waiting.pop(int(blocked.argmin())))
    return order
