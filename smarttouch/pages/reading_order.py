"""Reading order of the words of a PDF, or the lines of a picture: columns one after another, tables
row by row."""

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
_WIDE, _FIGURES, _CERTAIN, _APART, _ASLANT = 0.65, 0.4, 1.2, 2.5, 0.1
"""Gaps that may part columns, and numbers; that are no spaces of justified prose, nor of any; and
the least that all rows of a picture share."""
_EVEN, _FLUSH = 0.25, 0.4  # differences of the gaps of justified prose, and of its ends
_FARTHER, _LARGER = 1.6, 1.15
"""Distance of blocks, in usual ones of rows, and ratio of sizes of a heading and its text."""
_EDGE = 0.125  # part of the page's height at its ends that has running heads
_WIDE_CELL, _WIDER, _WIDEST = 5.0, 8.0, 13.0
"""Mean widths of lines above which columns are prose: of a picture, of a PDF, and of loose ones."""
_LOOSE, _LONG = (1.42, 1.6), 20
"""Distances of rows that are loose: of fewer than so many, and of more, as in an index."""
_FIGURE = re.compile(r"[^\w\s]*\d[\d\W]*\w?[^\w\s]*")
_LABEL = re.compile(r".*:")
_ITEM = re.compile(r"[^\w\s]|\(?\w{1,3}[.)]|\d+(?:\.\d+)+")
"""The mark of a list's item, or the number of a section."""


@dataclass(eq=False)
class Word:
    """Word of a PDF, with its text and place in the file, or line of a picture: its box, y down."""

    text: str
    left: float
    right: float
    y: float  # of its baseline
    size: float  # of its font
    place: int  # in the file's order; below 0 in fields of a form and in pictures
    before: str = MADE_SPACE  # SPACE, MADE_SPACE or nothing
    turn_deg: int | None = 0  # by which the page must be turned for it; None if it is aslant
    grey: float = 0.0  # level of its color
    is_joined: bool = False  # to the word before it, as a part of justified prose

    def gap(self, other: "Word") -> float:
        """Return the distance of the nearer ends of two words, below 0 where they overlap."""
        return max(other.left - self.right, self.left - other.right)


Row = list[Word]
_Span = tuple[float, float]
_T = TypeVar("_T")


@dataclass(frozen=True, eq=False)
class Line:
    """Words of a line, its text, and whether it is the row of a table."""

    words: Row
    text: str
    is_cells: bool = False


def reading_order(words: Row, height: float, leftward: bool = False) -> list[Line]:
    """Return the lines of a page of some height; ``leftward`` scripts are read from the right.

    Cells of a table's row are parted by semicolons, and an empty one is a hyphen; further lines of
    cells are rows of their own.
    """
    if leftward:
        _mirror(words)
    lines = [line for region in _regions(words, height) for line in _ordered(region)]
    if leftward:
        _mirror(words)
    return lines


def _mirror(words: Row) -> None:
    for word in words:
        word.left, word.right = -word.right, -word.left


def _regions(words: Row, height: float) -> list[list[Row]]:
    """Return the words of each baseline, from the top down, left to right, parted where running
    heads end and headings begin."""
    level = split(
        sorted(words, key=lambda word: word.y),
        lambda above, word: word.y - above.y > _SAME_LINE * min(word.size, above.size),
    )
    rows = [sorted(row, key=lambda word: word.left) for row in level if row]

    def begins(k: int) -> bool:
        """Return whether a row follows a running head, or is a heading that follows, in the file,
        all that is above it."""
        row, above, below = rows[k], rows[:k], rows[k + 1 :]
        at_edge = above[-1][0].y < _EDGE * height or row[0].y > (1 - _EDGE) * height
        if at_edge and row[0].y - above[-1][0].y > _APART * row[0].size:
            return True
        is_heading = below and row[0].size > _LARGER * below[0][0].size and len(_pieces(row)) == 1
        return bool(is_heading and row[0].place >= 0) and (
            max(word.place for other in above for word in other) < row[0].place
            <= min((word.place for other in below for word in other if word.place >= 0), default=-1)
        )  # fmt: skip

    starts = [0, *filter(begins, range(1, len(rows))), len(rows)]
    return [rows[start:end] for start, end in itertools.pairwise(starts)]


def split(items: list[_T], begins: Callable[[_T, _T], bool]) -> list[list[_T]]:
    """Return items in pieces, a new one where ``begins`` holds of an item before and its next."""
    pieces = [items[:1]] if items else []
    for before, item in itertools.pairwise(items):
        if begins(before, item):
            pieces.append([])
        pieces[-1].append(item)
    return pieces


def _text_of(words: Row) -> str:
    """Return the text of words in a line, with the file's own spaces where it is in its order."""
    text = words[0].text
    for before, word in itertools.pairwise(words):
        is_next = word.place == before.place + 1
        spaced = word.before if is_next else word.left - before.right > 0.1 * word.size
        text += f" {word.text}" if spaced else word.text
    return text


def _ordered(rows: list[Row]) -> list[Line]:
    """Return the lines of rows, each band of them as columns, as a table, or as it is."""
    _join_justified(rows)
    _join_justified(rows[::-1])
    lines: list[Line] = []
    waiting: list[Row] = []
    for band, gaps in _bands(rows):
        column = next((gap for gap in gaps if _parts_columns(band, gap, gaps)), None)
        parts = _blocks(band) if column is None else [
            _part(band, -math.inf, column[1]), _part(band, column[1])
        ]  # fmt: skip
        ends = _cell_ends(band) if len(parts) == 1 else []
        if len(parts) == 1 and not ends:
            waiting += band
            continue
        lines += _plain(waiting)
        waiting = []
        if ends:
            lines += [_table_row(row, ends) for row in band]
        else:
            lines += [line for part in parts for line in _ordered(part)]
    return lines + _plain(waiting)


def _join_justified(rows: list[Row]) -> None:
    """Join the words of rows that are evenly apart and as wide as the prose at the row before."""
    for other, row in itertools.pairwise(rows):
        flush = _FLUSH * row[0].size
        if (
            len(row) > 1 and _are_even(row) and not _FIGURE.fullmatch(row[-1].text)
            and (other[-1].is_joined or len(other) > 2) and len(_pieces(other)) == 1
            and abs(row[0].left - other[0].left) < flush
            and abs(row[-1].right - other[-1].right) < flush
        ):  # fmt: skip
            for word in row[1:]:
                word.is_joined = True


def _are_even(row: Row) -> bool:
    """Return whether the words of a row are equally far apart."""
    widths = [word.left - before.right for before, word in itertools.pairwise(row)]
    return max(widths) - min(widths) < _EVEN * row[0].size


def _plain(rows: list[Row]) -> list[Line]:
    """Return the lines of rows that are not of a table, parted at very wide gaps."""
    pieces = (
        piece for row in rows for piece in split(row, lambda before, word: (
            word.left - before.right > _APART * word.size and not word.is_joined
        ))
    )  # fmt: skip
    return [Line(piece, _text_of(piece)) for piece in pieces]


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
        shared = common if band else _free(_pieces(row))
        band.append(row)
    if band:
        yield band, shared[1:-1]


def _common(gaps: list[_Span], row: Row) -> list[_Span]:
    """Return what a row leaves of the gaps above it, and of the space at their sides."""
    parted, words = _free(_pieces(row)), _free(split(row, _are_apart))
    both = (
        (max(gap[0], other[0]), min(gap[1], other[1]))
        for gap in gaps for other in (words if math.isfinite(gap[1] - gap[0]) else parted)
    )  # fmt: skip
    # Columns of a photograph are aslant.
    least = (_FIGURES if row[0].place >= 0 else _ASLANT) * row[0].size
    return sorted(gap for gap in both if gap[1] - gap[0] > least)


def _free(pieces: list[Row]) -> list[_Span]:
    """Return the gaps between pieces of a row, and the space before and after it."""
    lefts = [piece[0].left for piece in pieces]
    rights = [max(word.right for word in piece) for piece in pieces]
    return [*zip([-math.inf, *rights], [*lefts, math.inf], strict=True)]


def _are_apart(before: Word, word: Word) -> bool:
    """Return whether the file has no space between two words, or leaves far more than one."""
    is_space = word.before == SPACE and word.place == before.place + 1
    return not is_space or word.left - before.right > _APART * word.size


def _pieces(row: Row) -> list[Row]:
    """Return the words of a row parted at gaps that may be between columns: not in justified prose,
    nor after the mark of an item."""
    letters = sum(word.text.isalpha() for word in row)
    if letters > 2 and _are_even(row) and row[1].left - row[0].right < _CERTAIN * row[0].size:
        return [row]

    def begins(before: Word, word: Word) -> bool:
        are_figures = _FIGURE.fullmatch(before.text) and _FIGURE.fullmatch(word.text)
        is_item = before is row[0] and _ITEM.fullmatch(before.text) and not are_figures
        width = (word.left - before.right) / max(before.size, word.size)
        is_wide = width > (_FIGURES if are_figures else _WIDE) and _are_apart(before, word)
        return is_wide and not (is_item or word.is_joined)

    return split(row, begins)


def _part(band: list[Row], left: float, right: float = math.inf) -> list[Row]:
    """Return the rows of the words between two places."""
    inside = (
        [word for word in row if left <= (word.left + word.right) / 2 < right] for row in band
    )
    return [row for row in inside if row]


def _parts_columns(band: list[Row], gap: _Span, gaps: list[_Span]) -> bool:
    """Return whether a gap parts columns of text, to be read one after the other: the file does so,
    or lines of both are as wide and as close as those of prose."""
    ends = [-math.inf, *(right for _, right in gaps), math.inf]
    at = ends.index(gap[1])
    left, right = (_part(band, *ends[k : k + 2]) for k in (at - 1, at))
    if _are(_FIGURE, right) or _are(_LABEL, left):
        return False
    beside = [word for row in _part(band, gap[1]) for word in row]
    level = sum(
        any(abs(word.y - row[0].y) < _BESIDE * word.size for word in beside)
        for row in _part(band, -math.inf, gap[1])
    )
    printed = [word for row in band for word in row if word.place >= 0]
    sides = [word.left > gap[0] for word in sorted(printed, key=lambda word: word.place)]
    crossings = sum(before != after for before, after in itertools.pairwise(sides))
    # Rows of a table are short, or farther apart than lines of a column.
    step = max(_usual_step(left), _usual_step(right)) / band[0][0].size
    is_loose = step > _LOOSE[level >= _LONG]
    least = _WIDEST if is_loose else _WIDER if printed else _WIDE_CELL
    is_wide = level > 2 and min(map(_mean_width, (left, right))) > least
    return 0 < 2 * crossings <= level or is_wide


def _are(pattern: re.Pattern[str], column: list[Row]) -> bool:
    """Return whether most rows of a column match a pattern."""
    return sum(pattern.fullmatch(_text_of(row)) is not None for row in column) > 0.6 * len(column)


def _mean_width(column: list[Row]) -> float:
    """Return the mean width of the lines of a column in sizes of their letters."""
    widths = [(max(word.right for word in row) - row[0].left) / row[0].size for row in column]
    return statistics.fmean(widths or [0.0])


def _cell_ends(band: list[Row]) -> list[float]:
    """Return the places that part cells, if rows are a table: the fewest that lie in all gaps, and
    each in two or more."""
    gaps = sorted(
        (gap for row in band for gap in _free(_pieces(row))[1:-1]), key=lambda gap: gap[1]
    )
    shared: list[_Span] = []
    for left, right in gaps:
        if shared and left < shared[-1][1]:
            shared[-1] = max(left, shared[-1][0]), shared[-1][1]
        else:
            shared.append((left, right))
    middles = ((left + right) / 2 for left, right in shared)
    ends = [end for end in middles if sum(left < end < right for left, right in gaps) > 1]
    columns = (_part(band, *pair) for pair in itertools.pairwise([-math.inf, *ends, math.inf]))
    return ends if sum(_mean_width(column) > _WIDEST for column in columns) < 2 else []


def _table_row(row: Row, ends: list[float]) -> Line:
    """Return a row of a table; it is a plain line if it has words in its first column alone."""
    texts: dict[int, str] = {}
    for piece in split(row, lambda before, word: any(
        before.right < end < word.left > before.right + _FIGURES * word.size for end in ends
    )):  # fmt: skip
        column = sum(piece[0].left > end for end in ends)
        texts[column] = f"{texts.get(column, '')} {_text_of(piece)}".strip()
    if [*texts] == [0]:
        return Line(row, texts[0])
    return Line(row, "; ".join(texts.get(k) or "-" for k in range(len(ends) + 1)), True)
