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
_APART = 2.5  # gap within a row that parts its lines, and distance of a running head
_WRAPPED = 1.35  # distance of the lines of one cell; these are in sizes of the letters
_EVEN, _FLUSH = 0.25, 0.4
"""Differences of the gaps of justified prose, and of its ends; also in sizes."""
_FARTHER, _LARGER = 1.6, 1.15
"""Distance of blocks, in usual ones of rows, and ratio of sizes of a heading and its text."""
_EDGE = 0.125  # part of the page's height at its ends that has running heads
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
    grey: float = 0.0  # level of its color
    is_joined: bool = False  # to the word before it, as a part of justified prose

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
    """Space that successive rows share, and how many of them have words at both sides."""

    left: float
    right: float
    rows: int = 1
    is_closed: bool = False  # by words of another row

    @property
    def middle(self) -> float:
        return (self.left + self.right) / 2

    def overlaps(self, other: "_Gap") -> bool:
        return self.left < other.right and other.left < self.right

    def without(self, words: Row) -> "_Gap":
        """Return what words leave of it; itself, closed, if that is too little."""
        left, right = self.left, self.right
        for word in words:
            if not self.is_closed and word.right > left and word.left < right:
                if word.left - left > right - word.right:
                    right = word.left
                else:
                    left = word.right
                least = min(_OPEN * word.size, 0.75 * (self.right - self.left))
                if right - left < max(least, _FIGURES * word.size):
                    ends = (left, right) if left < right else (self.left, self.right)
                    return _Gap(*ends, self.rows, True)
        return _Gap(left, right, self.rows, self.is_closed)


def reading_order(words: list[Word], height: float) -> list[Line]:
    """Return the lines of a page of some height."""
    rows = _rows(words)
    ends = [row[0].y for row in rows]

    def begins(number: int) -> bool:
        """Return whether a row follows a running head, or is a heading that follows, in the file,
        all that is above it."""
        row, above, below = rows[number], rows[:number], rows[number + 1 :]
        y = ends[number]
        at_edge = ends[number - 1] < _EDGE * height or y > (1 - _EDGE) * height
        if at_edge and y - ends[number - 1] > _APART * row[0].size:
            return True
        is_heading = below and row[0].size > _LARGER * below[0][0].size and not _gaps(row)
        return bool(is_heading) and (
            max(word.place for word in _words(above)) < row[0].place
            <= min((word.place for word in _words(below) if word.place >= 0), default=-1)
        )  # fmt: skip

    starts = [0, *filter(begins, range(1, len(rows))), len(rows)]
    return [
        line for start, end in itertools.pairwise(starts) for line in _ordered(rows[start:end])
    ]  # fmt: skip


def split(items: list[T], begins: Callable[[T, T], bool]) -> list[list[T]]:
    """Return items in pieces, a new one where ``begins`` holds of an item before and its next."""
    pieces = [items[:1]]
    for before, item in itertools.pairwise(items):
        if begins(before, item):
            pieces.append([])
        pieces[-1].append(item)
    return pieces


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


def _ordered(rows: list[Row]) -> list[Line]:
    """Return the lines of rows, each band of them as columns, as a table, or as it is."""
    _join_justified(rows)
    _join_justified(rows[::-1])
    lines: list[Line] = []
    waiting: list[Row] = []
    for band, gaps in _bands(rows):
        column = _column_gap(band, gaps)
        # One of the columns may begin above the other.
        while column and waiting and not column.without(waiting[-1]).is_closed:
            band.insert(0, waiting.pop())
        parts = _blocks(band) if column is None else [
            _part(band, -math.inf, column.middle), _part(band, column.middle, math.inf)
        ]  # fmt: skip
        cells = _cell_gaps(band, gaps) if len(parts) == 1 else []
        if len(parts) == 1 and not cells:
            waiting += band
            continue
        lines += [line for row in waiting for line in _plain(row)]
        waiting = []
        if cells:
            lines += _table(band, cells)
        else:
            lines += [line for part in parts for line in _ordered(part)]
    return lines + [line for row in waiting for line in _plain(row)]


def _join_justified(rows: list[Row]) -> None:
    """Join the words of rows that are evenly apart and as wide as the prose at the row before."""
    for other, row in itertools.pairwise(rows):
        flush = _FLUSH * row[0].size
        if (
            len(row) > 1 and _are_even(row) and not _FIGURE.fullmatch(row[-1].text)
            and (other[-1].is_joined or (len(other) > 2 and not _gaps(other)))
            and abs(row[0].left - other[0].left) < flush
            and abs(row[-1].right - other[-1].right) < flush
        ):  # fmt: skip
            for word in row[1:]:
                word.is_joined = True


def _plain(row: Row) -> list[Line]:
    """Return the lines of a row that is not of a table, parted at very wide gaps."""
    pieces = split(row, lambda before, word: (
        word.left - before.right > _APART * word.size and not word.is_joined
    ))  # fmt: skip
    return [Line(piece, text_of(piece)) for piece in pieces]


def _blocks(rows: list[Row]) -> list[list[Row]]:
    """Return rows parted where their distance is larger than usual."""
    steps = [below[0].y - above[0].y for above, below in itertools.pairwise(rows)]
    far = _FARTHER * statistics.median(steps or [0.0])
    return split(rows, lambda above, row: row[0].y - above[0].y > far)


def _bands(rows: list[Row]) -> Iterator[tuple[list[Row], list[_Gap]]]:
    """Yield successive rows that share a gap, with all of their gaps; others alone."""
    band: list[Row] = []
    gaps: list[_Gap] = []
    for number, row in enumerate(rows):
        around = _words(rows[max(0, number - 8) : number + 8])
        beside = [word for word in around if abs(word.y - row[0].y) < _BESIDE * word.size]
        own = _gaps(sorted(beside, key=lambda word: word.left))
        after = [gap.without(row) for gap in gaps]
        if all(gap.is_closed for gap in after):
            if band:
                yield band, gaps
            band, after = [], []
        gaps = after
        new = [gap for gap in own if not any(gap.overlaps(other) for other in gaps)]
        for gap in gaps:
            gap.rows += any(gap.overlaps(other) for other in own)
        gaps += [gap.without(_words(band)) for gap in new]
        band.append(row)
    if band:
        yield band, gaps


def _gaps(words: Row) -> list[_Gap]:
    """Return the gaps of a row that may part columns, if it is not justified prose."""
    pairs = list(itertools.pairwise(words))
    letters = sum(word.text.isalpha() for word in words)
    is_even = letters > 2 and len(words) > 3 and _are_even(words)
    if is_even and words[1].left - words[0].right < _CERTAIN * words[0].size:
        return []
    gaps = []
    right = -math.inf
    for number, (before, word) in enumerate(pairs):
        right = max(right, before.right)
        is_item = number == 0 and _ITEM.match(f"{before.text} {word.text}")
        if _is_wide(before, word, right) and not is_item:
            gaps.append(_Gap(right, word.left))
    return gaps


def _is_wide(before: Word, word: Word, right: float) -> bool:
    """Return whether two words may be in different columns: not at a space of the file, nor after
    the leaders of a list of contents."""
    width = (word.left - right) / max(before.size, word.size)
    is_space = word.before == SPACE and word.place == before.place + 1 and width < _APART
    are_figures = _FIGURE.fullmatch(before.text) and _FIGURE.fullmatch(word.text)
    is_leader = not before.text.strip(".")
    is_wide = width > (_FIGURES if are_figures else _WIDE)
    return is_wide and not (is_space or is_leader or word.is_joined)


def _part(band: list[Row], left: float, right: float) -> list[Row]:
    """Return the rows of the words between two places."""
    inside = (
        [word for word in row if left <= (word.left + word.right) / 2 < right] for row in band
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
    ends = [-math.inf, *(gap.middle for gap in gaps), math.inf]
    for number, gap in enumerate(gaps):
        left, right = (_part(band, *ends[k : k + 2]) for k in (number, number + 1))
        sides = [word.left > gap.middle for word in in_order]
        crossings = sum(before != after for before, after in itertools.pairwise(sides))
        beside = _words(_part(printed, gap.middle, math.inf))
        level = sum(
            any(abs(word.y - row[0].y) < _BESIDE * word.size for word in beside)
            for row in _part(printed, -math.inf, gap.middle)
        )
        is_pair = _are(_FIGURE, right) or _are(_LABEL, left)
        in_turn = 0 < 2 * crossings <= level and not is_pair
        alike = (_is_prose(left) and _is_prose(right)) or (
            _are(_INDEX_ENTRY, left) and _are(_INDEX_ENTRY, right)
        )
        if in_turn or (alike and gap.rows > 2):
            return gap
    return None


def _cell_gaps(band: list[Row], gaps: list[_Gap]) -> list[float]:
    """Return the places that part the cells of rows, if these are a table."""
    least = {1: math.inf, 2: _CERTAIN * band[0][0].size}
    gaps = [gap for gap in gaps if gap.right - gap.left > least.get(gap.rows, 0)]
    gaps.sort(key=lambda gap: gap.left)
    used = [k for row in band for k in _cells(row, [gap.middle for gap in gaps])]
    middles = [gap.middle for k, gap in enumerate(gaps, 1) if used.count(k) > gap.is_closed]
    ends = [-math.inf, *middles, math.inf]
    prose = sum(_is_prose(_part(band, *pair)) for pair in itertools.pairwise(ends))
    # In justified prose, words within a cell are as far apart as the cells.
    cells = [(row, len(_cells(row, middles))) for row in band]
    parted = [row for row, count in cells if count > 1]
    even = sum(len(row) > count > 1 and _are_even(row) for row, count in cells)
    return middles if prose < 2 and len(parted) > 1 and 2 * even < len(parted) else []


def _are_even(row: Row) -> bool:
    """Return whether the words of a row are equally far apart."""
    widths = [word.left - before.right for before, word in itertools.pairwise(row)]
    return max(widths) - min(widths) < _EVEN * row[0].size


def _table(band: list[Row], middles: list[float]) -> list[Line]:
    """Return the rows of a table: cells are parted by semicolons, an empty one is a hyphen; further
    lines of cells add to the text of their row, and have none of their own."""
    table: list[tuple[dict[int, str], list[Row]]] = []
    for row in band:
        texts = {column: text_of(words) for column, words in _cells(row, middles).items()}
        above = table[-1][1][-1] if table else []
        is_near = bool(above) and row[0].y - above[0].y < _WRAPPED * row[0].size
        if is_near and 0 not in texts and not any(map(_FIGURE.fullmatch, texts.values())):
            for column, text in texts.items():
                table[-1][0][column] = f"{table[-1][0].get(column, '')} {text}".strip()
            table[-1][1].append(row)
        else:
            table.append((texts, [row]))
    lines = []
    for texts, rows in table:
        cells = [words for row in rows for words in _cells(row, middles).values()]
        covered = {
            k for k, middle in enumerate(middles, 1)
            if any(words[0].left < middle < words[-1].right for words in cells)
        }  # fmt: skip
        columns = [0] if [*texts] == [0] else range(len(middles) + 1)
        text = "; ".join(texts.get(k, "-") for k in columns if k in texts or k not in covered)
        lines += [Line(row, "" if number else text, True) for number, row in enumerate(rows)]
    return lines


def _cells(row: Row, middles: list[float]) -> dict[int, Row]:
    """Return the words of each column; words without a gap between them stay in one."""
    cells: dict[int, Row] = {}
    column = 0
    for before, word in itertools.pairwise([row[0], *row]):
        if word is before or _is_wide(before, word, before.right):
            column = max(column, sum(word.left > middle for middle in middles))
        cells.setdefault(column, []).append(word)
    return cells
