"""Input of texts and files of cells, and output of cells."""

import re
from dataclasses import dataclass
from pathlib import Path

from smarttouch.braille.brf import read_brf, write_brf
from smarttouch.braille.cells import BLANK, Pages, is_cell
from smarttouch.braille.files import Kind, kind_of, read_plain_text
from smarttouch.braille.layout import join
from smarttouch.braille.pef import read_pef, write_pef
from smarttouch.braille.tables import BrailleTable
from smarttouch.errors import BrailleError
from smarttouch.files import write_bytes

TEXT = "text:"
"""Prefix of words that are not a file name."""
_NAME = re.compile(r"\.{0,2}/\S+|\S*\.[A-Za-z]\w{1,3}")
"""A word that ends like a file name or begins like a path."""
_MOST_NAMED = 12  # characters listed in a note on left-out ones


@dataclass(frozen=True)
class Loaded:
    """Input as cells."""

    paragraphs: list[str]  # a line of a text, or lines that a file of cells runs over
    pages: Pages | None  # as a file of cells has them
    notes: list[str]  # warnings for the user


def file_of(source: str) -> Path | None:
    """Return the file that a source names, None if words; a missing file's name is an error."""
    if source.startswith(TEXT) or not source:
        return None
    try:
        there = Path(source).exists()
    except (OSError, ValueError):
        return None
    if not there and _NAME.fullmatch(source):
        raise BrailleError(
            f"there is no file {source}: check its name, or give {TEXT}{source} for these words",
            about="file",
        )
    return Path(source) if there else None


def load_cells(source: str, table: BrailleTable, leave_out: bool = False) -> Loaded:
    """Load cells from a text or a file of cells, and translate text with the table.

    ``source`` is the name of a file, ``text:`` and words, or words that name no file; a text may
    consist of cells only. ``leave_out`` drops and notes the characters without cells.
    """
    file = file_of(source)
    kind = None if file is None else kind_of(file)
    pages: Pages | None = None
    notes: list[str] = []
    if file is not None and kind in (Kind.BRF, Kind.PEF):
        pages = (read_brf if kind is Kind.BRF else read_pef)(file)
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
