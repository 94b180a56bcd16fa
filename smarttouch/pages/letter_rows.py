"""Rows of letters, side by side, cut between columns."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.pages.spots import Spots, widest_white

Indices = NDArray[np.int_]

_NEIGHBORS = 10  # candidates for the next letter, near the right edge of a letter
_WIDEST_GAP = 3.8
"""Widest gap in a row, in heights of the taller letter: a dash or = between two spaces."""
_LEAST_OVERLAP = 0.45
"""Least vertical overlap of two letters of a row, as a part of the lower one's height."""
_MOST_RATIO = 2.8
"""Largest ratio of heights in a row: a parenthesis has 2.5 times the height of an x."""
_FEW = 2  # letters in a row that is accepted only if it is isolated
_AROUND, _CROWD = 2.0, 6
"""Radius, in heights, around such a letter, and the largest number of letters in it."""
_LEAST_SPACE = 0.35  # narrowest space, in letter heights; a narrower gap is within a word
_NARROWEST = 0.75  # narrowest gutter between columns, in letter heights
_WIDER = 1.9  # factor by which a gutter is wider than the usual space between words
_WIDE = 2.2  # gap, in letter heights, that may be a gutter however wide the usual ones are
_GUTTER_LINES, _LONG, _LITTLE_WIDER = 2, 5, 1.25
"""Lines above or below, on either side, that a gutter must separate as well, and the number from
which it may be as narrow as a space."""
_ALIGNED = 0.5
"""Distance, in letter heights, from the edge of a gutter that is not wide to lines on its right:
rivers of white through justified text end anywhere."""
_OTHER_LINE = 0.8  # least distance of lines, in letter heights
_BESIDE = 12.0  # largest distance of their letters from the gutter, in letter heights
_FAR = 1 << 30


@dataclass(frozen=True, eq=False)
class Links:
    """Links from letters to the next ones; indices, and the white between."""

    first: Indices
    second: Indices
    gap: NDArray[np.int_]


def find_rows(
    letters: Spots, spots: Spots, dividers: NDArray[np.bool_] | None = None
) -> list[Indices]:
    """Return the indices of the letters of each row, from left to right.

    Rows end at ``dividers``, (H, W) bool: vertical rules and pictures. Marks among ``spots``, all
    ink of the page, fill a gap between letters.
    """
    count = len(letters.area)
    if count < 2:
        return [np.arange(count)] if count else []
    links = neighbors(letters)
    if dividers is not None and dividers.any():
        links = _undivided(letters, links, dividers)
    links = _without_gutters(letters, links, spots)
    row_of = least_linked(count, links.first, links.second)
    order = np.lexsort((letters.left, row_of))
    rows = np.split(order, np.flatnonzero(np.diff(row_of[order])) + 1)
    # Letters of longer rows do not count: cells of a table have them above and below.
    few = np.bincount(row_of)[row_of] <= _FEW
    if not few.any():
        return rows
    crowded = np.zeros(count, np.bool_)
    crowded[few] = _are_crowded(letters.of(few))
    return [row for row in rows if not crowded[row].any()]


def least_linked(count: int, first: Indices, second: Indices) -> Indices:
    """Return for each of some nodes, (N,), the least one that links (L,) lead to, over others too.

    As `scipy.sparse.csgraph` would number them, whose import takes a fifth of a run's start.
    """
    least = np.arange(count)
    while True:
        lower = np.minimum(least[first], least[second])
        found = least.copy()
        np.minimum.at(found, least[first], lower)
        np.minimum.at(found, least[second], lower)
        found = found[found]
        if (found == least).all():
            return least
        least = found


def _are_crowded(letters: Spots) -> NDArray[np.bool_]:
    """Return for each letter, (N,), whether it is too crowded for print: specks of a picture."""
    from scipy.spatial import cKDTree

    center = np.column_stack([letters.left + letters.right, letters.top + letters.bottom]) / 2
    reach = _AROUND * letters.height
    around = cKDTree(center).query_ball_point(center, reach, return_length=True)
    return np.asarray(around > _CROWD)


def neighbors(letters: Spots) -> Links:
    """Link each letter to the next one on its right, where both agree."""
    from scipy.spatial import cKDTree

    height = letters.height
    middle = (letters.top + letters.bottom) / 2
    # Vertical distance counts twice.
    tree = cKDTree(np.column_stack([letters.left, 2 * middle]))
    near = min(_NEIGHBORS, len(height) - 1) + 1
    reach = _WIDEST_GAP * float(height.max())
    _, second = tree.query(
        np.column_stack([letters.right, 2 * middle]), k=near, distance_upper_bound=2 * reach
    )
    first = np.repeat(np.arange(len(height)), near)
    second = second.ravel()
    found = second < len(height)
    first, second = first[found], second[found]
    taller = np.maximum(height[first], height[second])
    lower = np.minimum(height[first], height[second])
    gap = letters.left[second] - letters.right[first]
    beside = np.minimum(letters.bottom[first], letters.bottom[second]) - np.maximum(
        letters.top[first], letters.top[second]
    )
    kept = (
        (letters.left[second] + letters.right[second] > letters.left[first] + letters.right[first])
        & (gap <= _WIDEST_GAP * taller)
        & (beside >= _LEAST_OVERLAP * lower)
        & (taller <= _MOST_RATIO * lower)
        & (first != second)
    )
    first, second, gap, beside, lower = (each[kept] for each in (first, second, gap, beside, lower))
    # A pixel of vertical offset costs as much as a pixel of gap.
    cost = np.maximum(gap, 0) + (lower - beside)
    follows = _cheapest(first, cost)
    precedes = _cheapest(second, cost)
    agreed = np.intersect1d(follows, precedes)
    return Links(first[agreed], second[agreed], gap[agreed])


def _cheapest(of: Indices, cost: NDArray[np.float64]) -> Indices:
    """Return the index of the cheapest link of each letter."""
    order = np.lexsort((cost, of))
    is_first = np.diff(of[order], prepend=-1) != 0
    return np.asarray(order[is_first], np.int_)


def _undivided(letters: Spots, links: Links, dividers: NDArray[np.bool_]) -> Links:
    """Return the links that no rule or picture crosses halfway up the letters."""
    middle = (letters.top[links.first] + letters.bottom[links.first]) // 2
    passed = np.cumsum(dividers, axis=1, dtype=np.int32)
    ends = np.minimum(letters.left[links.second], dividers.shape[1] - 1)
    kept = passed[middle, ends] <= passed[middle, letters.right[links.first] - 1]
    return Links(links.first[kept], links.second[kept], links.gap[kept])


def _without_gutters(letters: Spots, links: Links, spots: Spots) -> Links:
    """Remove links over a white lane that runs down between columns."""
    # Mean of both letters, as a parenthesis is much taller than the others.
    mean = (letters.height[links.first] + letters.height[links.second]) / 2
    part = links.gap / mean
    spaces = part[part > _LEAST_SPACE]
    usual = float(np.median(spaces)) if len(spaces) else 0.0
    narrowest = min(max(_NARROWEST, _WIDER * usual), _WIDE)
    long_narrowest = max(_NARROWEST, _LITTLE_WIDER * usual)
    kept = np.ones(len(links.first), bool)
    for k in np.flatnonzero(part > long_narrowest):
        first, second = links.first[k], links.second[k]
        y = float(letters.bottom[first] + letters.bottom[second]) / 2
        size = float(mean[k])
        white = widest_white(
            spots, int(letters.right[first]), int(letters.left[second]), y - size, y
        )
        gap = (white[1] - white[0]) / size
        if gap <= long_narrowest:
            continue
        fewest = _GUTTER_LINES if gap > narrowest else _LONG
        # Columns are aligned at one side, so the lane lies at an edge of the gap.
        width = _NARROWEST * size
        lanes = [white[1] - width]
        reach = _ALIGNED * size + width
        if gap > _WIDE:
            lanes += [white[0], (white[0] + white[1] - width) / 2]
            reach = _BESIDE * size
        kept[k] = not any(
            _parts_columns(letters, (lane, lane + width), y, size, fewest, reach) for lane in lanes
        )
    return Links(links.first[kept], links.second[kept], links.gap[kept])


def _parts_columns(
    letters: Spots, lane: tuple[float, float], y: float, size: float, fewest: int, reach: float
) -> bool:
    """Return whether a lane is white over several lines with letters on both sides of it.

    Those on its right begin at most ``reach`` px from its left edge.
    """
    left, right = lane
    across = (letters.right > left) & (letters.left < right)
    above = letters.bottom[across & (letters.bottom < y - size / 2)].max(initial=-_FAR)
    below = letters.top[across & (letters.top > y - size / 2)].min(initial=_FAR)
    beside = (letters.top > above) & (letters.bottom < below)
    beside &= np.abs(letters.bottom - y) > _OTHER_LINE * size
    for near in (
        (letters.left >= right) & (letters.left < left + reach),
        (letters.right <= left) & (letters.right > left - _BESIDE * size),
    ):
        bottoms = np.sort(letters.bottom[beside & near])
        if np.count_nonzero(np.diff(bottoms, prepend=-_FAR) > _OTHER_LINE * size) < fewest:
            return False
    return True
