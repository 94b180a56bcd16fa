"""Joining of printed lines to paragraphs, without running heads and page numbers."""

import itertools
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from smarttouch.pages.page_and_lines import TextLine
from smarttouch.reading.recognition import Note

_GAP = 1.35  # from this line distance on, relative to the median, a paragraph begins
_LARGER = 1.2  # lines with a larger ratio of x-heights differ in size of print
_INDENT = 0.8  # smallest indent of a paragraph, in x-heights
_SAME_ROW_MM = 0.5  # largest vertical offset between lines that are side by side
_EVEN = 0.5  # largest difference between the right ends of full lines, in x-heights
_SHORT = 0.15  # a line is short if more than this share of the column is free after it
_OPEN = 1 / 3  # lines are not joined if at least this share ends early and within a sentence
_LONGEST_VERSE = 60  # a full line with more characters is not a line of verse
_LEADERS = re.compile(r"(?:\s?[.·…‥•]){4,}\s*;?\s*(?=\S*\d\S*$|[ivxlc]{1,7}\W*$)")
"""Leader dots before a page number or a price. In a row of a table, a semicolon can follow them."""
_BLANK = re.compile(r"(?:_{3,}|(?:\s?[.…]){5,})\W*$")
"""Blank space to write in, as on forms, at the end of a line."""
_BULLETS = r"[•◦▪‣●○■□☐☑☒✓➢\ue000-\uf8ff]"
_MARK = re.compile(
    rf"{_BULLETS}|\(?\d{{1,3}}(?:\.\d{{1,3}})*[.)]?\s|\(?[ivx]{{1,5}}[.)]\s|"
    r"\(?[a-zA-Z][.)]\s|\[\w{1,5}\]\s|§+\s?\d|[-–—*>+]+\s|>"
)
"""Mark of a list item."""
_HYPHENS = "-\u00ad\u2010\u2011\x02\ufffe¬"
_AND = frozenset(["and", "or", "und", "oder", "bis", "bzw"])
"""Words before which a hyphen is kept, as in "pre- and post-war"."""
_HYPHENATED = frozenset(["self", "well"])  # first parts of compounds that keep their hyphen
_SAME_MM = 5.0  # a repeated line shifts vertically by less than this between two pages
_HEAD_GAP = 1.15  # smallest gap between running head and text, relative to the median line distance
_MOST_HEADS = 4  # if more lines at the edge of a page repeat, the pages are copies of a form


@dataclass(frozen=True)
class PrintedLine:
    """Text of a `TextLine`, with the number of its page and its place, mm."""

    text: str
    page: int
    left_mm: float
    right_mm: float
    y_mm: float  # middle of the line
    x_height_mm: float
    cell: int = 0

    def is_like(self, other: "PrintedLine") -> bool:
        """Return whether two lines have the same size of print."""
        sizes = sorted((self.x_height_mm, other.x_height_mm))
        return sizes[1] <= _LARGER * sizes[0]


def printed_lines(page: int, lines: Sequence[TextLine], texts: Iterable[str]) -> list[PrintedLine]:
    """Return the lines of a page that have text."""
    return [
        PrintedLine(
            text.strip(), page, line.left_mm, line.right_mm, (line.top_mm + line.bottom_mm) / 2,
            line.x_height_mm, line.cell,
        )
        for line, text in zip(lines, texts, strict=True) if text.strip()
    ]  # fmt: skip


def without_heads(lines: Sequence[PrintedLine], note: Note) -> list[PrintedLine]:
    """Remove running heads. They are repeated at the same place at the top or bottom of several
    pages; only page numbers differ. ``note`` is called with a sentence about them."""
    pages = [
        sorted(page, key=lambda line: line.y_mm)
        for _, page in itertools.groupby(lines, lambda line: line.page)
    ]
    edges = [page[::way] for page in pages for way in (1, -1)]
    same: dict[str, list[PrintedLine]] = defaultdict(list)
    for line in {id(line): line for edge in edges for line in edge[: _MOST_HEADS + 1]}.values():
        for key in _keys(line):
            same[key].append(line)
    heads: dict[str, set[int]] = defaultdict(set)
    dropped: set[int] = set()
    for edge in edges:
        outer = (_repeated(line, same) for line in edge[: _MOST_HEADS + 1])
        labels = list(itertools.takewhile(bool, outer))
        if len(labels) > _MOST_HEADS:
            # Many repeated lines mean that pages are copies of a form: remove only the page number.
            labels = [label for label in labels[:1] if "#" in label]
        steps = np.abs(np.diff([line.y_mm for line in edge]))
        apart_mm = steps[steps > _SAME_ROW_MM]
        usual_mm = np.median(apart_mm) if len(apart_mm) else 0.0
        while labels and not (steps[len(labels) - 1 :][:1] > _HEAD_GAP * usual_mm).any():
            labels.pop()
        for label, line in zip(labels, edge, strict=False):
            heads[label].add(line.page)
            dropped.add(id(line))
    if heads:
        named = "; ".join(
            f"“{label}” on {len(numbers)} pages, {min(numbers)} to {max(numbers)}"
            for label, numbers in heads.items()
        )
        note(
            f"running heads and page numbers (#) are left out: {named}; to keep them, add "
            "?keep_headers to the file's name"
        )
    return [line for line in lines if id(line) not in dropped]


def _keys(line: PrintedLine) -> Iterator[str]:
    """Yield the keys of a line. Lines of the same running head have a key in common. The first key
    is the text. Each number in the text gives a further key: the text with # instead of the number,
    then the number minus the number of the page. This difference is equal on all pages if the
    number is a printed page number."""
    yield line.text
    for number in re.finditer(r"\d{1,5}", line.text):
        before, after = line.text[: number.start()], line.text[number.end() :]
        yield f"{before}#{after}\n{int(number[0]) - line.page}"


def _repeated(line: PrintedLine, same: dict[str, list[PrintedLine]]) -> str:
    """Return the text that a line shares with a line on another page (see `_keys`), or ""."""
    for key in _keys(line):
        for other in same[key]:
            if other.page != line.page and abs(other.y_mm - line.y_mm) < _SAME_MM:
                return key.partition("\n")[0]
    return ""


def paragraphs(lines: Sequence[PrintedLine]) -> list[str]:
    """Join lines to paragraphs, headings, list items and rows of tables.

    A paragraph begins at an indent, at a list item or at another size of print. It also begins
    after a gap, and after a line that ends early. It continues in the next column or page. Verse,
    addresses and entries with leader dots keep their lines. Divided words are joined. Their hyphen
    stays if the text also contains the hyphenated word.
    """
    layout = _Layout(lines)
    compounds = {word.lower() for line in lines for word in re.findall(r"\w+-\w+", line.text)}
    joined: list[_Paragraph] = []
    current: _Paragraph | None = None
    for k, line in enumerate(lines):
        if line.cell:
            joined += [_Paragraph(row, k, k) for row in layout.rows.get(k, ())]
            current = None
            continue
        if k and line.page != lines[k - 1].page:
            # A page can end with a footnote, so continue the last paragraph with equal print size.
            alike = (earlier for earlier in reversed(joined) if lines[earlier.last].is_like(line))
            current = next(alike, None)
        text = _LEADERS.sub(" ", line.text)
        if current is None or layout.begins(current, k):
            current = _Paragraph(text, k, k)
            joined.append(current)
        else:
            current.text, current.last = _joined(current.text, text, compounds), k
        if text != line.text or _BLANK.search(text):
            current = None
    return [paragraph.text for paragraph in joined]


@dataclass
class _Paragraph:
    text: str
    first: int  # index of the first line
    last: int  # index of the last line


class _Layout:
    """Layout of lines: their right margins, and whether the lines of a block stay separate."""

    def __init__(self, lines: Sequence[PrintedLine]) -> None:
        self._lines = lines
        pages = {line.page: [other for other in lines if other.page == line.page] for line in lines}
        self._step_mm: dict[int, float] = {}
        for page, group in pages.items():
            steps = np.diff([line.y_mm for line in group if not line.cell])
            steps = steps[steps > 0]
            self._step_mm[page] = float(np.median(steps)) if len(steps) else np.inf
        self._edge_mm = [line.right_mm for line in lines]
        self._keeps, self._alone = [False] * len(lines), [True] * len(lines)
        self._hangs = [False] * len(lines)
        self.rows: dict[int, list[str]] = {}
        for run in self._runs(lambda before, line: bool(before.cell) != bool(line.cell)):
            if lines[run[0]].cell:
                self.rows[run[0]] = _table_rows([lines[k] for k in run])
        for column in self._runs(lambda before, line: line.y_mm <= before.y_mm or bool(line.cell)):
            self._measure(column, pages[lines[column[0]].page])
        for block in self._runs(self._is_apart):
            self._classify(block)

    def _runs(self, parts: Callable[[PrintedLine, PrintedLine], bool]) -> Iterator[list[int]]:
        """Yield runs of line indices. A run ends at the end of a page, and after a line for which
        ``parts(line, next)`` is True."""
        run: list[int] = []
        for k, line in enumerate(self._lines):
            before = self._lines[k - 1]
            if run and (line.page != before.page or parts(before, line)):
                yield run
                run = []
            run.append(k)
        if run:
            yield run

    def _measure(self, column: Sequence[int], page: Sequence[PrintedLine]) -> None:
        """Find the right margin of each line: the rightmost end of all lines in the same column
        with the same size of print. Ignore lines that reach into the neighboring column."""
        lines = self._lines
        for k in column:
            near_mm = self._step_mm[lines[k].page] / 2
            beside = [
                other.left_mm for other in page
                if other.left_mm > lines[k].right_mm and abs(other.y_mm - lines[k].y_mm) < near_mm
            ]  # fmt: skip
            limit_mm = min(beside, default=np.inf)
            self._edge_mm[k] = max(
                lines[other].right_mm for other in column
                if lines[other].right_mm < limit_mm and lines[other].is_like(lines[k])
            )  # fmt: skip

    def _classify(self, block: Sequence[int]) -> None:
        """Decide whether the lines of a block stay separate, and whether the block has hanging
        indents."""
        lines = [self._lines[k] for k in block]
        pairs = list(itertools.pairwise(block))
        right_mm = np.array([line.right_mm for line in lines[:-1]])
        even = np.abs(np.diff(right_mm)) < _EVEN * lines[0].x_height_mm
        is_open = list(itertools.starmap(self._is_open, pairs))
        capitals = len(pairs) > 1 and not any(line.text[0].islower() for line in lines)
        keeps = 0 < _OPEN * len(pairs) <= sum(is_open) or (
            capitals and 3 * even.sum() < 2 * len(pairs)
        )
        divides = any(_divides(one.text, two.text) for one, two in itertools.pairwise(lines))
        left_mm = np.array([line.left_mm for line in lines])
        hanging = left_mm - left_mm.min() > _INDENT * lines[0].x_height_mm
        for k in block:
            self._alone[k] = not pairs
            self._keeps[k] = keeps and not divides
            self._hangs[k] = bool(2 * hanging.sum() > len(block))

    def _is_apart(self, before: PrintedLine, line: PrintedLine) -> bool:
        step_mm = line.y_mm - before.y_mm
        is_near = 0 < step_mm < _GAP * self._step_mm[line.page]
        return not (is_near and before.is_like(line)) or bool(line.cell or before.cell)

    def _is_ragged(self, before: int, k: int) -> bool:
        """Return whether the first word of line ``k`` would have fitted into the line before."""
        line = self._lines[k]
        word = line.text.split()[0]
        per_character = (line.right_mm - line.left_mm) / len(line.text)
        free_mm = self._edge_mm[before] - self._lines[before].right_mm
        return free_mm > (len(word) + 1) * per_character + _EVEN * line.x_height_mm

    def _is_open(self, before: int, k: int) -> bool:
        """Return whether a line ends early within a sentence."""
        line, edge_mm = self._lines[before], self._edge_mm[before]
        is_short = edge_mm - line.right_mm > _SHORT * (edge_mm - line.left_mm)
        goes_on = self._lines[k].text[0].islower() and not is_short
        return self._is_ragged(before, k) and not goes_on and not _is_sentence(line.text)

    def begins(self, paragraph: _Paragraph, k: int) -> bool:
        """Return whether a line begins a new paragraph."""
        first, before, line = (self._lines[j] for j in (paragraph.first, paragraph.last, k))
        if _divides(before.text, line.text):
            return False
        if line.page != before.page or line.y_mm <= before.y_mm:
            return self._begins_column(paragraph.last, k)
        if self._is_apart(before, line) or self._is_item(paragraph, k):
            return True
        indent_mm = _INDENT * line.x_height_mm
        is_new = not line.text[0].islower() or _is_sentence(before.text)
        if self._hangs[k] or _MARK.match(first.text):
            if line.left_mm - first.left_mm > indent_mm:
                return False
            if before.left_mm - first.left_mm > indent_mm:
                return True
        elif is_new and line.left_mm - before.left_mm > indent_mm:
            return True
        return self._ends(paragraph.last, k)

    def _is_item(self, paragraph: _Paragraph, k: int) -> bool:
        """Return whether a line begins with the mark of a list item. Within a sentence, a number or
        a letter at the start of a line can look like a mark; it does not count."""
        text, before = self._lines[k].text, self._lines[paragraph.last].text
        mark = _MARK.match(text)
        return mark is not None and (
            re.match(_BULLETS, text) is not None
            or _is_sentence(before)
            or self._is_ragged(paragraph.last, k)
        )

    def _ends(self, before: int, k: int) -> bool:
        """Return whether a line ends early, as the last line of a paragraph or a line of a poem."""
        text, after = self._lines[before].text, self._lines[k].text
        is_end = not after[0].islower() or _is_sentence(text)
        is_ragged = self._is_ragged(before, k)
        keeps = self._keeps[before] and self._keeps[k]
        return (keeps and (is_ragged or len(text) <= _LONGEST_VERSE)) or (is_end and is_ragged)

    def _begins_column(self, before: int, k: int) -> bool:
        """Return whether the first line of a column or page begins a paragraph."""
        text, line = self._lines[before].text, self._lines[k]
        if not self._lines[before].is_like(line) or re.match(_BULLETS, line.text):
            return True
        following = self._lines[k + 1] if k + 1 < len(self._lines) else line
        indent_mm = line.left_mm - following.left_mm
        is_first = following.page == line.page and following.y_mm > line.y_mm
        if is_first and indent_mm > _INDENT * line.x_height_mm and not self._hangs[k]:
            return True
        is_next = line.page != self._lines[before].page and _is_sentence(text)
        is_whole = is_next or self._keeps[before] or self._alone[before]
        if is_whole and not line.text[0].islower():
            return True
        return self._ends(before, k)


def _divides(text: str, after: str) -> bool:
    """Return whether a hyphen divides a word between two lines."""
    return text[-1] in _HYPHENS and text[-2:-1].isalnum() and after[0].isalnum()


def _is_sentence(text: str) -> bool:
    """Return whether a line ends like a sentence."""
    return text.rstrip("\"'”’»)")[-1:] in tuple(".!?:")


def _table_rows(cells: Sequence[PrintedLine]) -> list[str]:
    """Return the rows of a table, with semicolons between cells and a hyphen for an empty cell."""
    rows = [
        [cell for _, cell in row]
        for _, row in itertools.groupby(
            enumerate(cells), lambda numbered: numbered[0] - numbered[1].cell
        )
    ]
    widest = max(rows, key=len)
    table_rows = []
    for row in rows:
        texts = ["-"] * len(widest)
        for cell in row:
            apart_mm = [
                max(other.left_mm - cell.right_mm, cell.left_mm - other.right_mm)
                for other in widest
            ]  # fmt: skip
            widest_gap = int(np.argmin(apart_mm))
            texts[widest_gap] = (
                cell.text if texts[widest_gap] == "-" else f"{texts[widest_gap]} {cell.text}"
            )
        alone = texts[0] != "-" and set(texts[1:]) == {"-"}
        table_rows.append(_LEADERS.sub(" ", texts[0] if alone else "; ".join(texts)))
    return table_rows


def _joined(before: str, after: str, compounds: set[str]) -> str:
    """Join two lines. Remove a hyphen that divides a word; keep the hyphen of a compound."""
    last = before.split()[-1]
    if "://" in last and last[-1] in "/?&=_%#-":
        return before + after
    if before[-1] not in _HYPHENS or not before[:-1] or before[-2].isspace():
        return f"{before} {after}"
    first, second = (re.findall(r"\w*", part) for part in (last[-2::-1], after))
    one, other = first[0][::-1], second[0]
    if other in _AND:
        return f"{before[:-1]}- {after}"
    are_capitals = len(one) > 1 and (one + other).isupper()
    divides = after[0].islower() or are_capitals
    is_compound = f"{one}-{other}".lower() in compounds or one.lower() in _HYPHENATED
    if before[-1] == "\u00ad" or (divides and not is_compound):
        return before[:-1] + after
    return f"{before[:-1]}-{after}"
