"""Paragraphs of pages from their lines, without running heads and page numbers."""

import itertools
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from smarttouch.pages.text_lines import TextLine
from smarttouch.reading.recognition import Note

_GAP = 1.35  # ratio of a distance of lines to the usual one from which a paragraph begins
_LARGER = 1.2  # ratio of x-heights from which prints differ, as a heading and its text
_INDENT, _BESIDE = 0.8, 8.0
"""Least indent of a paragraph in x-heights, and that from which it may be beside a picture."""
_EVEN = 0.5  # difference of right ends, in x-heights, of lines that are filled
_LIKE, _SHORT = 0.4, 0.15  # widths of verse, to the longest; part of a line that is free
_LEADERS = re.compile(r"(?:\s?[.·…‥•]){4,}\s*;?\s*(?=\S*\d\S*$|[ivxlc]{1,7}\W*$)")
"""Dots that lead to a page's number or a price, in the same cell or the next."""
_BLANK = re.compile(r"(?:_{3,}|(?:\s?[.…]){5,})\W*$")
"""A blank to be filled in at the end of a line."""
_MARK = re.compile(
    r"[•◦▪‣●○■□☐☑☒✓➢\ue000-\uf8ff]|\(?\d{1,3}(?:\.\d{1,3})*[.)]?\s|\(?[ivx]{1,5}[.)]\s|"
    r"\(?[a-zA-Z][.)]\s|\[\w{1,5}\]\s|§+\s?\d|[-–—*>+]+\s|>"
)
_SURE_MARK = re.compile(
    r"[•◦▪‣●○■□☐☑☒✓➢\ue000-\uf8ff]|\(?\d{1,3}[.)]\s|\(?[a-z][.)]\s|\[\d+\]\s|§+\s?\d|>"
)
"""Marks of items in a list; those that are not sure may stand in the middle of a sentence."""
_HYPHENS = "-\u00ad\u2010\u2011\x02\ufffe¬"
_LONGEST_WORD = 200  # characters that are searched at the end of a line
_ADDRESS = re.compile(r"\w://\S*[/?&=_%#-]$")  # end of a web address that goes on
_AND = frozenset(["and", "or", "und", "oder", "bis", "bzw"])
"""Words after which the hyphen of "pre- and post-war" stays."""
_ALONE = frozenset(["self", "well"])  # words that are not divided from their ends
_SAME_MM = 5.0  # difference of heights at which something repeats on several pages
_HEAD_GAP = 1.15  # distance of a running head from the text, in usual ones
_MOST_HEADS, _MOST_NUMBERS = 3, 3  # lines of a running head, and numbers in it
_ROMAN = dict(zip("ivxlc", (1, 5, 10, 50, 100), strict=True))


@dataclass(frozen=True)
class PrintedLine:
    """Line of a page: its text, the page's number, and its place in mm; see `TextLine`."""

    text: str
    page: int
    left_mm: float
    right_mm: float
    y_mm: float  # of its middle
    x_height_mm: float
    cell: int = 0
    has_initial: bool = False


def printed_lines(page: int, lines: Sequence[TextLine], texts: Iterable[str]) -> list[PrintedLine]:
    """Return the lines of a page with their texts, without empty ones."""
    return [
        PrintedLine(
            text.strip(), page, line.left_mm, line.right_mm, (line.top_mm + line.bottom_mm) / 2,
            line.x_height_mm, line.cell, bool(line.initial_mm),
        )
        for line, text in zip(lines, texts, strict=True) if text.strip()
    ]  # fmt: skip


def without_heads(lines: Sequence[PrintedLine], note: Note) -> list[PrintedLine]:
    """Return lines without running heads and page numbers: those at the top and bottom of pages
    that repeat at the same height on two or more, or count the pages there. ``note`` names them."""
    pages = [_rows(page) for _, page in itertools.groupby(lines, lambda line: line.page)]
    heads: dict[str, list[int]] = defaultdict(list)
    dropped: set[int] = set()
    for edge in (1, -1):
        same: dict[str, list[PrintedLine]] = defaultdict(list)
        outer = [rows[::edge][: _MOST_HEADS + 1] for rows in pages]
        for row in itertools.chain(*outer):
            for key in _keys(row):
                same[key].append(row[0])
        for rows, whole in zip(outer, pages, strict=True):
            labels = list(itertools.takewhile(bool, (_repeated(row, same) for row in rows)))
            if len(labels) > _MOST_HEADS:
                # Forms or copies of one page: their numbers alone are no part of them.
                labels = [label for label in labels[:1] if "#" in label]
            while labels and not _are_apart(whole[::edge], len(labels)):
                labels.pop()
            for label, row in zip(labels, rows, strict=False):
                heads[label].append(row[0].page)
                dropped |= {id(line) for line in row}
    kept = [line for line in lines if id(line) not in dropped]
    if heads:
        named = "; ".join(f"“{label}” on {_ranges(where)}" for label, where in heads.items())
        note(
            f"running heads and page numbers (#) are left out: {named}; ?keep_headers after the "
            "file's name keeps them"
        )
    return kept


def _are_apart(rows: Sequence[Sequence[PrintedLine]], count: int) -> bool:
    """Return whether the first rows from an edge of a page are apart from the others."""
    steps = np.abs(np.diff([row[0].y_mm for row in rows]))
    return count < len(rows) and bool(steps[count - 1] > _HEAD_GAP * np.median(steps))


def _rows(lines: Iterable[PrintedLine]) -> list[list[PrintedLine]]:
    """Return the lines at each height of a page, from the top down, left to right."""
    rows: list[list[PrintedLine]] = []
    for line in sorted(lines, key=lambda line: line.y_mm):
        if rows and line.y_mm - rows[-1][0].y_mm < line.x_height_mm / 2:
            rows[-1].append(line)
        else:
            rows.append([line])
    return [sorted(row, key=lambda line: line.left_mm) for row in rows]


def _keys(row: Sequence[PrintedLine]) -> Iterator[str]:
    """Yield a row's text with # for any of its numbers, and how far these are from the page's."""
    text = " ".join(line.text for line in row)
    roman = re.fullmatch(r"\W*([ivxlc]{1,7})\W*", text, re.IGNORECASE)
    parts = [text] if roman is None else ["", roman[1], ""]
    if roman is None:
        parts = re.split(r"(\d{1,5})", text)
    numbers = range(1, len(parts), 2)
    if len(numbers) <= _MOST_NUMBERS:
        for counts in itertools.product((True, False), repeat=len(numbers)):
            ahead = [_number(parts[k]) - row[0].page for k in itertools.compress(numbers, counts)]
            shown = [
                "#" if k % 2 and counts[k // 2] else part for k, part in enumerate(parts)
            ]  # fmt: skip
            yield f"{''.join(shown).strip()}\n{ahead}"


def _number(text: str) -> int:
    if text.isdigit():
        return int(text)
    values = [_ROMAN[letter] for letter in text.lower()]
    return sum(
        -value if value < max(values[k:]) else value for k, value in enumerate(values)
    )  # fmt: skip


def _repeated(row: Sequence[PrintedLine], same: dict[str, list[PrintedLine]]) -> str:
    """Return what a row has in common with one on another page, or ""."""
    for key in _keys(row):
        for line in same[key]:
            if line.page != row[0].page and abs(line.y_mm - row[0].y_mm) < _SAME_MM:
                return key.partition("\n")[0]
    return ""


def _ranges(pages: Sequence[int]) -> str:
    """Return page numbers in words, as in ``pages 1-3, 7``."""
    runs = itertools.groupby(enumerate(sorted(set(pages))), lambda each: each[1] - each[0])
    spans = [[page for _, page in run] for _, run in runs]
    return "pages " + ", ".join(
        f"{span[0]}-{span[-1]}" if len(span) > 1 else str(span[0]) for span in spans
    )


def paragraphs(lines: Sequence[PrintedLine]) -> list[str]:
    """Return the paragraphs, headings, items and rows of tables of pages from their lines.

    A paragraph begins after a larger distance or a line that ends early, with an indent, the mark
    of an item, or print of another size; it continues in the next column and on the next page.
    Verse, addresses and entries that lead to a number keep their lines. Words that lines divide
    are joined; a hyphen stays where the text has the word with it.
    """
    layout = _Layout(lines)
    compounds = {word.lower() for line in lines for word in re.findall(r"\w+-\w+", line.text)}
    found: list[_Paragraph] = []
    current: _Paragraph | None = None
    for k, line in enumerate(lines):
        if line.cell:
            found += [_Paragraph(row, k, k) for row in layout.rows.get(k, ())]
            current = None
            continue
        if k and line.page != lines[k - 1].page:
            # Footnotes may stand below the paragraph that continues.
            alike = (each for each in reversed(found) if layout.is_alike(each.last, k))
            current = next(alike, None)
        text = _LEADERS.sub(" ", line.text)
        if current is None or layout.begins(current, k):
            current = _Paragraph(text, k, k)
            found.append(current)
        else:
            current.text, current.last = _joined(current.text, text, compounds), k
        if text != line.text or _BLANK.search(text):
            current = None
    return [paragraph.text for paragraph in found]


@dataclass
class _Paragraph:
    text: str
    first: int  # indices of its first and last line
    last: int


class _Layout:
    """Columns and blocks of lines: where they end, and which of them keep their lines."""

    def __init__(self, lines: Sequence[PrintedLine]) -> None:
        self._lines = lines
        self._pages: dict[int, list[PrintedLine]] = defaultdict(list)
        for line in lines:
            self._pages[line.page].append(line)
        self._step_mm: dict[int, float] = {}
        for page, group in self._pages.items():
            steps = np.diff([line.y_mm for line in group if not line.cell])
            self._step_mm[page] = (
                float(np.median(steps[steps > 0])) if (steps > 0).any() else np.inf
            )
        self._edge_mm = [line.right_mm for line in lines]
        self._keeps = [True] * len(lines)
        self._is_verse = [False] * len(lines)
        self._is_item = [False] * len(lines)
        self._hangs = [False] * len(lines)
        self.rows: dict[int, list[str]] = {}
        for run in self._runs(lambda before, line: bool(before.cell) != bool(line.cell)):
            if lines[run[0]].cell:
                self.rows[run[0]] = _table_rows([lines[k] for k in run])
        for column in self._runs(lambda before, line: line.y_mm <= before.y_mm or bool(line.cell)):
            self._measure(column)
        for block in self._runs(self._is_apart):
            self._judge(block)

    def _runs(self, parts: Callable[[PrintedLine, PrintedLine], bool]) -> Iterator[list[int]]:
        """Yield the indices of successive lines of a page between which nothing parts them."""
        run: list[int] = []
        for k, line in enumerate(self._lines):
            if run and (
                line.page != self._lines[run[-1]].page or parts(self._lines[run[-1]], line)
            ):
                yield run
                run = []
            run.append(k)
        if run:
            yield run

    def _measure(self, column: Sequence[int]) -> None:
        """Find how far the lines of a column may reach: as far as others of it, and not beyond what
        stands beside them."""
        lines = self._lines
        page = self._pages[lines[column[0]].page]
        for k in column:
            line = lines[k]
            beside = (
                other.left_mm for other in page
                if other.left_mm > line.right_mm
                and abs(other.y_mm - line.y_mm) < self._step_mm[line.page] / 2
            )  # fmt: skip
            limit_mm = min(beside, default=np.inf)
            self._edge_mm[k] = max(
                lines[other].right_mm for other in column
                if lines[other].right_mm < limit_mm and self.is_alike(other, k)
            )  # fmt: skip

    def _judge(self, block: Sequence[int]) -> None:
        """Find which lines of a block stay as they are, have the mark of an item, or hang below the
        first of each paragraph."""
        lines = [self._lines[k] for k in block]
        pairs = list(itertools.pairwise(block))
        ragged = [self._is_ragged(*pair) for pair in pairs]
        full = len(pairs) - sum(ragged)
        even = sum(itertools.starmap(self._is_even, pairs[:-1]))
        capitals = len(pairs) > 1 and not any(line.text[0].islower() for line in lines)
        keeps = (
            2 * full <= (len(block) if len(block) > 3 else len(pairs))
            or (capitals and 3 * even < 2 * len(pairs))
        ) and not any(itertools.starmap(self._divides, pairs))  # fmt: skip
        widths = sorted(line.right_mm - line.left_mm for line in lines)
        open_ends = any(
            early and not _is_sentence(line.text)
            for line, early in zip(lines, ragged, strict=False)
        )  # fmt: skip
        is_verse = 2 * full <= len(block) and widths[0] > _LIKE * widths[-1] and open_ends
        left_mm = np.array([line.left_mm for line in lines])
        hanging = left_mm - left_mm.min() > _INDENT * lines[0].x_height_mm
        marks = [_mark(line.text) for line in lines]
        for k, mark in zip(block, marks, strict=True):
            self._keeps[k] = keeps
            self._is_verse[k] = len(block) > 3 and keeps and is_verse
            self._hangs[k] = bool(2 * hanging.sum() > len(block))
            self._is_item[k] = bool(mark) and marks.count(mark) > 1

    def is_alike(self, one: int, other: int) -> bool:
        """Return whether two lines have print of one size."""
        sizes = sorted(self._lines[k].x_height_mm for k in (one, other))
        return sizes[1] <= _LARGER * sizes[0]

    def _is_apart(self, before: PrintedLine, line: PrintedLine) -> bool:
        step_mm = line.y_mm - before.y_mm
        sizes = sorted((before.x_height_mm, line.x_height_mm))
        return (
            step_mm <= 0 or step_mm >= _GAP * self._step_mm[line.page]
            or sizes[1] > _LARGER * sizes[0] or bool(line.cell or before.cell or line.has_initial)
        )  # fmt: skip

    def _is_even(self, before: int, k: int) -> bool:
        one, other = self._lines[before], self._lines[k]
        return abs(one.right_mm - other.right_mm) < _EVEN * other.x_height_mm

    def _is_ragged(self, before: int, k: int) -> bool:
        """Return whether the first word of a line would have fitted at the end of that before."""
        line = self._lines[k]
        word = line.text.split()[0]
        per_character = (line.right_mm - line.left_mm) / len(line.text)
        free_mm = self._edge_mm[before] - self._lines[before].right_mm
        return free_mm > (len(word) + 1) * per_character + _EVEN * line.x_height_mm

    def _divides(self, before: int, k: int) -> bool:
        """Return whether a hyphen divides a word of two lines."""
        text, after = self._lines[before].text, self._lines[k].text
        return (
            self.is_alike(before, k) and text[-1] in _HYPHENS and text[-2:-1].isalnum()
            and after[0].isalnum()
        )  # fmt: skip

    def begins(self, paragraph: _Paragraph, k: int) -> bool:
        """Return whether a line begins another paragraph."""
        before, line = self._lines[paragraph.last], self._lines[k]
        if self._divides(paragraph.last, k):
            return False
        if line.page != before.page or line.y_mm <= before.y_mm:
            return self._begins_column(paragraph, k)
        if self._is_apart(before, line):
            return True
        is_item = _MARK.match(self._lines[paragraph.first].text) is not None
        ragged = self._is_ragged(paragraph.last, k)
        x_height_mm = line.x_height_mm
        shift = (line.left_mm - before.left_mm) / x_height_mm
        if _MARK.match(line.text) and (
            _SURE_MARK.match(line.text)
            or self._is_item[k]
            or is_item
            or ragged
            or abs(shift) > _INDENT
        ):
            return True
        first_mm = self._lines[paragraph.first].left_mm
        if is_item or self._hangs[k]:
            indent, hung = ((each.left_mm - first_mm) / x_height_mm for each in (line, before))
            if indent > _INDENT and shift < _BESIDE:
                return False
            return hung > _INDENT or self._ends(paragraph.last, k)
        short = (self._edge_mm[k] - line.right_mm) / x_height_mm
        # What is indented in the middle of a sentence hangs below its first line.
        is_new = ragged or not line.text[0].islower() or _is_sentence(before.text)
        if is_new and shift > _INDENT and (shift < _BESIDE or short > _INDENT):
            return True
        return self._ends(paragraph.last, k)

    def _ends(self, before: int, k: int) -> bool:
        """Return whether a line ends early, as the last of a paragraph or each of a poem."""
        line, after = self._lines[before], self._lines[k].text
        ragged = self._is_ragged(before, k)
        keeps = self._keeps[k] and self._keeps[before]
        if keeps and after[0].islower():
            width_mm = self._edge_mm[before] - line.left_mm
            is_short = self._edge_mm[before] - line.right_mm > _SHORT * width_mm
            return self._is_verse[k] or (ragged and is_short)
        is_end = not after[0].islower() or _is_sentence(line.text)
        return keeps or (ragged and is_end and not self._is_even(before, k))

    def _begins_column(self, paragraph: _Paragraph, k: int) -> bool:
        """Return whether the first line of a column or page begins a paragraph."""
        before, line = self._lines[paragraph.last], self._lines[k]
        if not self.is_alike(paragraph.last, k) or line.has_initial or _SURE_MARK.match(line.text):
            return True
        following = self._lines[k + 1] if k + 1 < len(self._lines) else line
        if following.page == line.page and following.y_mm > line.y_mm and not self._hangs[k]:
            indent = (line.left_mm - following.left_mm) / line.x_height_mm
            if _INDENT < indent < _BESIDE:
                return True
        is_whole = _is_sentence(before.text) or self._keeps[paragraph.last]
        if line.page != before.page and is_whole and not line.text[0].islower():
            return True
        return self._ends(paragraph.last, k)


def _is_sentence(text: str) -> bool:
    """Return whether a line ends as a sentence does."""
    return text.rstrip("\"'”’»)")[-1:] in tuple(".!?:")


def _mark(text: str) -> str:
    """Return what marks of items in one list have in common, or ""."""
    mark = _MARK.match(text)
    return re.sub(r"\w+", "1", mark[0]) if mark else ""


def _table_rows(cells: Sequence[PrintedLine]) -> list[str]:
    """Return the rows of a table with semicolons between cells, and a hyphen for an empty one."""
    rows = [
        [cell for _, cell in row]
        for _, row in itertools.groupby(enumerate(cells), lambda each: each[0] - each[1].cell)
    ]
    widest = max(rows, key=len)
    middles = np.array([(cell.left_mm + cell.right_mm) / 2 for cell in widest])
    found = []
    for row in rows:
        texts = ["-"] * len(widest)
        for cell in row:
            overlap = [
                min(cell.right_mm, other.right_mm) - max(cell.left_mm, other.left_mm)
                for other in widest
            ]
            place = int(np.argmax(overlap))
            if overlap[place] < 0:
                place = int(np.argmin(np.abs(middles - (cell.left_mm + cell.right_mm) / 2)))
            texts[place] = cell.text if texts[place] == "-" else f"{texts[place]} {cell.text}"
        alone = texts[0] != "-" and set(texts[1:]) == {"-"}
        found.append(_LEADERS.sub(" ", texts[0] if alone else "; ".join(texts)))
    return found


def _joined(before: str, after: str, compounds: set[str]) -> str:
    """Return two lines as one: a hyphen goes where it divides a word, and stays in North-South."""
    tail = before[-_LONGEST_WORD:]
    if _ADDRESS.search(tail):
        return before + after
    if before[-1] not in _HYPHENS or before[-2:-1].isspace() or not before[:-1]:
        return f"{before} {after}"
    first, second = re.search(r"\w*$", tail[:-1]), re.match(r"\w*", after)
    assert first is not None
    assert second is not None
    if before[-1] == "\u00ad":
        return before[:-1] + after
    if second[0] in _AND:
        return f"{before[:-1]}- {after}"
    are_capitals = len(first[0]) > 1 and (first[0] + second[0]).isupper()
    divides = after[0].islower() or are_capitals
    is_compound = f"{first[0]}-{second[0]}".lower() in compounds or first[0].lower() in _ALONE
    if divides and not is_compound:
        return before[:-1] + after
    return f"{before[:-1]}-{after}"
