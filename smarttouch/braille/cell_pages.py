"""Texts and files of cells loaded, laid out as pages and lines, and written."""

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from smarttouch.base.errors import BrailleError
from smarttouch.base.files import named_file, write_bytes
from smarttouch.braille.cells import (
    BLANK,
    FileKind,
    Pages,
    file_kind,
    is_cell,
    read_brf,
    read_pef,
    read_plain_text,
    write_brf,
    write_pef,
)
from smarttouch.braille.code_tables import BrailleTable
from smarttouch.pages.structured_text import (
    Block,
    BlockKind,
    StructuredText,
    read_structured_text,
)

COLUMNS = 40
ROWS = 25
"""Lines of a North American Braille page."""
INDENT = 2
"""Cells: a paragraph begins in the third and runs over in the first, as Braille is printed."""
CONTINUED = "⠐"
"""Mark at the end of a line whose last word continues: UEB's line continuation indicator."""


@dataclass(frozen=True)
class Shape:
    """Blank cells before the first line of a block, and before those it runs over to."""

    kind: BlockKind
    first: int = INDENT
    over: int = 0
    centered: bool = False
    parted: bool = False  # by an empty line from the block before it
    parts: bool = False  # by an empty line from the block after it


_CENTERED = 3  # least blank cells on either side of a centered heading
_NESTED = 2  # cells by which each level of a list is indented


def shape_of(block: Block, deepest: int = 0) -> Shape:
    """Return the shape of a block; ``deepest`` is the last level of its list.

    After Braille Formats (BANA, 2016): headings are centered, from cell 5, or from cell 7; items
    and rows of linear tables begin in cell 1, two cells further for each level, and run over two
    cells beyond the deepest.
    """
    if block.kind is BlockKind.HEADING:
        cell = 0 if block.level == 1 else 4 if block.level == 2 else 6
        return Shape(block.kind, cell, cell, centered=not cell, parted=True, parts=not cell)
    if block.kind is BlockKind.PARAGRAPH:
        return Shape(block.kind)
    over = _NESTED * (deepest + 1)
    return Shape(block.kind, _NESTED * block.level, over, parted=True, parts=True)


def lay_out_blocks(text: "ShapedText", columns: int = COLUMNS, rows: int = ROWS) -> Pages:
    """Return blocks of cells as pages, the number of each at the end of its last line.

    A heading stays with what it is of, and no page begins with an empty line.
    """
    _require_room(columns, rows - 1, max((each.over for each in text.shapes), default=0) + 2)
    pages: Pages = [[]]
    before: Shape | None = None
    for cells, shape in zip(text.cells, text.shapes, strict=True):
        lines = _shaped(cells, shape, columns)
        same = before is not None and (before.kind, before.over) == (shape.kind, shape.over)
        grouped = same and shape.kind is not BlockKind.HEADING
        gap = before is not None and not grouped and (before.parts or shape.parted)
        ahead = len(lines) + 1 + shape.parts if shape.kind is BlockKind.HEADING else 1
        if pages[-1] and len(pages[-1]) + gap + ahead > rows - 1:
            pages.append([])
        elif gap and pages[-1]:
            pages[-1].append("")
        for line in lines:
            if len(pages[-1]) == rows - 1:
                pages.append([])
            pages[-1].append(line)
        before = shape
    for number, page in enumerate(pages, 1):
        page += [""] * (rows - 1 - len(page))
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


TEXT = "text:"
"""Prefix of words that are not a file name."""
_MOST_NAMED = 12  # characters listed in a note on left-out ones


@dataclass(frozen=True)
class ShapedText:
    """Blocks of cells with their shapes, and the metadata of their document."""

    cells: list[str]
    shapes: list[Shape]
    document: StructuredText
    table: BrailleTable

    def number(self, page: int) -> str:
        """Return the cells of a page's number."""
        return self.table.to_cells(str(page), leave_out=True)


def shaped_text(
    document: StructuredText, table: BrailleTable, leave_out: bool = False
) -> ShapedText:
    """Return a document as cells, its emphasis marked where liblouis has the table."""
    shapes = []
    for listed, group in itertools.groupby(
        document.blocks, key=lambda block: block.kind in (BlockKind.ITEM, BlockKind.ROW)
    ):
        blocks = list(group)
        deepest = max(block.level for block in blocks) if listed else 0
        shapes += [shape_of(block, deepest) for block in blocks]
    cells = [table.runs_to_cells(block.runs, leave_out) for block in document.blocks]
    return ShapedText(cells, shapes, document, table)


@dataclass(frozen=True)
class Loaded:
    """Input as cells."""

    paragraphs: list[str]  # a line of a text, or lines that a file of cells runs over
    pages: Pages | None  # as a file of cells has them
    notes: list[str]  # warnings for the user
    shaped: ShapedText | None = None  # of a document with headings, lists and tables


def file_of(source: str) -> Path | None:
    """Return the file that a source names, None if words; a missing file's name is an error."""
    return None if source.startswith(TEXT) or not source else named_file(source, BrailleError)


def load_cells(source: str, table: BrailleTable, leave_out: bool = False) -> Loaded:
    """Load cells from a text or a file of cells, and translate text with the table.

    ``source`` is the name of a file, ``text:`` and words, or words that name no file; a text may
    consist of cells only. ``leave_out`` drops and notes the characters without cells.
    """
    file = file_of(source)
    kind = None if file is None else file_kind(file)
    pages: Pages | None = None
    notes: list[str] = []
    shaped: ShapedText | None = None
    if file is not None and kind in (FileKind.BRF, FileKind.PEF):
        pages = (read_brf if kind is FileKind.BRF else read_pef)(file)
        paragraphs = join(pages)
    elif file is not None and kind is FileKind.STRUCTURED:
        document = read_structured_text(file)
        shaped = shaped_text(document, table, leave_out)
        paragraphs, notes = shaped.cells, _notes(table, table.missing(document.text))
    else:
        text = source.removeprefix(TEXT) if file is None else read_plain_text(file)
        if _is_braille(text):
            cells = "".join(BLANK if each in " \t" else each for each in text)
        else:
            cells = table.to_cells(text, leave_out)
            notes = _notes(table, table.missing(text))
        paragraphs = cells.strip("\n").split("\n")
    if not any(paragraph.strip(BLANK) for paragraph in paragraphs):
        raise BrailleError(
            "there is nothing to read: give a text, or a file with one", about="text"
        )
    return Loaded(paragraphs, pages, notes, shaped)


def write_cells(path: Path, pages: Pages, document: StructuredText | None = None) -> None:
    """Write pages of cells in the format of the file's name: .brf, .pef or .txt; a PEF names the
    title, author and language of their document."""
    suffix = path.suffix.lower()
    if suffix == ".brf":
        write_brf(path, pages)
    elif suffix == ".pef":
        of = document or StructuredText(())
        write_pef(path, pages, of.title or path.stem, of.author, of.language)
    elif suffix == ".txt":
        lines = "".join(f"{line}\n" for page in pages for line in page)
        write_bytes(path, lines.encode(), BrailleError)
    else:
        raise BrailleError(
            f"cannot write {path}: give a name that ends in .brf, .pef or .txt", about="file"
        )


def _is_braille(text: str) -> bool:
    return any(map(is_cell, text)) and all(is_cell(each) or each in " \t\n" for each in text)


def _notes(table: BrailleTable, missing: str) -> list[str]:
    notes = [table.note] if table.note else []
    if missing:
        named = " ".join(missing[:_MOST_NAMED]) + (" …" if len(missing) > _MOST_NAMED else "")
        notes.append(f"left out, as table {table.name} has no cells for them: {named}")
    return notes
