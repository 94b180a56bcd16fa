"""Rows of letters: each letter is linked to the next one, but not across columns."""

import numpy as np
from numpy.typing import NDArray

from smarttouch.pages.components import Components, widest_white

Indices = NDArray[np.int_]

_NEIGHBORS = 10  # candidates for the next letter, near the right edge of a letter
_WIDEST_GAP = 3.8  # in heights of the taller letter: a dash or = between two spaces
_LEAST_OVERLAP = 0.45  # of two letters of a row, as a part of the lower one's height
_LARGEST_RATIO = 2.8  # of heights in a row: a parenthesis has 2.5 times the height of an x
_LEAST_SPACE = 0.35  # narrowest space, in letter heights; a narrower gap is within a word
_NARROWEST, _WIDER, _WIDE = 0.75, 1.9, 2.2
"""Narrowest gutter, in letter heights, and in usual spaces; gap that may always be a gutter."""
_ALIGNED, _BESIDE = 0.5, 12.0
"""Farthest lines on the right of a narrow gutter, and beside any, in letter heights."""
_OTHER_LINE, _GUTTER_LINES, _MANY_LINES, _LITTLE_WIDER = 0.8, 2, 5, 1.25
"""Least distance of lines, in letter heights; lines that a gutter parts above or below, and those
that one parts which is little wider than the usual space, by that factor."""
_FAR = 1 << 30


def find_rows(letters: Components, marks: Components, walls: NDArray[np.bool_]) -> list[Indices]:
    """Return the indices of the letters of each row, from left to right.

    Rows end at ``walls``, (H, W), which are vertical rules and pictures, and at gutters. All
    components of the page, ``marks``, fill gaps between letters.
    """
    if len(letters.area) < 2:
        return [np.arange(1)] * len(letters.area)
    first, second, gap = link_neighbors(letters)
    middle = (letters.top[first] + letters.bottom[first]) // 2
    passed = np.cumsum(walls, axis=1, dtype=np.int32)
    ends = np.minimum(letters.left[second], walls.shape[1] - 1)
    free = passed[middle, ends] <= passed[middle, letters.right[first] - 1]
    first, second, gap = first[free], second[free], gap[free]
    kept = ~_over_gutters(letters, first, second, gap, marks)
    following = dict(zip(first[kept].tolist(), second[kept].tolist(), strict=True))
    rows = []
    for start in sorted(set(range(len(letters.area))) - set(following.values())):
        row = [start]
        while row[-1] in following:
            row.append(following[row[-1]])
        rows.append(np.array(row))
    return rows


def link_neighbors(letters: Components) -> tuple[Indices, Indices, Indices]:
    """Return links from letters to the next ones on their right, where both agree: (L,) indices of
    both, and the white between, px."""
    from scipy.spatial import cKDTree

    height, middle = letters.height, (letters.top + letters.bottom) / 2
    # Vertical distance counts twice.
    tree = cKDTree(np.column_stack([letters.left, 2 * middle]))
    near = min(_NEIGHBORS, len(height) - 1) + 1
    reach = 2 * _WIDEST_GAP * float(height.max())
    ends = np.column_stack([letters.right, 2 * middle])
    _, found = tree.query(ends, k=near, distance_upper_bound=reach)
    first, second = np.repeat(np.arange(len(height)), near), found.ravel()
    first, second = first[second < len(height)], second[second < len(height)]
    one, other = letters.of(first), letters.of(second)
    taller = np.maximum(one.height, other.height)
    lower = np.minimum(one.height, other.height)
    gap = other.left - one.right
    beside = np.minimum(one.bottom, other.bottom) - np.maximum(one.top, other.top)
    kept = (gap <= _WIDEST_GAP * taller) & (other.left + other.right > one.left + one.right)
    kept &= (beside >= _LEAST_OVERLAP * lower) & (taller <= _LARGEST_RATIO * lower)
    # A pixel of vertical offset costs as much as a pixel of gap.
    cost = (np.maximum(gap, 0) + lower - beside)[kept]
    cheapest = np.argsort(cost, kind="stable")
    first, second, gap = (each[kept][cheapest] for each in (first, second, gap))
    follows, precedes = (np.unique(each, return_index=True)[1] for each in (first, second))
    agreed = np.intersect1d(follows, precedes)
    return first[agreed], second[agreed], gap[agreed]


def _over_gutters(
    letters: Components, first: Indices, second: Indices, gap: Indices, marks: Components
) -> NDArray[np.bool_]:
    """Return for each link, (L,), whether it leads over a white lane that parts columns."""
    # Mean of both letters, as a parenthesis is much taller than the others.
    mean = (letters.height[first] + letters.height[second]) / 2
    part = gap / mean
    spaces = part[part > _LEAST_SPACE]
    usual = float(np.median(spaces)) if len(spaces) else 0.0
    narrow, sure = (
        max(_NARROWEST, _LITTLE_WIDER * usual),
        min(max(_NARROWEST, _WIDER * usual), _WIDE),
    )
    over = np.zeros(len(first), np.bool_)
    for k in np.flatnonzero(part > narrow):
        size, y = float(mean[k]), float(letters.bottom[first[k]] + letters.bottom[second[k]]) / 2
        ends = float(letters.right[first[k]]), float(letters.left[second[k]])
        start, end = widest_white(marks, *ends, y - size, y)
        if end - start <= narrow * size:
            continue
        # Columns are aligned at one side, so the lane lies at an edge of the gap.
        width = _NARROWEST * size
        lanes, reach = [end - width], _ALIGNED * size + width
        if end - start > _WIDE * size:
            lanes, reach = [end - width, start, (start + end - width) / 2], _BESIDE * size
        fewest = _GUTTER_LINES if end - start > sure * size else _MANY_LINES
        over[k] = any(_parts_columns(letters, at, y, size, reach) >= fewest for at in lanes)
    return over


def _parts_columns(letters: Components, left: float, y: float, size: float, reach: float) -> int:
    """Return the number of other lines, on both sides, between which a lane is white.

    Those on its right begin at most ``reach`` px from its left edge.
    """
    right = left + _NARROWEST * size
    across = (letters.right > left) & (letters.left < right)
    above = letters.bottom[across & (letters.bottom < y - size / 2)].max(initial=-_FAR)
    below = letters.top[across & (letters.top > y - size / 2)].min(initial=_FAR)
    beside = (letters.top > above) & (letters.bottom < below)
    beside &= np.abs(letters.bottom - y) > _OTHER_LINE * size
    lines = []
    for near in (
        (letters.left >= right) & (letters.left < left + reach),
        (letters.right <= left) & (letters.right > left - _BESIDE * size),
    ):
        bottoms = np.sort(letters.bottom[beside & near])
        lines.append(int(np.count_nonzero(np.diff(bottoms, prepend=-_FAR) > _OTHER_LINE * size)))
    return min(lines)
