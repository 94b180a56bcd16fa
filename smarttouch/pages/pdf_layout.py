"""Words of a PDF as lines in reading order: columns one after another, tables row by row."""

import itertools
import math
import re
import statistics
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeVar

SPACE, MADE_SPACE = " ", "\t"
"""What stands before a word: a space of the file, or one that PDFium makes of a gap."""
_SAME_LINE, _BESIDE = 0.3, 1.05  # distances of baselines of one line, and of lines side by side
_WIDE, _FIGURES, _OPEN, _CERTAIN = 0.65, 0.4, 0.55, 1.2
"""Gaps that may part columns, and numbers; that still do after some rows; and that do in two."""
_APART = 2.5  # gap within a row that parts its lines
_WRAPPED = 1.35  # distance of the lines of one cell; these are in sizes of the letters
_FARTHER, _LARGER = 1.6, 1.15
"""Distance of blocks, in usual ones of rows, and ratio of sizes of a heading and its text."""
_AROUND = 8  # rows around one in which others are beside it, at most
_EDGE = 0.125  # part of the page's height at its ends that has running heads
_EVEN = 0.25  # difference, in sizes, of gaps that are equal
_WORDY = 3.0  # mean words of a line above which a column is prose
_FIGURE = re.compile(r"[^\w\s]*\d[\d\W]*\w?[^\w\s]*")
_INDEX_ENTRY = re.compile(r".*[^\W\d].*\d\W*")
_LABEL = re.compile(r".*:")
_ITEM = re.compile(r"(?:[^\w\s]|\(?\w{1,3}[.)]) |\d+(?:\.\d+)+ \D")
"""The mark of a list's item, or the number of a section, and what follows it."""


@dataclass(eq=False)
class Word:
    """Word of a PDF: its text and place in the file, and its box in points, y down."""

    text: str
    left: float
    right: float
    y: float  # of its baseline
    size: float
    place: int  # in the file's order; below 0 in fields of a form
    before: str  # SPACE, MADE_SPACE or nothing
    turn_deg: int | None = 0  # by which the page must be turned for it; None if it is aslant

    @property
    def middle(self) -> float:
        """The x of its middle."""
        return (self.left + self.right) / 2

    def gap(self, other: "Word") -> float:
        """Return the distance of the nearer ends of two words, below 0 where they overlap."""
        return max(other.left - self.right, self.left - other.right)


Row = list[Word]
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Line:
    """Words of a line on the page, its text, and whether it is part of a table."""

    words: Row
    text: str
    is_cells: bool = False


@dataclass(eq=False)
class _Gap:
    """Space between words that successive rows share, how many have words at both sides, and
    whether another row closes it."""

    left: float
    right: float
    rows: int = 1
    is_closed: bool = False

    @property
    def middle(self) -> float:
        return (self.left + self.right) / 2

    def after(self, row: Row) -> "_Gap":
        """Return what the words of a row leave of it."""
        left, right = self.left, self.right
        for word in row:
            if word.right > left and word.left < right:
                if word.left - left > right - word.right:
                    right = word.left
                else:
                    left = word.right
                least = min(_OPEN * word.size, 0.75 * (self.right - self.left))
                if right - left < max(least, _FIGURES * word.size):
                    ends = (left, right) if left < right else (self.left, self.right)
                    return _Gap(*ends, self.rows, True)
        return _Gap(left, right, self.rows)


def reading_order(words: list[Word], height: float) -> list[Line]:
    """Return the lines of a page of some height."""
    lines: list[Line] = []
    for part in _parts(_rows(words), height):
        lines += _ordered(part)
    return lines


def text_of(words: Row) -> str:
    """Return the text of words in a line, with the file's own spaces where it is in its order."""
    text = words[0].text
    for before, word in itertools.pairwise(words):
        is_next = word.place == before.place + 1
        spaced = word.before if is_next else word.left - before.right > 0.1 * word.size
        text += f" {word.text}" if spaced else word.text
    return text


def _rows(words: list[Word]) -> list[Row]:
    """Return the words of each baseline, from the top down, left to right."""
    rows: list[Row] = []
    for word in sorted(words, key=lambda word: word.y):
        if rows and word.y - rows[-1][0].y < _SAME_LINE * min(word.size, rows[-1][0].size):
            rows[-1].append(word)
        else:
            rows.append([word])
    return [sorted(row, key=lambda word: word.left) for row in rows]


def _words(rows: list[Row]) -> Row:
    return [word for row in rows for word in row]


def _parts(rows: list[Row], height: float) -> Iterator[list[Row]]:
    """Yield the rows of a page, parted at running heads and above headings that follow, in the
    file, all that is above them."""
    part = rows[:1]
    for number, row in enumerate(rows[1:], 1):
        above, below = rows[number - 1], rows[number + 1 : number + 2]
        at_edge = above[0].y < _EDGE * height or row[0].y > (1 - _EDGE) * height
        is_head = at_edge and row[0].y - above[0].y > _APART * row[0].size
        is_heading = bool(below) and row[0].size > _LARGER * below[0][0].size and not _gaps(row)
        if is_head or (is_heading and _begins_anew(rows, number)):
            yield part
            part = []
        part.append(row)
    yield part


def _begins_anew(rows: list[Row], number: int) -> bool:
    """Return whether the file has a row after all above it, and before all below."""
    first = rows[number][0].place
    above = max(word.place for word in _words(rows[:number]))
    below = (word.place for word in _words(rows[number:]) if word.place >= 0)
    return above < first <= min(below, default=-1)


def _ordered(rows: list[Row]) -> list[Line]:
    """Return the lines of rows, each band of them as columns, as a table, or as it is."""
    lines: list[Line] = []
    waiting: list[Row] = []
    for band, gaps in _bands(rows):
        split = _column_gap(band, gaps)
        # One of the columns may begin above the other.
        while split and waiting and not split.after(waiting[-1]).is_closed:
            band.insert(0, waiting.pop())
        parts = [_column(band, [split], k) for k in (0, 1)] if split else _blocks(band)
        cells = [] if len(parts) > 1 else _cell_gaps(band, gaps)
        if len(parts) == 1 and not cells:
            waiting += band
            continue
        lines += [line for row in waiting for line in _plain(row)]
        waiting = []
        if cells:
            lines += _table(band, [gap.middle for gap in cells])
        else:
            lines += [line for part in parts for line in _ordered(part)]
    return lines + [line for row in waiting for line in _plain(row)]


def split(items: list[T], begins: Callable[[T, T], bool]) -> list[list[T]]:
    """Return items in pieces, a new one where ``begins`` holds of an item before and its next."""
    pieces = [items[:1]]
    for before, item in itertools.pairwise(items):
        if begins(before, item):
            pieces.append([])
        pieces[-1].append(item)
    return pieces


def _blocks(rows: list[Row]) -> list[list[Row]]:
    """Return rows parted where their distance is larger than usual."""
    steps = [below[0].y - above[0].y for above, below in itertools.pairwise(rows)]
    far = _FARTHER * statistics.median(steps or [0.0])
    return split(rows, lambda above, row: row[0].y - above[0].y > far)


def _bands(rows: list[Row]) -> Iterator[tuple[list[Row], list[_Gap]]]:
    """Yield successive rows that share a gap, with all of their gaps."""
    band: list[Row] = []
    gaps: list[_Gap] = []
    for number, row in enumerate(rows):
        around = _words(rows[max(0, number - _AROUND) : number + _AROUND])
        near = [word for word in around if abs(word.y - row[0].y) < _BESIDE * word.size]
        own = _gaps(sorted(near, key=lambda word: word.left))
        after = [gap if gap.is_closed else gap.after(row) for gap in gaps]
        if all(gap.is_closed for gap in after):
            if band:
                yield band, gaps
            band, gaps = [row], own
            continue
        for new in own:
            same = [gap for gap in after if gap.left < new.right and new.left < gap.right]
            for gap in same:
                gap.rows += 1
            if not same:
                after.append(new.after(_words(band)))
        band.append(row)
        gaps = after
    if band:
        yield band, gaps


def _gaps(words: Row) -> list[_Gap]:
    """Return the gaps of a row that may part columns: not a space of the file, nor after the mark
    of an item, nor the even ones of justified prose."""
    found = []
    if len(words) > 3 and sum(word.text.isalpha() for word in words) > 2 and _are_even(words):
        first, second = words[:2]
        if second.left - first.right < _CERTAIN * first.size:
            return []
    right = -math.inf
    for number, (before, word) in enumerate(itertools.pairwise(words)):
        right = max(right, before.right)
        is_item = number == 0 and _ITEM.match(f"{before.text} {word.text}")
        if _is_wide(before, word, right) and not is_item:
            found.append(_Gap(right, word.left))
    return found


def _is_wide(before: Word, word: Word, right: float) -> bool:
    width = (word.left - right) / max(before.size, word.size)
    is_space = word.before == SPACE and word.place == before.place + 1 and width < _APART
    are_figures = _FIGURE.fullmatch(before.text) and _FIGURE.fullmatch(word.text)
    is_leader = not before.text.strip(".")
    return width > (_FIGURES if are_figures else _WIDE) and not (is_space or is_leader)


def _column(band: list[Row], gaps: list[_Gap], number: int) -> list[Row]:
    """Return the rows of one column, the first of which is before the first gap."""
    ends = [-math.inf, *(gap.middle for gap in gaps), math.inf]
    inside = (
        [word for word in row if ends[number] <= word.middle < ends[number + 1]] for row in band
    )
    return [row for row in inside if row]


def _are(pattern: re.Pattern[str], column: list[Row]) -> bool:
    """Return whether most rows of a column match a pattern."""
    return sum(pattern.fullmatch(text_of(row)) is not None for row in column) > 0.6 * len(column)


def _is_prose(column: list[Row]) -> bool:
    return sum(len(text_of(row).split()) for row in column) > _WORDY * len(column)


def _column_gap(band: list[Row], gaps: list[_Gap]) -> _Gap | None:
    """Return the gap that parts columns of text, to be read one after the other, if there is one:
    the file does so, or both columns are prose, or entries of an index."""
    gaps = sorted((gap for gap in gaps if not gap.is_closed), key=lambda gap: gap.left)
    printed = [[word for word in row if word.place >= 0] for row in band]
    in_order = sorted(_words(printed), key=lambda word: word.place)
    for number, gap in enumerate(gaps):
        left, right = _column(band, gaps, number), _column(band, gaps, number + 1)
        crossings = sum(
            (before.middle > gap.middle) != (word.middle > gap.middle)
            for before, word in itertools.pairwise(in_order)
        )
        beside = _words(_column(printed, [gap], 1))
        level = sum(
            any(abs(word.y - row[0].y) < _BESIDE * word.size for word in beside)
            for row in _column(printed, [gap], 0)
        )
        is_pair = _are(_FIGURE, right) or _are(_LABEL, left)
        in_turn = 0 < 2 * crossings <= level and not is_pair
        alike = (_is_prose(left) and _is_prose(right)) or (
            _are(_INDEX_ENTRY, left) and _are(_INDEX_ENTRY, right)
        )
        if in_turn or (alike and gap.rows > 2):
            return gap
    return None


def _cell_gaps(band: list[Row], gaps: list[_Gap]) -> list[_Gap]:
    """Return the gaps between cells if the rows are those of a table."""
    size = band[0][0].size
    least = {1: math.inf, 2: _CERTAIN * size}
    found = [gap for gap in gaps if gap.right - gap.left > least.get(gap.rows, 0)]
    found.sort(key=lambda gap: gap.left)
    cells = [_cells(row, [gap.middle for gap in found]) for row in band]
    used = [column for row in cells for column in row]
    found = [gap for k, gap in enumerate(found, 1) if used.count(k) > gap.is_closed]
    prose = sum(_is_prose(_column(band, found, k)) for k in range(len(found) + 1))
    cells = [_cells(row, [gap.middle for gap in found]) for row in band]
    rows = zip(band, map(len, cells), strict=True)
    parted = [(row, count) for row, count in rows if count > 1]
    # In justified prose, words within a cell are as far apart as the cells.
    even = sum(len(row) > count and _are_even(row) for row, count in parted)
    return found if prose < 2 and len(parted) > 1 and 2 * even < len(parted) else []


def _are_even(row: Row) -> bool:
    """Return whether the words of a row are equally far apart."""
    gaps = [word.left - before.right for before, word in itertools.pairwise(row)]
    return max(gaps) - min(gaps) < _EVEN * row[0].size


def _table(band: list[Row], middles: list[float]) -> list[Line]:
    """Return the rows of a table: the text of a row is that of its first line, its cells parted by
    semicolons, an empty one as a hyphen; further lines of its cells have no text of their own."""
    rows: list[list[dict[int, Row]]] = []
    above: Row = []
    for row in band:
        cells = _cells(row, middles)
        is_near = bool(above) and row[0].y - above[0].y < _WRAPPED * row[0].size
        # A further line of a cell is alone; the first column has one line.
        if is_near and [*cells] != [0] and (len(cells) == 1 or len(rows[-1][-1]) == 1) and (
            0 not in cells or not any(0 in other for other in rows[-1])
        ):  # fmt: skip
            rows[-1].append(cells)
        else:
            rows.append([cells])
        above = row
    lines = []
    for row_cells in rows:
        texts: dict[int, str] = {}
        covered: set[int] = set()
        for column, words in (item for cells in row_cells for item in cells.items()):
            texts[column] = f"{texts.get(column, '')} {text_of(words)}".strip()
            left, right = words[0].left, words[-1].right
            covered |= {k for k, middle in enumerate(middles, 1) if left < middle < right}
        columns = [0] if [*texts] == [0] else range(len(middles) + 1)
        text = "; ".join(texts.get(k, "-") for k in columns if k in texts or k not in covered)
        for cells in row_cells:
            lines.append(Line(_words([*cells.values()]), text, True))
            text = ""
    return lines


def _cells(row: Row, middles: list[float]) -> dict[int, Row]:
    """Return the words of each column; words without a gap between them stay in one."""
    column = sum(row[0].left > middle for middle in middles)
    cells = {column: row[:1]}
    for before, word in itertools.pairwise(row):
        if _is_wide(before, word, before.right):
            column = max(column, sum(word.left > middle for middle in middles))
        cells.setdefault(column, []).append(word)
    return cells


def _plain(row: Row) -> list[Line]:
    """Return the lines of a row that is none of a table, parted at very wide gaps."""
    pieces = split(
        row, lambda before, word: word.left - before.right > _APART * max(before.size, word.size)
    )
    return [Line(piece, text_of(piece)) for piece in pieces]
