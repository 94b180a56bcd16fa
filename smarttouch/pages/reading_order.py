"""Reading order of text segments: columns one after another, tables row by row."""

import itertools
import math
import re
import statistics
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TypeVar

_SAME_LINE = 0.3  # largest distance between baselines in one line, in letter sizes
_SPACE = 0.1  # smallest gap that becomes a space, in letter sizes
_WIDE, _FIGURES, _ASLANT = 0.65, 0.4, 0.1
"""Smallest gaps between columns of words, columns of numbers, and columns in pictures, in letter
sizes."""
_APART = 2.5  # smallest vertical or horizontal gap between separate lines, in letter sizes
_FLUSH = 0.4  # largest difference between the ends of justified lines, in letter sizes
_FARTHER = 1.6  # smallest distance between blocks of rows, relative to the typical row distance
_EDGE = 0.125  # height of the top and the bottom zone with running heads, relative to the page
_WIDE_CELL = 5.0  # in images, lines with a smaller mean width, in letter sizes, are table cells
_WIDER = 8.0  # in PDF files, lines with a smaller mean width, in letter sizes, are table cells
_WIDEST = 13.0  # smallest mean line width of prose with rows far apart (`_LOOSE`), in letter sizes
_LOOSE = 1.5  # smallest distance of rows that are far apart, in letter sizes
_FEWEST = 3  # with fewer rows, the widths of lines do not tell prose from tables
_SURE = 1.15  # the order is doubtful if line width and prose limit differ by less than this factor
DOUBTFUL = "the reading order is doubtful: words side by side may be columns, or rows of a table"
# mark of a list item, or number of a section
_ITEM = re.compile(r"[^\w\s]|\(?\w{1,3}[.)]|\d+(?:\.\d+)+")


@dataclass(eq=False)
class Segment:
    """Text without a wide gap: a character, a part of a line, or a line of a picture."""

    text: str
    left: float
    right: float
    y: float  # baseline; y points down
    size: float  # letter size
    place: int  # index of the segment in the file; negative in form fields and pictures
    space: str = ""  # white space before the segment in the file
    turn_deg: int | None = 0  # rotation that makes the text horizontal; None if slanted

    def gap(self, other: "Segment") -> float:
        """Return the gap between two segments, relative to the larger of their letter sizes."""
        distance = max(other.left - self.right, self.left - other.right)
        return distance / max(self.size, other.size)

    def is_apart(self, other: "Segment") -> bool:
        """Return whether the gap between two segments may separate columns."""
        are_figures = self.text[-1:].isdigit() and other.text[:1].isdigit()
        return self.gap(other) > (_FIGURES if are_figures else _WIDE)

    def add(self, text: str, other: "Segment") -> None:
        """Append ``text``, and widen this segment until it covers the segment ``other``."""
        self.text += text
        self.left, self.right = min(self.left, other.left), max(self.right, other.right)


Row = list[Segment]
_Span = tuple[float, float]
_T = TypeVar("_T")


@dataclass(eq=False)
class Line:
    """Line of text, or table row (``is_cells``). If ``is_doubtful``, its place may be wrong."""

    segments: Row
    text: str
    is_cells: bool = False
    is_doubtful: bool = False


def reading_order(segments: Row, height: float, leftward: bool = False) -> list[Line]:
    """Return the lines of a page in reading order, from right to left for ``leftward`` scripts.

    Cells of a table row are separated by semicolons; an empty cell is a hyphen. If a cell has
    several lines, each line is a separate row. In text from a file, close segments are joined.
    """
    if leftward:
        _mirror(segments)
    level = split(
        sorted(segments, key=lambda segment: segment.y),
        lambda above, below: below.y - above.y > _SAME_LINE * min(below.size, above.size),
    )
    rows = [_joined(sorted(row, key=lambda segment: segment.left)) for row in level]

    def ends_heads(above: Row, row: Row) -> bool:
        at_edge = above[0].y < _EDGE * height or row[0].y > (1 - _EDGE) * height
        return at_edge and row[0].y - above[0].y > _APART * row[0].size

    lines = [line for region in split(rows, ends_heads) for line in _ordered(region)]
    if leftward:
        _mirror([segment for line in lines for segment in line.segments])
    return lines


def _mirror(segments: Row) -> None:
    for segment in segments:
        segment.left, segment.right = -segment.right, -segment.left


def split(items: list[_T], begins: Callable[[_T, _T], bool]) -> list[list[_T]]:
    """Split items into lists; a new list starts where ``begins(previous, item)`` is true."""
    pieces = [items[:1]] if items else []
    for before, item in itertools.pairwise(items):
        if begins(before, item):
            pieces.append([])
        pieces[-1].append(item)
    return pieces


def _joined(row: Row) -> Row:
    """Join close segments of a row, and the mark of a list item with the item's text."""
    joined = row[:1]
    for segment in row[1:]:
        before, gap = joined[-1], joined[-1].gap(segment)
        is_item = len(joined) == 1 and _ITEM.fullmatch(before.text)
        if min(before.place, segment.place) < 0 or (before.is_apart(segment) and not is_item):
            joined.append(segment)
        else:
            before.add(" " * (gap > _SPACE) + segment.text, segment)
    return joined


def _join_justified(rows: list[Row]) -> None:
    """Join the segments of a row if the row before is prose with the same left and right ends."""
    for (first, *others), row in itertools.pairwise(rows):
        ends = abs(row[0].left - first.left), abs(row[-1].right - first.right)
        if " " in first.text and not others and max(ends) < _FLUSH * first.size:
            row[:] = [replace(row[0], text=_text(row), right=row[-1].right)]


def _ordered(rows: list[Row]) -> list[Line]:
    """Return rows as lines; each band of rows is read as columns, as a table, or row by row."""
    _join_justified(rows)
    _join_justified(rows[::-1])
    lines: list[Line] = []
    bands = list(_bands(rows))
    while bands:
        band, gaps = bands.pop(0)
        ends = [-math.inf, *(right for _, right in gaps), math.inf]
        columns = [_part(band, *pair) for pair in itertools.pairwise(ends)]
        shares = [
            _share_of_prose(band, left, right, end)
            for left, right, end in zip(columns, columns[1:], ends[1:], strict=False)
        ]
        share, gap = max(zip(shares, gaps, strict=True), default=(0.0, (0.0, 0.0)))
        insets: list[Row] = []
        while share >= 1 and bands and (across := _insets(bands[0][0], gap)) is not None:
            insets += across
            band += [[part for part in row if [part] not in across] for row in bands.pop(0)[0]]
        parts = [_part(band, -math.inf, gap[1]), _part(band, gap[1]), insets]
        parts = list(filter(None, parts)) if share >= 1 else _blocks(band)
        ordered = _lines(band) if len(parts) == 1 else [
            line for part in parts for line in _ordered(part)
        ]  # fmt: skip
        for line in ordered:
            line.is_doubtful |= any(1 / _SURE < share < _SURE for share in shares)
        lines += ordered
    return lines


def _insets(rows: list[Row], gap: _Span) -> list[Row] | None:
    """Return the segments, such as captions, that cross a gap between columns. Return None if few
    rows have text on both sides of the gap."""
    across = [[part] for row in rows for part in row if part.left < gap[1] and part.right > gap[0]]
    beside = [[part for part in row if [part] not in across] for row in rows]
    sides = _part(beside, -math.inf, gap[1]), _part(beside, gap[1])
    return across if len(across) <= 2 * min(map(len, sides)) else None


def _blocks(rows: list[Row]) -> list[list[Row]]:
    """Group rows into blocks. A block begins where the distance of two rows is unusually large."""
    far = _FARTHER * _usual_step(rows)
    return split(rows, lambda above, row: row[0].y - above[0].y > far)


def _usual_step(rows: list[Row]) -> float:
    steps = [below[0].y - above[0].y for above, below in itertools.pairwise(rows)]
    return statistics.median(steps or [0.0])


def _bands(rows: list[Row]) -> Iterator[tuple[list[Row], list[_Span]]]:
    """Yield bands of successive rows, and the gaps that all rows of a band have in common."""
    band: list[Row] = []
    shared: list[_Span] = []
    for row in rows:
        least = (_FIGURES if row[0].place >= 0 else _ASLANT) * row[0].size
        both = ((max(a, c), min(b, d)) for a, b in shared for c, d in _free(row))
        common = sorted(gap for gap in both if gap[1] - gap[0] > least)
        if band and len(common) < 3:
            yield band, shared[1:-1]
            band = []
        shared = common if band else _free(row)
        band.append(row)
    if band:
        yield band, shared[1:-1]


def _free(row: Row) -> list[_Span]:
    """Return the gaps between segments of a row, and the space before and after the row."""
    lefts, rights = [part.left for part in row], [part.right for part in row]
    return [*zip([-math.inf, *rights], [*lefts, math.inf], strict=True)]


def _part(band: list[Row], left: float, right: float = math.inf) -> list[Row]:
    """Return the rows with only those segments whose middle is between ``left`` and ``right``."""
    rows = ([part for part in row if left <= (part.left + part.right) / 2 < right] for row in band)
    return [row for row in rows if row]


def _share_of_prose(band: list[Row], left: list[Row], right: list[Row], end: float) -> float:
    """Return the mean width of the lines in the narrower column, relative to the smallest width
    of prose. Columns of prose have at least 1. Return 0 for a table or few rows. Return infinity
    if the file stores one column after the other."""
    ends = [_text(row)[:1] + _text(row)[-1:] for row in right]
    if all(map(str.isdigit, ends)) or all(_text(row).endswith(":") for row in left):
        return 0.0  # a table: the right column has only numbers, or the left only labels
    level = min(len(left), len(right))
    printed = [part for row in band for part in row if part.place >= 0]
    sides = [part.left >= end for part in sorted(printed, key=lambda part: part.place)]
    crossings = sum(before != after for before, after in itertools.pairwise(sides))
    if 0 < 2 * crossings <= level:
        return math.inf
    if level < _FEWEST:
        return 0.0
    # Lines of a table are shorter, or farther apart, than lines of prose.
    size = statistics.median(row[0].size for row in band)
    step = max(map(_usual_step, (left, right))) / size
    least = _WIDEST if step > _LOOSE else _WIDER if printed else _WIDE_CELL
    return min(
        statistics.fmean((row[-1].right - row[0].left) / row[0].size for row in column) / least
        for column in (left, right)
    )


def _lines(band: list[Row]) -> list[Line]:
    """Convert rows to lines.

    A cell ends where gaps of two or more rows overlap. A row with text after its first cell is a
    table row. Other rows are plain lines.
    """
    gaps = sorted((gap for row in band for gap in _free(row)[1:-1]), key=lambda gap: gap[1])
    shared: list[_Span] = []
    for left, right in gaps:
        if shared and left < shared[-1][1]:
            shared[-1] = max(left, shared[-1][0]), shared[-1][1]
        else:
            shared.append((left, right))
    middles = ((left + right) / 2 for left, right in shared)
    ends = [end for end in middles if sum(left < end < right for left, right in gaps) > 1]
    lines = []
    for row in band:
        cells: list[Row] = [[] for _ in range(len(ends) + 1)]
        for segment in row:
            cells[sum(segment.left > end for end in ends)].append(segment)
        if any(cells[1:]):
            lines.append(Line(row, "; ".join(_text(cell) or "-" for cell in cells), True))
        else:
            pieces = split(row, lambda before, after: before.gap(after) > _APART)
            lines += [Line(piece, _text(piece)) for piece in pieces]
    return lines


def _text(row: Row) -> str:
    return " ".join(segment.text for segment in row)
