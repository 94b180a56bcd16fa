"""Reading order of lines: columns one after another, boxes after their column, tables by rows."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int_]
NO_BOXES: Floats = np.empty((0, 4))

_LEAST_SHARED = 0.2  # least overlap of lines, one above the other, of the shorter one's length
_SIDE_BY_SIDE = 1.5  # distance, in line heights, within which two lines are side by side
_HEADLINE = 1.3  # least height of a headline, in usual ones of the page
_LARGEST_INSIDE = 0.6  # part of all lines in a box above which it is the frame of the page
_UNDER, _OVER_BESIDE = 0.2, 0.5
"""Least overlap of a line with a box for it to be of the same column, as a part of the shorter of
them, and relative to the greatest overlap."""
_APART, _LINES, _MOSTLY_LEVEL = 2.0, 3, 0.95
"""Least white between slips of paper on one sheet, in usual heights of lines; fewest lines on most;
and most part of lines level with others."""
_FAR = 1.5  # white, in line heights, beyond a title above all columns, or a number below
_LEVEL, _ROWS, _STEP = 0.35, 3, 4.0
"""Difference of baselines of the cells of a row; fewest rows of a table, and their distance."""
_ALIGNED = 0.7  # offset of cells below each other, at one of their sides or their middles
_CELLS, _WIDE_CELLS, _MAYBE, _PROSE = 5.0, 7.0, 1.3, 13.0
"""Largest mean width, in heights, of a table's cells after the first ones, in two columns and in
more; the factor to that of what may be cells; width of level lines that are prose."""


@dataclass(frozen=True, eq=False)
class ReadingOrder:
    """Indices of lines in reading order; for each line its place in the row of a table, from 1, or
    0; and whether some rows may be those of a table or of columns."""

    indices: list[int]
    cell: Indices
    doubtful: bool


def reading_order(
    left: Floats,
    right: Floats,
    y: Floats,
    height: Floats,
    boxes: Floats = NO_BOXES,
    leftward: bool = False,
    blocks: Callable[[], Indices | None] = lambda: None,
) -> ReadingOrder:
    """Return the reading order of lines from their ends, baselines and heights, (N,).

    Lines in ``boxes``, (B, 4) left, top, right, bottom, come after the column in which they stand;
    ``leftward`` scripts are read from the right. Where level lines may be rows, ``blocks`` is
    called for the block of each line, (N,), 0 for none: those of one block are a row, wide ones of
    several are not.
    """
    if leftward:
        left, right = -right, -left
        boxes = boxes[:, [2, 1, 0, 3]] * (-1, 1, -1, 1)
    known = cache(blocks)

    def known_of(slip: Indices) -> Indices | None:
        found = known()
        return None if found is None else found[slip]

    cell, doubtful = np.zeros(len(left), np.int_), False
    indices: list[int] = []
    for slip in _slips(left, right, y, height):
        sides = (left[slip], right[slip], y[slip], height[slip])
        order = _order_of_slip(*sides, boxes, partial(known_of, slip))
        cell[slip] = order.cell
        indices += slip[order.indices].tolist()
        doubtful |= order.doubtful
    return ReadingOrder(indices, cell, doubtful)


def _slips(left: Floats, right: Floats, y: Floats, height: Floats) -> list[Indices]:
    """Return the lines of each slip of paper on a sheet, from the top down and left to right; those
    of a page are one."""
    white, page = _APART * float(np.median(height)), np.arange(len(y))
    bands = [_parted(left, right, band, white) for band in _parted(y - height, y, page, white)]
    slips = [slip for band in bands for slip in band]
    if sum(len(band) > 1 for band in bands) < 2 or len(slips) > len(y) / _LINES:
        return [page]
    of = np.zeros(len(y), np.int_)
    for k, slip in enumerate(slips):
        of[slip] = k
    # Rows of a table are level, lines on slips are so by chance.
    level = (of[:, None] != of) & (np.abs(y[:, None] - y) < _LEVEL / 2 * height)
    return [page] if level.any(axis=1).mean() > _MOSTLY_LEVEL else slips


def _parted(start: Floats, end: Floats, lines: Indices, white: float) -> list[Indices]:
    """Return some of the lines in parts between which there is so much white."""
    lines = lines[np.argsort(start[lines], kind="stable")]
    reached = np.maximum.accumulate(end[lines])
    return np.split(lines, np.flatnonzero(start[lines[1:]] > reached[:-1] + white) + 1)


def _order_of_slip(
    left: Floats,
    right: Floats,
    y: Floats,
    height: Floats,
    boxes: Floats,
    blocks: Callable[[], Indices | None],
) -> ReadingOrder:
    """Return the reading order of the lines of one page or slip of paper."""
    rows, cell, doubtful = _rows(left, right, y, height, blocks)
    left = np.array([left[row].min() for row in rows])
    right = np.array([right[row].max() for row in rows])
    y, height = (np.array([each[row].mean() for row in rows]) for each in (y, height))
    box_of = _boxes_of((left + right) / 2, y - height / 4, boxes)
    found = _in_columns(left, right, y, height, np.flatnonzero(box_of < 0))
    for box in sorted(set(box_of.tolist()) - {-1}, key=lambda box: tuple(boxes[box, [1, 0]])):
        inside = _in_columns(left, right, y, height, np.flatnonzero(box_of == box))
        at = _after_column(left, right, y, found, boxes[box])
        found[at:at] = inside
    return ReadingOrder([int(k) for item in found for k in rows[item]], cell, doubtful)


def _boxes_of(x: Floats, y: Floats, boxes: Floats) -> Indices:
    """Return the index of the smallest box around each line, (N,); -1 for none."""
    box_of = np.full(len(x), -1)
    area = (boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1])
    for k in np.argsort(-area):
        left, top, right, bottom = boxes[k]
        inside = (x > left) & (x < right) & (y > top) & (y < bottom)
        if inside.sum() <= _LARGEST_INSIDE * len(x):
            box_of[inside] = k
    for k, (left, _, right, _) in enumerate(boxes):
        if not ((box_of < 0) & (x > left) & (x < right)).any():
            box_of[box_of == k] = -1  # no column passes it: it is one
    return box_of


def _after_column(left: Floats, right: Floats, y: Floats, found: list[int], box: Floats) -> int:
    """Return the place in an order at which the column ends in which a box stands."""
    if not found:
        return 0
    order = np.array(found)
    shared = np.minimum(right[order], box[2]) - np.maximum(left[order], box[0])
    shorter = np.minimum(right[order] - left[order], box[2] - box[0])
    beside = (shared > _UNDER * shorter) & (shared >= _OVER_BESIDE * shared.max())
    if not beside.any():
        later = np.flatnonzero(y[order] > box[3])
        return int(later[0]) if len(later) else len(found)
    away = np.maximum(np.maximum(y[order] - box[3], box[1] - y[order]), 0)
    at = int(np.where(beside, away, np.inf).argmin())
    for this, following in zip(order[at:-1], order[at + 1 :], strict=True):
        apart = max(left[this], left[following]) >= min(right[this], right[following])
        if apart or y[following] <= y[this]:
            break
        at += 1
    return at + 1


def _in_columns(
    left: Floats, right: Floats, y: Floats, height: Floats, lines: Indices
) -> list[int]:
    """Return some of the lines in order, columns one after another.

    The upper line comes first where one is above the other; the left one where they are in columns
    side by side and no line between them spans both (after Breuel, High performance document layout
    analysis, 2003).
    """
    left, right, y, height = (each[lines] for each in (left, right, y, height))
    large = np.flatnonzero(height > _HEADLINE * np.median(height))
    for upper, lower in pairwise(large[np.argsort(y[large])]):
        if y[lower] - y[upper] < _SIDE_BY_SIDE * height[lower] and left[lower] < right[upper]:
            # All lines of a headline reach as far as those above.
            left[lower] = min(left[lower], left[upper])
            right[lower] = max(right[lower], right[upper])
    shared = np.minimum(right[:, None], right) - np.maximum(left[:, None], left)
    over = shared > _LEAST_SHARED * np.minimum((right - left)[:, None], right - left)
    level = np.abs(y[:, None] - y) < _SIDE_BY_SIDE * np.maximum(height[:, None], height)
    # Each column must have lines beside the other one.
    columns = over.astype(np.float32) @ level.astype(np.float32) > 0
    beside = ~over & (left[:, None] < left) & (columns | columns.T)
    first = over & (y[:, None] < y)
    for line in np.flatnonzero(beside.any(axis=1)):
        between = (np.minimum(y[line], y)[:, None] < y) & (y < np.maximum(y[line], y)[:, None])
        # Rows: the other line; columns: a line that may separate the two.
        first[line] |= beside[line] & ~(between & over[line] & over).any(axis=1)
    for down in (y, -y):
        edge = down < down.min() + height[down.argmin()] / 2
        others = np.append(down[~edge], np.inf).min() - down[edge].max()
        if _FAR * np.median(height) < others < np.inf:
            # A title above all columns is first, the number of the page last.
            first[np.ix_(edge, ~edge)], first[np.ix_(~edge, edge)] = down is y, down is not y
            first[np.ix_(edge, edge)] = left[edge][:, None] < left[edge]
    waiting, order = np.lexsort((left, y)).tolist(), []
    while waiting:
        # Contradictory rules leave none free: the upper one decides.
        order.append(waiting.pop(int(first[np.ix_(waiting, waiting)].any(axis=0).argmin())))
    return [int(lines[k]) for k in order]


def _rows(
    left: Floats, right: Floats, y: Floats, height: Floats, blocks: Callable[[], Indices | None]
) -> tuple[list[Indices], Indices, bool]:
    """Return rows of tables and of blocks, and lines alone; the place of each line in a row of a
    table, from 1; and whether some rows may be cells."""
    levels = _levels(left, y, height, np.arange(len(y)))
    known = cache(lambda: _known_blocks(levels, left, right, y, height, blocks))
    found: list[Indices] = []
    cell, doubtful = np.zeros(len(left), np.int_), False
    groups: list[list[Indices]] = []
    for row in levels:
        if groups and _goes_on(left, right, y, height, groups[-1][-1], row):
            groups[-1].append(row)
        else:
            groups.append([row])
    for group in groups:
        if len(group[0]) == 1:
            found += group
            continue
        cells = np.concatenate([row[1:] for row in group])
        width = float(((right - left)[cells] / height[cells]).mean())
        wide = _CELLS if max(map(len, group)) < 3 else _WIDE_CELLS
        block = np.zeros(len(left), np.int_)
        others_below = (left > left[cells].min() - height[cells].min()).sum() > 2 * len(cells)
        if len(group) < _ROWS or width > _CELLS or others_below:
            block = known()
            wide = _widest(group, block, wide)
        if len(group) >= _ROWS and width <= wide:
            found += group
            for row in group:
                cell[row] = np.arange(1, len(row) + 1)
            continue
        doubtful |= len(group) > _ROWS and width <= _MAYBE * wide
        for row in group:
            overlapping = (left[row[1:]] < right[row[:-1]]).any()
            number = np.where((block[row] == 0) | overlapping, -1 - row, block[row])
            found += [row[number == each] for each in np.unique(number)]
    return found, cell, doubtful


def _widest(group: list[Indices], block: Indices, wide: float) -> float:
    """Return the largest mean width of cells in rows of some blocks, in heights; ``wide`` if most
    blocks are unknown."""
    known = [row for row in group if (block[row] > 0).all()]
    if 2 * len(known) <= len(group):
        return wide
    if 2 * sum(len(set(block[row])) > 1 for row in known) <= len(known):
        return np.inf
    # Blocks of a table have few other lines.
    inside = np.isin(block, block[np.concatenate(known)]).sum()
    return _CELLS if 2 * sum(map(len, known)) > inside else 0.0


def _known_blocks(
    levels: list[Indices],
    left: Floats,
    right: Floats,
    y: Floats,
    height: Floats,
    blocks: Callable[[], Indices | None],
) -> Indices:
    """Return the block of each line, (N,); 0 where it is unknown, and in columns taken for a block:
    lines stand alone below the later parts of its rows."""
    later = [k for row in levels for k in row[1:]]
    block = blocks() if np.median((right - left)[later] / height[later]) < _PROSE else None
    if block is None:
        return np.zeros(len(left), np.int_)
    block = block.copy()
    for number in np.unique(block[block > 0]):
        rows = _levels(left, y, height, np.flatnonzero(block == number))
        later = [k for row in rows for k in row[1:]]
        alone = [row[0] for row in rows if len(row) == 1]
        if later and alone and left[alone].max() > left[later].min() - height[later].max():
            block[block == number] = 0
    return block


def _levels(left: Floats, y: Floats, height: Floats, lines: Indices) -> list[Indices]:
    """Return some of the lines on each level, from the top down, left to right."""
    levels: list[list[int]] = []
    for k in lines[np.argsort(y[lines], kind="stable")].tolist():
        first = levels[-1][0] if levels else k
        if not levels or y[k] - y[first] > _LEVEL * min(height[k], height[first]):
            levels.append([])
        levels[-1].append(k)
    return [np.array(sorted(level, key=lambda k: left[k])) for level in levels]


def _goes_on(
    left: Floats, right: Floats, y: Floats, height: Floats, row: Indices, following: Indices
) -> bool:
    """Return whether the rows of a table may go on: most cells are below others."""
    if min(len(row), len(following)) < 2 or (left[following[1:]] < right[following[:-1]]).any():
        return False
    if y[following[0]] - y[row[0]] > _STEP * height[row[0]]:
        return False
    aligned = np.zeros(len(following), np.bool_)
    for side in (left, right, (left + right) / 2):
        away = np.abs(side[following][:, None] - side[row])
        aligned |= away.min(axis=1) < _ALIGNED * height[following]
    return 2 * int(aligned[1:].sum()) >= len(following) - 1
