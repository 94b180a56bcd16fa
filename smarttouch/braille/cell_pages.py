"""Texts and files of cells loaded, laid out as pages and lines, and written."""

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

COLUMNS = 40
ROWS = 25
"""Lines of a North American Braille page."""
INDENT = 2
"""Cells: a paragraph begins in the third and runs over in the first, as Braille is printed."""
CONTINUED = "⠐"
"""Mark at the end of a line whose last word continues: UEB's line continuation indicator."""


def lay_out(
    paragraphs: Sequence[str], columns: int = COLUMNS, rows: int = ROWS, indent: int = INDENT
) -> Pages:
    """Return paragraphs of cells as pages of lines; an empty one stays an empty line.

    Blank cells around a paragraph are dropped, and ``indent`` of them put before it; without any,
    `join` cannot separate paragraphs.
    """
    if columns < indent + 2 or rows < 1:
        raise BrailleError(
            f"a page of {columns} x {rows} cells is too small: give at least {indent + 2} columns "
            "and 1 row",
            about="page",
        )
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


def _wrap(paragraph: str, columns: int, indent: int) -> list[str]:
    lines: list[str] = []
    line = BLANK * indent
    begun = False
    for gap, word in re.findall(f"({BLANK}*)([^{BLANK}]+)", paragraph):
        if begun and not _fits(line + gap + word, columns):
            lines.append(line)
            line, begun = "", False
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
class Loaded:
    """Input as cells."""

    paragraphs: list[str]  # a line of a text, or lines that a file of cells runs over
    pages: Pages | None  # as a file of cells has them
    notes: list[str]  # warnings for the user


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
    if file is not None and kind in (FileKind.BRF, FileKind.PEF):
        pages = (read_brf if kind is FileKind.BRF else read_pef)(file)
        paragraphs = join(pages)
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
    return Loaded(paragraphs, pages, notes)


def write_cells(path: Path, pages: Pages) -> None:
    """Write pages of cells in the format of the file's name: .brf, .pef or .txt."""
    suffix = path.suffix.lower()
    if suffix == ".brf":
        write_brf(path, pages)
    elif suffix == ".pef":
        write_pef(path, pages)
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
