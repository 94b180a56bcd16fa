"""Reading order of lines: columns one after another, tables by rows."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int_]

_LEAST_SHARED = 0.2  # least overlap of lines, one above the other, of the shorter one's length
_SIDE_BY_SIDE = 1.5  # distance, in line heights, within which two lines are side by side
_HEADLINE = 1.3  # least height of a headline, in usual ones of the page
_FAR = 1.5  # white, in line heights, beyond a title above all columns, or a number below
_LEVEL, _ROWS, _STEP = 0.35, 3, 4.0
"""Difference of baselines of the cells of a row; fewest rows of a table, and their distance."""
_ALIGNED = 0.7  # offset of cells below each other, at one of their sides or their middles
_CELLS, _MAYBE, _PROSE = 5.0, 7.0, 13.0
"""Largest mean width, in heights, of a table's cells after the first ones, of what may be cells,
and of cells with more white between rows than lines of a column have."""
_LOOSE = 1.5  # least distance of lines, in heights, that are rows rather than lines of columns


@dataclass(frozen=True, eq=False)
class ReadingOrder:
    """Indices of lines in reading order; for each line its place in the row of a table, from 1, or
    0; and whether some rows may be those of a table or of columns."""

    indices: list[int]
    cell: Indices
    doubtful: bool


def reading_order(
    left: Floats, right: Floats, y: Floats, height: Floats, leftward: bool = False
) -> ReadingOrder:
    """Return the reading order of lines from their ends, baselines and heights, (N,);
    ``leftward`` scripts are read from the right."""
    if leftward:
        left, right = -right, -left
    rows, cell, doubtful = _rows(left, right, y, height)
    left = np.array([left[row].min() for row in rows])
    right = np.array([right[row].max() for row in rows])
    y, height = (np.array([each[row].mean() for row in rows]) for each in (y, height))
    order = _in_columns(left, right, y, height)
    return ReadingOrder([int(k) for item in order for k in rows[item]], cell, doubtful)


def _in_columns(left: Floats, right: Floats, y: Floats, height: Floats) -> list[int]:
    """Return the order of lines, columns one after another.

    The upper line comes first where one is above the other; the left one where they are in columns
    side by side and no line between them spans both (after Breuel, High performance document layout
    analysis, 2003).
    """
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
    return order


def _rows(
    left: Floats, right: Floats, y: Floats, height: Floats
) -> tuple[list[Indices], Indices, bool]:
    """Return rows of tables, and lines alone; the place of each line in a row of a table, from 1;
    and whether some rows may be cells.

    Rows have short cells, or more white between them than lines of a column have.
    """
    found: list[Indices] = []
    cell, doubtful = np.zeros(len(left), np.int_), False
    groups: list[list[Indices]] = []
    for row in _levels(left, y, height):
        if groups and _goes_on(left, right, y, height, groups[-1][-1], row):
            groups[-1].append(row)
        else:
            groups.append([row])
    for group in groups:
        alone = [np.array([k]) for row in group for k in row]
        if len(group) < _ROWS:
            found += alone
            continue
        cells = np.concatenate([row[1:] for row in group])
        width = float(((right - left)[cells] / height[cells]).mean())
        firsts = np.array([row[0] for row in group])
        loose = np.median(np.diff(y[firsts]) / height[firsts[1:]]) > _LOOSE
        most = _PROSE if loose else _CELLS
        doubtful |= most < width <= _MAYBE
        if width <= most:
            found += group
            for row in group:
                cell[row] = np.arange(1, len(row) + 1)
        else:
            found += alone
    return found, cell, doubtful


def _levels(left: Floats, y: Floats, height: Floats) -> list[Indices]:
    """Return the lines on each level, from the top down, left to right."""
    levels: list[list[int]] = []
    for k in np.argsort(y, kind="stable").tolist():
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
