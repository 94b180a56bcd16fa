"""Texts, documents and files of cells loaded, and pages of cells written."""

from dataclasses import dataclass
from pathlib import Path

from smarttouch.base.errors import BrailleError
from smarttouch.base.files import named_file, write_bytes
from smarttouch.braille.block_layout import (
    COLUMNS,
    INDENT,
    ROWS,
    ShapedText,
    blanks,
    is_braille,
    join,
    lay_out,
    lay_out_blocks,
    text_of_cells,
)
from smarttouch.braille.cells import (
    BLANK,
    Pages,
    read_brf,
    read_pef,
    write_brf,
    write_pef,
)
from smarttouch.braille.code_tables import BrailleTable
from smarttouch.braille.ebraille import write_ebraille
from smarttouch.pages.file_kinds import FileKind, file_kind, read_plain_text
from smarttouch.pages.pandoc_text import read_pandoc_text
from smarttouch.pages.structured_text import StructuredText

TEXT = "text:"  # prefix of words that are not a file name
_MOST_NAMED = 12  # characters listed in a note on left-out ones


@dataclass(frozen=True)
class Loaded:
    """Input as cells."""

    paragraphs: list[str]  # a line of a text, or lines that a file of cells runs over
    pages: Pages | None  # as a file of cells has them
    notes: list[str]  # warnings for the user
    shaped: ShapedText | None = None  # of a document with headings, lists and tables

    def document(self, table: BrailleTable) -> ShapedText:
        """Return it as a document, of paragraphs only if it is a text or a file of cells."""
        return self.shaped or text_of_cells(self.paragraphs, table)


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
        if file is not None and kind is FileKind.STRUCTURED:
            text = read_pandoc_text(file, notes.append)
        else:
            text = source.removeprefix(TEXT) if file is None else read_plain_text(file)
        if is_braille(text):
            cells = blanks(text)
        else:
            cells = table.to_cells(text, leave_out)
            notes += _notes(table, table.missing(text))
        paragraphs = cells.strip("\n").split("\n")
    if not any(paragraph.strip(BLANK) for paragraph in paragraphs):
        raise BrailleError(
            "there is nothing to read: give a text, or a file with one", about="text"
        )
    return Loaded(paragraphs, pages, notes)


def laid_out(loaded: Loaded, columns: int | None, rows: int | None, shown: bool = False) -> Pages:
    """Return pages of so many cells and lines, by default those of its file, or 40 and 25.

    What is ``shown`` on a screen has no numbers, and its paragraphs no indent.
    """
    wide, high = (COLUMNS if columns is None else columns), (ROWS if rows is None else rows)
    if loaded.shaped is not None and not shown:
        return lay_out_blocks(loaded.shaped, wide, high)
    if loaded.pages is None or columns is not None or rows is not None:
        return lay_out(loaded.paragraphs, wide, high, 0 if shown else INDENT)
    return loaded.pages


def write_cells(
    path: Path, pages: Pages, of: ShapedText | None = None, complete: bool = True
) -> list[str]:
    """Write cells in the format of the file's name, and return notes.

    A .brf, .pef or .txt has ``pages``, an .ebrl the document that they are ``of``, ``complete`` if
    it is the whole one; it and a .pef name the document's title, author and language.
    """
    suffix = path.suffix.lower()
    about = of.document if of is not None else StructuredText(())
    if suffix == ".brf":
        write_brf(path, pages)
    elif suffix == ".pef":
        write_pef(path, pages, about.title or path.stem, about.author, about.language)
    elif suffix == ".ebrl" and of is not None:
        return write_ebraille(path, of, complete)
    elif suffix == ".txt":
        lines = "".join(f"{line}\n" for page in pages for line in page)
        write_bytes(path, lines.encode(), BrailleError)
    else:
        raise BrailleError(
            f"cannot write {path}: give a name that ends in .brf, .pef, .ebrl or .txt",
            about="file",
        )
    return []


def _notes(table: BrailleTable, missing: str) -> list[str]:
    notes = [table.note] if table.note else []
    if missing:
        named = " ".join(missing[:_MOST_NAMED]) + (" …" if len(missing) > _MOST_NAMED else "")
        notes.append(f"left out, as table {table.name} has no cells for them: {named}")
    return notes
