"""Documents as blocks of cells, laid out as pages by Braille Formats (BANA, 2016).

Page numbers of print stand at the end of each page's first line, those of Braille at the end of the
last. A page of print that begins within a page of Braille is marked by a line of dots 36 with its
number; pages of Braille on which it goes on have the letters a, b, c before it.
"""

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from smarttouch.base.errors import BrailleError
from smarttouch.braille.cells import BLANK, Pages, is_cell
from smarttouch.braille.code_tables import BrailleTable
from smarttouch.pages.structured_text import Block, BlockKind, Run, StructuredText

COLUMNS = 40
ROWS = 25  # lines of a North American Braille page
INDENT = 2
"""Cells: a paragraph begins in the third and runs over in the first, as Braille is printed."""
CONTINUED = "⠐"
"""Mark at the end of a line whose last word continues: UEB's line continuation indicator."""
_CENTERED = 3  # least blank cells on either side of a centered heading
_NESTED = 2  # cells by which each level of a list is indented
_HYPHEN = "⠤"
_LETTERS = "⠁⠃⠉⠙⠑⠋⠛⠓⠊⠚⠅⠇⠍⠝⠕⠏⠟⠗⠎⠞⠥⠧⠺⠭⠽⠵"


@dataclass(frozen=True)
class Shape:
    """Blank cells before the first line of a block, and before those it runs over to."""

    kind: BlockKind
    first: int = INDENT
    over: int = 0
    centered: bool = False
    parted: bool = False  # by an empty line from the block before it
    parts: bool = False  # by an empty line from the block after it


@dataclass(frozen=True)
class ShapedText:
    """Blocks of cells with their shapes, and the document they are of."""

    cells: list[str]
    shapes: list[Shape]
    document: StructuredText
    table: BrailleTable

    @property
    def paragraphs(self) -> list[str]:
        """The cells of each block but the numbers of pages of print."""
        every = zip(self.cells, self.shapes, strict=True)
        return [cells for cells, shape in every if shape.kind is not BlockKind.PAGE]

    def cells_of(self, runs: Sequence[Run], leave_out: bool = True) -> str:
        """Return the cells of some of the document's text; cells stay as they are."""
        if not any(is_braille(run.text) for run in runs):
            return self.table.runs_to_cells(runs, leave_out)
        return "".join(
            blanks(run.text) if is_braille(run.text) or run.text.isspace()
            else self.table.runs_to_cells([run], leave_out)
            for run in runs
        )  # fmt: skip

    def number(self, page: int) -> str:
        """Return the cells of a page's number."""
        return self.table.to_cells(str(page), leave_out=True)


def shape_of(block: Block, deepest: int = 0) -> Shape:
    """Return the shape of a block; ``deepest`` is the last level of its list.

    Headings are centered, from cell 5, or from cell 7; items and rows of linear tables begin in
    cell 1, two cells further for each level, and run over two cells beyond the deepest. What goes
    on after a page of print has ended stands where its block runs over.
    """
    if block.kind is BlockKind.HEADING:
        cell = 0 if block.level == 1 else 4 if block.level == 2 else 6
        return Shape(block.kind, cell, cell, centered=not cell, parted=True, parts=not cell)
    if block.kind in (BlockKind.PARAGRAPH, BlockKind.PAGE):
        shape = Shape(block.kind)
    else:
        over = _NESTED * (deepest + 1)
        shape = Shape(block.kind, _NESTED * block.level, over, parted=True, parts=True)
    return replace(shape, first=shape.over) if block.continued else shape


def shaped_text(
    document: StructuredText, table: BrailleTable, leave_out: bool = False
) -> ShapedText:
    """Return a document as cells, its emphasis marked where liblouis has the table; one that
    consists of cells stays as it is."""
    text = [block for block in document.blocks if block.kind is not BlockKind.PAGE]
    shapes = list[Shape]()
    for _, group in itertools.groupby(text, key=lambda block: block.kind):
        # Of these, a list or a table has a deepest level.
        alike = list(group)
        deepest = max(block.level for block in alike)
        shapes += [shape_of(block, deepest) for block in alike]
    remaining = iter(shapes)
    every = [
        Shape(block.kind) if block.kind is BlockKind.PAGE else next(remaining)
        for block in document.blocks
    ]
    made = ShapedText([], every, document, table)
    for block in document.blocks:
        made.cells.append(made.cells_of(block.runs, leave_out or block.kind is BlockKind.PAGE))
    return made


def text_of_cells(
    paragraphs: Sequence[str],
    table: BrailleTable,
    pages: dict[int, str] | None = None,
    document: StructuredText | None = None,
) -> ShapedText:
    """Return paragraphs of cells as a document; ``pages`` are the numbers of those of print that
    begin before paragraphs, by their indices."""
    blocks: list[Block] = []
    for index, each in enumerate(paragraphs):
        if pages and index in pages:
            blocks.append(Block(BlockKind.PAGE, 0, (Run(pages[index]),)))
        blocks.append(Block(BlockKind.PARAGRAPH, 0, (Run(each),)))
    return shaped_text(replace(document or StructuredText(()), blocks=tuple(blocks)), table, True)


def is_braille(text: str) -> bool:
    """Return whether a text consists of cells, and white space between them."""
    return any(map(is_cell, text)) and all(is_cell(each) or each in " \t\n" for each in text)


def blanks(text: str) -> str:
    """Return a line of cells with blank ones for its white space."""
    return "".join(BLANK if each in " \t" else each for each in text)


def lay_out_blocks(text: ShapedText, columns: int = COLUMNS, rows: int = ROWS) -> Pages:
    """Return blocks of cells as pages with their numbers.

    A heading stays with what it is of, and no page begins with an empty line.
    """
    printed = any(shape.kind is BlockKind.PAGE for shape in text.shapes)
    room = rows - 1 - printed
    _require_room(columns, room, max((each.over for each in text.shapes), default=0) + 2)
    pages: Pages = [[]]
    tops = [""]  # the page of print at the beginning of each
    of, parts = "", 0  # the last page of print, and pages of Braille since it began
    begun: list[str] = []  # pages of print without text before the next block
    before: Shape | None = None

    def turn(top: str) -> None:
        pages.append([])
        tops.append(top)

    def go_on() -> None:
        nonlocal parts
        turn(_LETTERS[parts % len(_LETTERS)] + of if of else "")
        parts += 1

    for cells, shape in zip(text.cells, text.shapes, strict=True):
        if shape.kind is BlockKind.PAGE:
            # Numbers are short; what else a document calls them must leave room.
            begun.append(cells[: columns // 3])
            continue
        lines = _shaped(cells, shape, columns)
        same = before is not None and (before.kind, before.over) == (shape.kind, shape.over)
        grouped = same and shape.kind is not BlockKind.HEADING
        gap = before is not None and not grouped and (before.parts or shape.parted)
        ahead = len(lines) + 1 + shape.parts if shape.kind is BlockKind.HEADING else 1
        full = bool(pages[-1]) and len(pages[-1]) + bool(begun) + gap + ahead > room
        if begun:
            # Those of blank pages have one number.
            of, parts = _HYPHEN.join(dict.fromkeys((begun[0], begun[-1]))), 0
            begun = []
            if full:
                turn(of)
            elif pages[-1]:
                pages[-1].append(of.rjust(columns, _HYPHEN))
            else:
                tops[-1] = of
        elif full:
            go_on()
        if gap and pages[-1]:
            pages[-1].append("")
        for line in lines:
            if len(pages[-1]) == room:
                go_on()
            pages[-1].append(line)
        before = shape
    for number, (page, top) in enumerate(zip(pages, tops, strict=True), 1):
        page += [""] * (room - len(page))
        page[:0] = [top.rjust(columns, BLANK) if top else ""] * printed
        page.append(text.number(number).rjust(columns, BLANK))
    return pages


def _shaped(cells: str, shape: Shape, columns: int) -> list[str]:
    if not shape.centered:
        return _wrap(cells, columns, shape.first, shape.over)
    lines = _wrap(cells, columns - 2 * _CENTERED, 0)
    return [BLANK * ((columns - len(line)) // 2) + line for line in lines]


def _require_room(columns: int, rows: int, indent: int) -> None:
    """Raise if a page is too small for a word in a line."""
    if columns < indent + 2 or rows < 1:
        raise BrailleError(
            f"a page of {columns} x {rows} cells is too small: give at least {indent + 2} columns "
            "and 1 row",
            about="page",
        )


def lay_out(
    paragraphs: Sequence[str], columns: int = COLUMNS, rows: int = ROWS, indent: int = INDENT
) -> Pages:
    """Return paragraphs of cells as pages of lines; an empty one stays an empty line.

    Blank cells around a paragraph are dropped, and ``indent`` of them put before it; without any,
    `join` cannot separate paragraphs.
    """
    _require_room(columns, rows, indent)
    lines = [line for each in paragraphs for line in _wrap(each, columns, indent)]
    return [lines[first : first + rows] for first in range(0, len(lines), rows)]


def join(pages: Pages, columns: int | None = None) -> list[str]:
    """Return the paragraphs of laid out pages; a line begins one if it begins with a blank cell or
    follows an empty line."""
    lines = [line for page in pages for line in page]
    columns = columns or max(map(len, lines), default=0)
    paragraphs: list[str] = []
    inside = continued = False
    for line in lines:
        words = line.strip(BLANK)
        if continued:
            paragraphs[-1] += words
        elif inside and words and not line.startswith(BLANK):
            paragraphs[-1] += BLANK + words
        else:
            paragraphs.append(words)
        inside = bool(words)
        continued = _is_continued(line, columns)
        if continued:
            paragraphs[-1] = paragraphs[-1].removesuffix(CONTINUED)
    return paragraphs


def _wrap(paragraph: str, columns: int, indent: int, over: int = 0) -> list[str]:
    lines: list[str] = []
    line = BLANK * indent
    begun = False
    for gap, word in re.findall(f"({BLANK}*)([^{BLANK}]+)", paragraph):
        if begun and not _fits(line + gap + word, columns):
            lines.append(line)
            line, begun = BLANK * over, False
        rest = gap + word if begun else word
        while not _fits(line + rest, columns):
            cut = columns - len(line) - 1
            lines.append(line + rest[:cut] + CONTINUED)
            line, rest = "", rest[cut:]
        line += rest
        begun = True
    return [*lines, line if begun else ""]


def _fits(line: str, columns: int) -> bool:
    return len(line) <= columns and not _is_continued(line, columns)


def _is_continued(line: str, columns: int) -> bool:
    """Return whether a line marks its last word as continued; only full ones can."""
    return len(line) == columns and line.endswith(CONTINUED)
