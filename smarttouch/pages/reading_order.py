"""Reading order of lines: columns one after another, boxes after their column, tables by rows."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from smarttouch.pages.baselines import Floats
from smarttouch.pages.letter_rows import least_linked
from smarttouch.pages.spots import Spots

Flags = NDArray[np.bool_]
Boxes = NDArray[np.float64]
Indices = NDArray[np.int_]
NO_RULES: Floats = np.empty((0, 3))

_LEAST_SHARED = 0.2  # least overlap of lines, one above the other, of the shorter one's length
_PARTED = 0.6  # least overlap of a printed rule with a line that it parts, of the line's length
_HEADLINE, _SAME_SIZE = 1.3, 0.15
"""Least height of a headline, in usual ones of the page, and difference between its lines."""
_LEVEL = 1.5  # distance, in line heights, within which two lines are side by side
_SAME_LEVEL = 0.5  # difference of baselines, in line heights, of parts of one title or foot
NO_BOXES: Boxes = np.empty((0, 4))
_MOST_INSIDE = 0.6  # part of all lines in a box above which it is the frame of the page
_UNDER, _OVER_BESIDE = 0.2, 0.5
"""Least overlap of a line with a box for it to be of the same column, as a part of the shorter of
them, and relative to the greatest overlap."""


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
    boxes: Boxes = NO_BOXES,
    rules: Floats = NO_RULES,
    leftward: bool = False,
    blocks: Callable[[], Indices | None] = lambda: None,
) -> ReadingOrder:
    """Return the reading order of lines from their ends, baselines and heights, (N,).

    Lines in ``boxes``, (B, 4) left, top, right, bottom, come after the column in which they stand;
    ``rules``, (R, 3) left, right, y, part what is above from what is below; ``leftward`` scripts
    are read from the right. Where level lines may be rows, ``blocks`` is called for the block of
    each line, (N,), 0 for none: those of one block are a row, wide ones of several are not.
    """
    if leftward:
        left, right = -right, -left
        boxes = boxes[:, [2, 1, 0, 3]] * (-1, 1, -1, 1)
        rules = rules[:, [1, 0, 2]] * (-1, -1, 1)
    known = cache(lambda: _known_blocks(left, right, y, height, blocks))

    def order_of(slip: Indices) -> ReadingOrder:
        sizes = (left[slip], right[slip], y[slip], height[slip])
        return _order_of_one(*sizes, boxes, rules, lambda: known()[slip])

    slips = _slips(left, right, y, height)
    orders = [order_of(slip) for slip in slips]
    cell = np.zeros(len(left), np.int_)
    for slip, order in zip(slips, orders, strict=True):
        cell[slip] = order.cell
    indices = [
        int(k) for slip, order in zip(slips, orders, strict=True) for k in slip[order.indices]
    ]
    return ReadingOrder(indices, cell, any(order.doubtful for order in orders))


_APART, _FEWEST_SLIPS, _LINES, _MOSTLY_LEVEL = 3.0, 4, 3, 0.85
"""Least white between slips of paper on one sheet, in usual heights of lines; fewest of them, side
by side and below each other, and of their lines; and most part of lines level with others."""


def _slips(left: Floats, right: Floats, y: Floats, height: Floats) -> list[Indices]:
    """Return the lines of each slip of paper on a sheet, from the top down and left to right; those
    of a page are one."""
    whole = [np.arange(len(left))]
    if len(left) < _FEWEST_SLIPS * _LINES:
        return whole
    near = _APART * float(np.median(height))
    across = np.maximum(left[:, None], left) - np.minimum(right[:, None], right)
    down = np.abs(y[:, None] - y) - (height[:, None] + height) / 2
    first, second = np.nonzero((across < near) & (down < near))
    of = least_linked(len(left), first, second)
    slips = [np.flatnonzero(of == k) for k in np.unique(of)]
    many = sum(len(slip) >= _LINES for slip in slips)
    if many < _FEWEST_SLIPS or 2 * many < len(slips):
        return whole
    # Rows of a table are level, lines on slips are so by chance.
    other = (of[:, None] != of) & (np.abs(y[:, None] - y) < _LEVEL_CELLS / 2 * height)
    if other.any(axis=1).mean() > _MOSTLY_LEVEL:
        return whole
    slips.sort(key=lambda slip: float(y[slip].min()))
    rows: list[list[Indices]] = []
    for slip in slips:
        if not rows or y[slip].min() > y[rows[-1][-1]].mean():
            rows.append([])
        rows[-1].append(slip)
    if min(len(rows), max(map(len, rows))) < 2:
        return whole
    return [slip for row in rows for slip in sorted(row, key=lambda slip: float(left[slip].min()))]


def _order_of_one(
    left: Floats,
    right: Floats,
    y: Floats,
    height: Floats,
    boxes: Boxes,
    rules: Floats,
    blocks: Callable[[], Indices],
) -> ReadingOrder:
    """Return the reading order of the lines of one page or slip of paper."""
    tables, others, doubtful = _rows(left, right, y, height, blocks)
    cell = np.zeros(len(left), np.int_)
    for row in tables:
        cell[row] = np.arange(1, len(row) + 1)
    rows = tables + others
    left = np.array([left[row].min() for row in rows])
    right = np.array([right[row].max() for row in rows])
    y, height = (np.array([each[row].mean() for row in rows]) for each in (y, height))
    box_of = _boxes_of((left + right) / 2, y - height / 4, boxes)
    found = _in_columns(left, right, y, height, np.flatnonzero(box_of < 0), rules)
    for box in sorted(set(box_of.tolist()) - {-1}, key=lambda box: tuple(boxes[box, [1, 0]])):
        inside = _in_columns(left, right, y, height, np.flatnonzero(box_of == box), rules)
        at = _after_column(left, right, y, found, boxes[box])
        found[at:at] = inside
    return ReadingOrder([int(k) for item in found for k in rows[item]], cell, doubtful)


def _boxes_of(x: Floats, y: Floats, boxes: Boxes) -> Indices:
    """Return the index of the smallest box around each line, (N,); -1 for none."""
    box_of = np.full(len(x), -1)
    area = (boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1])
    for k in np.argsort(-area):
        left, top, right, bottom = boxes[k]
        inside = (x > left) & (x < right) & (y > top) & (y < bottom)
        if inside.sum() <= _MOST_INSIDE * len(x):
            box_of[inside] = k
    for k, (left, _, right, _) in enumerate(boxes):
        if not ((box_of < 0) & (x > left) & (x < right)).any():
            box_of[box_of == k] = -1  # no column passes it: it is one
    return box_of


def _in_columns(
    left: Floats, right: Floats, y: Floats, height: Floats, lines: Indices, rules: Floats
) -> list[int]:
    """Return some of the lines in order, columns one after another.

    Two rules give the order of two lines (after Breuel, High performance document layout analysis,
    2003): the upper one comes first where one is above the other; the left one where they are in
    columns side by side and no line or printed rule between them spans both.
    """
    if not len(lines):
        return []
    count = len(lines)
    usual = float(np.median(height[lines]))
    height = np.concatenate([height[lines], np.full(len(rules), usual)])
    left, right = (
        np.concatenate([ends[lines], rules[:, k]]) for k, ends in enumerate((left, right))
    )
    y = np.concatenate([y[lines], rules[:, 2]])
    is_line = np.arange(len(y)) < count
    left, right = _of_headlines(left, right, y, height)
    shared = np.minimum(right[:, None], right) - np.maximum(left[:, None], left)
    length = right - left
    over = shared > _LEAST_SHARED * np.minimum(length[:, None], length)
    # A rule parts what it passes to its middle; frames and underlines part nothing.
    over[count:] = shared[count:] > _PARTED * length
    over[:, count:] = over[count:].T
    first = over & (y[:, None] < y)
    first |= _left_column(left, y, height, over, is_line)
    lined = np.flatnonzero(is_line)
    outermost = first[np.ix_(lined, lined)]
    _put_outermost(outermost, left[:count], y[:count], height[:count])
    first[np.ix_(lined, lined)] = outermost
    found = _sorted(first, np.lexsort((left, y)))
    return [int(lines[k]) for k in found if k < count]


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


_BELOW_PICTURE, _CAPTION_STEP, _CAPTION_LINES, _GAP = 3.0, 1.6, 8, 6.0
"""Farthest first line of a caption below its picture, and farthest next one, in heights; most
lines; and least gap above smaller print that is a picture."""


def find_captions(left: Floats, right: Floats, y: Floats, height: Floats, pictures: Spots) -> Boxes:
    """Return the boxes of the captions, (N, 4), right below pictures and apart from other text.

    A gap in a column above smaller print is a picture, too: soft grey ones have no ink.
    """
    found = []
    above = [*zip(pictures.left, pictures.right, pictures.bottom, strict=True)]
    for k in np.flatnonzero(height < (1 - _SAME_SIZE) * np.median(height)):
        over = (y < y[k]) & (np.minimum(right, right[k]) > np.maximum(left, left[k]))
        if over.any() and y[k] - y[over].max() > _GAP * height[k]:
            above.append((left[k], right[k], y[k] - height[k]))
    for start, end, bottom in above:
        wide = np.minimum(right, end) - np.maximum(left, start)
        below = (wide > (right - left) / 2) & (y > bottom)
        order = np.flatnonzero(below)[np.argsort(y[below])]
        if not len(order) or y[order[0]] - bottom > _BELOW_PICTURE * height[order[0]]:
            continue
        first = order[0]
        step = np.diff(y[order]) / height[order[:-1]]
        other = np.abs(height[order[1:]] / height[first] - 1) > _SAME_SIZE
        ends = np.flatnonzero((step > _CAPTION_STEP) | other)
        caption = order[: int(ends[0]) + 1] if len(ends) else order
        if len(caption) <= _CAPTION_LINES:
            high = height[first]
            found.append(
                (left[caption].min() - high, y[first] - high, right[caption].max() + high,
                 y[caption[-1]] + high / 2)
            )  # fmt: skip
    return np.array(found).reshape(-1, 4)


_LEVEL_CELLS, _ROWS = 0.35, 3
"""Difference of baselines, in heights, of cells of a row; and fewest rows of a table."""
_CELLS, _WIDE_CELLS, _MAYBE = 5.0, 7.0, 1.3
"""Most mean width, in heights, of a table's cells after the first ones, in two columns and in more;
and the factor to that of what may be cells."""
_TEXT_STEP, _TEXT_WIDTH, _MOSTLY_WIDE, _GOES_ON = 1.9, 9.0, 0.6, 3
"""Farthest next line of a column of text and its usual width, in heights; least part of such lines;
and fewest of them that have no table beside them."""
_PROSE = 13.0  # median width of level lines, in heights, from which they are columns of prose
_STEP = 3.0  # most distance of its rows, in heights
_IN_LINE = 0.7  # offset of cells below each other, at one of their sides or their middles


def _rows(
    left: Floats, right: Floats, y: Floats, height: Floats, blocks: Callable[[], Indices]
) -> tuple[list[Indices], list[Indices], bool]:
    """Return rows of tables, other rows and lines alone, and whether some rows may be cells."""
    beside = _beside_a_table(left, right, y, height)
    tables: list[Indices] = []
    others = [np.array([k]) for k in np.flatnonzero(beside)]
    rest = np.flatnonzero(~beside)
    rows = [rest[row] for row in _levels(left[rest], right[rest], y[rest], height[rest])]
    doubtful = False
    while rows:
        group = [rows.pop(0)]
        while rows and _goes_on(left, right, y, height, group[-1], rows[0]):
            group.append(rows.pop(0))
        if len(group[0]) == 1:
            others += group
            continue
        cells = np.concatenate([row[1:] for row in group])
        width = float(((right - left)[cells] / height[cells]).mean())
        wide = _CELLS if max(map(len, group)) < 3 else _WIDE_CELLS
        block = np.zeros(len(left), np.int_)
        others_below = (left > left[cells].min() - height[cells].min()).sum() > 2 * len(cells)
        if len(group) < _ROWS or width > _CELLS or others_below:
            block = blocks()
            wide = _widest(group, block, wide)
        if len(group) >= _ROWS and width <= wide:
            tables += group
            continue
        doubtful |= len(group) > _ROWS and width <= _MAYBE * wide
        others += [part for row in group for part in _by_block(row, block, left, right)]
    return tables, others, doubtful


def _widest(group: list[Indices], block: Indices, wide: float) -> float:
    """Return the most mean width of cells in rows of some blocks, in heights; ``wide`` if most
    blocks are unknown."""
    known = [row for row in group if (block[row] > 0).all()]
    if 2 * len(known) <= len(group):
        return wide
    several = [row for row in known if len(set(block[row])) > 1]
    if 2 * len(several) <= len(known):
        return np.inf
    # Blocks of a table have few other lines.
    inside = np.isin(block, block[np.concatenate(known)]).sum()
    return _CELLS if 2 * sum(map(len, known)) > inside else 0.0


def _known_blocks(
    left: Floats, right: Floats, y: Floats, height: Floats, blocks: Callable[[], Indices | None]
) -> Indices:
    """Return the block of each line, (N,); 0 where it is unknown, and in columns taken for a block:
    lines stand alone below the later parts of its rows."""
    none = np.zeros(len(left), np.int_)
    later = [k for row in _levels(left, right, y, height) for k in row[1:]]
    width = (right - left)[later] / height[later]
    found = blocks() if later and np.median(width) < _PROSE else None
    block = none if found is None else found.copy()
    for number in np.unique(block[block > 0]):
        inside = np.flatnonzero(block == number)
        levels = _levels(left[inside], right[inside], y[inside], height[inside])
        rows = [inside[row] for row in levels]
        later = [k for row in rows for k in row[1:]]
        alone = [row[0] for row in rows if len(row) == 1]
        if later and alone and left[alone].max() > left[later].min() - height[later].max():
            block[inside] = 0
    return block


def _by_block(row: Indices, block: Indices, left: Floats, right: Floats) -> list[Indices]:
    """Return parts of a row, each of one block; lines alone that have none or overlap others."""
    if (left[row[1:]] < right[row[:-1]]).any():
        return [np.array([k]) for k in row]
    parts = [np.array([k]) for k in row[block[row] == 0]]
    return parts + [row[block[row] == number] for number in np.unique(block[row]) if number]


def _beside_a_table(left: Floats, right: Floats, y: Floats, height: Floats) -> Flags:
    """Return the lines, (N,), of columns of text beside a table: several lines of them, one right
    below the other and aligned on the left, go on where there are no cells at their side."""
    near = np.maximum(height[:, None], height)
    down = y - y[:, None]
    follows = (down > near / 2) & (down < _TEXT_STEP * near)
    follows &= np.abs(left - left[:, None]) < _IN_LINE * near
    follows &= np.abs(height - height[:, None]) < _SAME_SIZE * near
    narrow = right - left < _WIDE_CELLS * height
    wide = right - left > _TEXT_WIDTH * height
    apart = (left > right[:, None]) | (right < left[:, None])
    cells = (apart & (np.abs(down) < near / 2) & narrow).sum(axis=1) >= 2
    beside = np.zeros(len(y), np.bool_)
    for column in _chains(follows, np.argsort(y, kind="stable")):
        free = column[~cells[column]]
        if len(free) >= _GOES_ON and len(free) < len(column) and wide[column].mean() > _MOSTLY_WIDE:
            beside[column] = True
    return beside


def _chains(follows: Flags, order: Indices) -> list[Indices]:
    """Return chains of lines, from the top down, each next one the first that follows."""
    after = {int(k): int(order[follows[k][order].argmax()]) for k in order if follows[k].any()}
    ends = set(after.values())
    chains = []
    for start in order.tolist():
        if start in ends:
            continue
        chain = [start]
        while chain[-1] in after:
            chain.append(after[chain[-1]])
        chains.append(np.array(chain))
    return chains


def _levels(left: Floats, right: Floats, y: Floats, height: Floats) -> Iterator[Indices]:
    """Yield the lines on each level, from the top down, left to right."""
    level: list[int] = []
    for k in np.argsort(y, kind="stable").tolist():
        if level and y[k] - y[level[0]] > _LEVEL_CELLS * min(height[k], height[level[0]]):
            yield np.array(sorted(level, key=lambda each: left[each]))
            level = []
        level.append(k)
    yield np.array(sorted(level, key=lambda each: left[each]))


def _goes_on(
    left: Floats,
    right: Floats,
    y: Floats,
    height: Floats,
    row: Indices,
    following: Indices,
) -> bool:
    """Return whether the rows of a table may go on: most cells are below others."""
    if min(len(row), len(following)) < 2:
        return False
    if y[following[0]] - y[row[0]] > _STEP * height[row[0]]:
        return False
    if (left[following[1:]] < right[following[:-1]]).any():
        return False
    sides = (left, right, (left + right) / 2)
    aligned = sum(
        any((np.abs(side[row] - side[k]) < _IN_LINE * height[k]).any() for side in sides)
        for k in following[1:]
    )
    return 2 * aligned >= len(following) - 1


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


def _left_column(left: Floats, y: Floats, height: Floats, over: Flags, is_line: Flags) -> Flags:
    """Return for each pair, (N, N), whether one is read first because it is on the left."""
    beside = ~over & (left[:, None] < left)
    level = np.abs(y[:, None] - y) < _LEVEL * np.maximum(height[:, None], height)
    # Each column must have lines beside the other one.
    columns = ((over & is_line).astype(np.uint8) @ level.astype(np.uint8)) > 0
    columns |= columns.T
    columns &= is_line[:, None] & is_line
    first = beside & columns
    for line in np.flatnonzero(first.any(axis=1)):
        between = (np.minimum(y[line], y)[:, None] < y) & (y < np.maximum(y[line], y)[:, None])
        # Rows: the other line; columns: a line that may separate the two.
        first[line] &= ~(between & over[line] & over).any(axis=1)
    return first


def _sorted(first: Flags, usual: Indices) -> list[int]:
    """Return an order that keeps the given precedence, and otherwise the usual one."""
    waiting = list(map(int, usual))
    order = []
    while waiting:
        blocked = first[np.ix_(waiting, waiting)].any(axis=0)
        # Contradictory rules leave none free: the usual order decides.
        order.append(waiting.pop(int(blocked.argmin())))
    return order
