"""Reading order of the text segments of a page: columns one after another, tables row by row."""

import itertools
import math
import re
import statistics
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TypeVar

_SAME_LINE, _BESIDE = 0.3, 1.05  # distances of baselines of one line, and of lines side by side
_WIDE, _FIGURES, _ASLANT = 0.65, 0.4, 0.1
"""Gaps that part words, and numbers, and the least that all rows of a picture share."""
_SPACE, _APART = 0.1, 2.5  # gaps that are a space, and that part a line in any case
_FLUSH = 0.4  # difference of the ends of justified prose
_FARTHER = 1.6  # distance of blocks, in usual ones of rows
_EDGE = 0.125  # part of the page's height at its ends that has running heads
_WIDE_CELL, _WIDER, _WIDEST = 5.0, 8.0, 13.0
"""Mean widths of lines above which columns are prose: of a picture, of a PDF, and of loose ones."""
_LOOSE, _LONG = (1.42, 1.6), 20
"""Distances of rows that are loose: of fewer than so many, and of more, as in an index."""
_SURE = 1.15  # ratio of the widths of lines to these above which, or below its inverse, they decide
DOUBTFUL = "the reading order is doubtful: words side by side may be columns, or rows of a table"
FIGURE = re.compile(r"[^\w\s]*\d[\d\W]*\w?[^\w\s]*")
_LABEL = re.compile(r".*:")
_ITEM = re.compile(r"[^\w\s]|\(?\w{1,3}[.)]|\d+(?:\.\d+)+")
"""The mark of a list's item, or the number of a section."""


@dataclass(eq=False)
class Segment:
    """Text of a line without a wide gap, or a line of a picture: its box, y down."""

    text: str
    left: float
    right: float
    y: float  # of its baseline
    size: float  # of its letters
    place: int  # in the file's order; below 0 in fields of a form and in pictures


Row = list[Segment]
_Span = tuple[float, float]
_T = TypeVar("_T")


@dataclass(eq=False)
class Line:
    """Segments of a line, its text, whether it is the row of a table, and whether that is
    doubtful."""

    segments: Row
    text: str
    is_cells: bool = False
    is_doubtful: bool = False


def reading_order(segments: Row, height: float, leftward: bool = False) -> list[Line]:
    """Return the lines of a page of some height; ``leftward`` scripts are read from the right.

    Cells of a table's row are parted by semicolons, and an empty one is a hyphen; further lines of
    cells are rows of their own. Segments of a file's text that are close are joined.
    """
    if leftward:
        _mirror(segments)
    lines = [line for region in _regions(segments, height) for line in _ordered(region)]
    if leftward:
        _mirror(segments)
    return lines


def _mirror(segments: Row) -> None:
    for segment in segments:
        segment.left, segment.right = -segment.right, -segment.left


def split(items: list[_T], begins: Callable[[_T, _T], bool]) -> list[list[_T]]:
    """Return items in pieces, a new one where ``begins`` holds of an item before and its next."""
    pieces = [items[:1]] if items else []
    for before, item in itertools.pairwise(items):
        if begins(before, item):
            pieces.append([])
        pieces[-1].append(item)
    return pieces


def _regions(segments: Row, height: float) -> list[list[Row]]:
    """Return the segments of each baseline, from the top down, left to right, parted where running
    heads end."""
    level = split(
        sorted(segments, key=lambda segment: segment.y),
        lambda above, below: below.y - above.y > _SAME_LINE * min(below.size, above.size),
    )
    rows = [_joined(sorted(row, key=lambda segment: segment.left)) for row in level]

    def begins(above: Row, row: Row) -> bool:
        at_edge = above[0].y < _EDGE * height or row[0].y > (1 - _EDGE) * height
        return at_edge and row[0].y - above[0].y > _APART * row[0].size

    return split(rows, begins)


def are_apart(before: str, after: str, gap: float) -> bool:
    """Return whether a gap, in sizes of the letters, between two texts may part columns."""
    are_figures = FIGURE.fullmatch(before.rpartition(" ")[2]) and FIGURE.fullmatch(
        after.partition(" ")[0]
    )
    return gap > (_FIGURES if are_figures else _WIDE)


def _joined(row: Row) -> Row:
    """Return the segments of a row of a file's text, those that are close in one; also the mark of
    an item and its text."""
    joined = row[:1]
    for segment in row[1:]:
        before = joined[-1]
        gap = (segment.left - before.right) / max(before.size, segment.size)
        is_item = (
            len(joined) == 1 and _ITEM.fullmatch(before.text)
            and not (FIGURE.fullmatch(before.text) and FIGURE.fullmatch(segment.text))
        )  # fmt: skip
        is_apart = are_apart(before.text, segment.text, gap) and not is_item
        if is_apart or min(before.place, segment.place) < 0:
            joined.append(segment)
            continue
        before.text += " " * (gap > _SPACE) + segment.text
        before.right = max(before.right, segment.right)
    return joined


def _join_justified(rows: list[Row]) -> None:
    """Join rows that are as wide as the prose at the row before."""
    for (first, *others), row in itertools.pairwise(rows):
        ends = abs(row[0].left - first.left), abs(row[-1].right - first.right)
        if (
            " " in first.text and not others and max(ends) < _FLUSH * first.size
            and not FIGURE.fullmatch(row[-1].text)
        ):  # fmt: skip
            text = " ".join(part.text for part in row)
            row[:] = [replace(row[0], text=text, right=row[-1].right)]


def _ordered(rows: list[Row]) -> list[Line]:
    """Return the lines of rows, each band of them as columns, as a table, or as it is."""
    _join_justified(rows)
    _join_justified(rows[::-1])
    lines: list[Line] = []
    waiting: list[Row] = []
    for band, gaps in _bands(rows):
        shares = [_share_of_prose(band, gap, gaps) for gap in gaps]
        column = next((gap for gap, share in zip(gaps, shares, strict=True) if share >= 1), None)
        parts = _blocks(band) if column is None else [
            _part(band, -math.inf, column[1]), _part(band, column[1])
        ]  # fmt: skip
        ends = _cell_ends(band) if len(parts) == 1 else []
        if len(parts) == 1 and not ends:
            waiting += band
            continue
        lines += _plain(waiting)
        waiting = []
        table_rows = [_table_row(row, ends) for row in band] if ends else [
            line for part in parts for line in _ordered(part)
        ]  # fmt: skip
        for line in table_rows:
            line.is_doubtful |= any(1 / _SURE < share < _SURE for share in shares)
        lines += table_rows
    return lines + _plain(waiting)


def _plain(rows: list[Row]) -> list[Line]:
    """Return the lines of rows that are not of a table, parted at very wide gaps."""
    return [
        Line(piece, " ".join(segment.text for segment in piece))
        for row in rows
        for piece in split(row, lambda before, after: (
            after.left - before.right > _APART * after.size
        ))
    ]  # fmt: skip


def _blocks(rows: list[Row]) -> list[list[Row]]:
    """Return rows parted where their distance is larger than usual."""
    far = _FARTHER * _usual_step(rows)
    return split(rows, lambda above, row: row[0].y - above[0].y > far)


def _usual_step(rows: list[Row]) -> float:
    steps = [below[0].y - above[0].y for above, below in itertools.pairwise(rows)]
    return statistics.median(steps or [0.0])


def _bands(rows: list[Row]) -> Iterator[tuple[list[Row], list[_Span]]]:
    """Yield successive rows that share gaps, with these; others alone."""
    band: list[Row] = []
    shared: list[_Span] = []
    for row in rows:
        common = _common(shared, row)
        if band and len(common) < 3:
            yield band, shared[1:-1]
            band = []
        shared = common if band else _free(row)
        band.append(row)
    if band:
        yield band, shared[1:-1]


def _common(gaps: list[_Span], row: Row) -> list[_Span]:
    """Return what a row leaves of the gaps above it, and of the space at their sides."""
    both = ((max(gap[0], other[0]), min(gap[1], other[1])) for gap in gaps for other in _free(row))
    # Columns of a photograph are aslant.
    least = (_FIGURES if row[0].place >= 0 else _ASLANT) * row[0].size
    return sorted(gap for gap in both if gap[1] - gap[0] > least)


def _free(row: Row) -> list[_Span]:
    """Return the gaps between segments of a row, and the space before and after it."""
    lefts, rights = [part.left for part in row], [part.right for part in row]
    return [*zip([-math.inf, *rights], [*lefts, math.inf], strict=True)]


def _part(band: list[Row], left: float, right: float = math.inf) -> list[Row]:
    """Return the rows of the segments between two places."""
    inside = ([part for part in row if left <= (part.left + part.right) / 2 < right]
              for row in band)  # fmt: skip
    return [row for row in inside if row]


def _share_of_prose(band: list[Row], gap: _Span, gaps: list[_Span]) -> float:
    """Return at least 1 if a gap parts columns of text, to be read one after the other: the file
    does so, or lines of both are as wide and as close as those of prose. Near 1 is doubtful."""
    ends = [-math.inf, *(right for _, right in gaps), math.inf]
    at = ends.index(gap[1])
    left, right = (_part(band, *ends[k : k + 2]) for k in (at - 1, at))
    if _are(FIGURE, right) or _are(_LABEL, left):
        return 0.0
    beside = [part for row in right for part in row]
    level = sum(
        any(abs(part.y - row[0].y) < _BESIDE * part.size for part in beside) for row in left
    )
    printed = [part for row in band for part in row if part.place >= 0]
    sides = [part.left > gap[0] for part in sorted(printed, key=lambda part: part.place)]
    crossings = sum(before != after for before, after in itertools.pairwise(sides))
    if 0 < 2 * crossings <= level:
        return math.inf
    # Rows of a table are short, or farther apart than lines of a column.
    step = max(_usual_step(left), _usual_step(right)) / band[0][0].size
    least = _WIDEST if step > _LOOSE[level >= _LONG] else _WIDER if printed else _WIDE_CELL
    return min(map(_mean_width, (left, right))) / least if level > 2 else 0.0


def _are(pattern: re.Pattern[str], column: list[Row]) -> bool:
    """Return whether most rows of a column match a pattern."""
    texts = (" ".join(part.text for part in row) for row in column)
    return sum(pattern.fullmatch(text) is not None for text in texts) > 0.6 * len(column)


def _mean_width(column: list[Row]) -> float:
    """Return the mean width of the lines of a column in sizes of their letters."""
    return statistics.fmean((row[-1].right - row[0].left) / row[0].size for row in column)


def _cell_ends(band: list[Row]) -> list[float]:
    """Return the places that part cells, if rows are a table: the fewest that lie in all gaps, and
    each in two or more."""
    gaps = sorted((gap for row in band for gap in _free(row)[1:-1]), key=lambda gap: gap[1])
    shared: list[_Span] = []
    for left, right in gaps:
        if shared and left < shared[-1][1]:
            shared[-1] = max(left, shared[-1][0]), shared[-1][1]
        else:
            shared.append((left, right))
    middles = ((left + right) / 2 for left, right in shared)
    return [end for end in middles if sum(left < end < right for left, right in gaps) > 1]


def _table_row(row: Row, ends: list[float]) -> Line:
    """Return a row of a table; it is a plain line if it has words in its first column alone."""
    texts: dict[int, str] = {}
    for segment in row:
        column = sum(segment.left > end for end in ends)
        texts[column] = f"{texts.get(column, '')} {segment.text}".strip()
    if [*texts] == [0]:
        return Line(row, texts[0])
    return Line(row, "; ".join(texts.get(k) or "-" for k in range(len(ends) + 1)), True)
