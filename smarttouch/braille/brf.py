"""Reading and writing of ASCII Braille files (BRF)."""

import codecs
import itertools
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from smarttouch.base.errors import BrailleError
from smarttouch.base.files import read_bytes
from smarttouch.braille.cells import BLANK, SIX_DOT_PATTERNS, Pages, is_cell, pattern, require_cells

MOST_BYTES = 50_000_000  # largest file; books have a few million cells

# North American Braille ASCII, in the order of the patterns 0 to 63
_CODE = " A1B'K2L@CIF/MSP\"E3H9O6R^DJG>NTQ,*5<-U8V.%[$+X!&;:4\\0Z7(_?W]#Y)="
_CELL_OF = {ord(code): chr(ord(BLANK) + k) for k, code in enumerate(_CODE)}
_CELL_OF |= {code + 32: cell for code, cell in _CELL_OF.items() if 64 <= code < 95}
"""Codes 96 to 126 have the same cells as codes 64 to 94: ``a`` has the cell of ``A``."""
_MARKS = {
    codecs.BOM_UTF8: "utf-8", codecs.BOM_UTF16_LE: "utf-16-le", codecs.BOM_UTF16_BE: "utf-16-be",
}  # fmt: skip
_NAMES = {
    "\x00": "a NUL", "\x08": "a backspace", "\t": "a tab", "\x0b": "a vertical tab",
    "\x1a": "^Z, the end of a DOS file", "\x1b": "an escape sequence for an embosser",
}  # fmt: skip
_NUMBER = "⠼(?P<number>[⠁⠃⠉⠙⠑⠋⠛⠓⠊⠚]{1,4})"
_CORNERS = {
    "right": re.compile(f"(?P<rest>.*?)(?:^|{BLANK}{{2,}}){_NUMBER}"),
    "left": re.compile(f"{_NUMBER}{BLANK}{{2,}}(?P<rest>.*)"),
}
_EDGES = {"top": 0, "bottom": -1}
_DIGITS = str.maketrans("⠁⠃⠉⠙⠑⠋⠛⠓⠊⠚", "1234567890")


def read_brf(path: Path, note: Callable[[str], None] = lambda _: None) -> Pages:
    """Read a BRF file, and remove its page numbers as `without_page_numbers` does."""
    return without_page_numbers(parse_brf(read_bytes(path, BrailleError, MOST_BYTES), path), note)


def ascii_braille(line: str) -> str:
    """Convert a line of cells to ASCII Braille. Raises BrailleError if a cell has dots 7 or 8."""
    require_cells(line)
    for column, cell in enumerate(line, 1):
        if pattern(cell) >= SIX_DOT_PATTERNS:
            raise BrailleError(
                f"{cell} (cell {column} of a line) has dots 7 or 8, which ASCII Braille cannot "
                "represent: choose a table of 6 dots"
            )
    return "".join(_CODE[pattern(cell)] for cell in line)


def format_brf(pages: Pages) -> bytes:
    """Convert pages to BRF. Raises BrailleError if a cell has dots 7 or 8."""
    # `parse_brf` skips a line break after a form feed, so add a blank to an empty first line.
    sheets = ("".join(f"{ascii_braille(line)}\r\n" for line in page) for page in pages)
    return "\f".join(re.sub(r"^\r", " \r", sheet) for sheet in sheets).encode("ascii")


def parse_brf(data: bytes, name: Path | str = "BRF") -> Pages:
    """Parse a BRF file; ``name`` is for error messages.

    Lines end with CR, LF or both. Pages end with a form feed, which can be on its own line. Padding
    by blanks, NUL and ^Z is dropped. Cells can also be Unicode Braille characters.
    """
    text = re.sub("\r\n?", "\n", _decoded(data))
    text = re.sub(r"[\x00\x1a]+(?=\s*(?:\f|\Z))", "", text).rstrip(" \n\f").removeprefix("\f")
    pages, line_number = [], 0
    for page in re.split("(\n?\f\n?)", text) if text else []:
        if page.strip("\n") == "\f":
            line_number += page.count("\n") - 1
            continue
        lines = page.split("\n")
        cells = [_cells(line, name, line_number + k) for k, line in enumerate(lines, 1)]
        line_number += len(lines)
        if page:
            pages.append(cells)
    return _without_padding(pages)


def _decoded(data: bytes) -> str:
    for mark, encoding in _MARKS.items():
        if data.startswith(mark):
            return data.removeprefix(mark).decode(encoding, "replace")
    text = data.decode("utf-8", "replace")
    return text if any(map(is_cell, text)) else data.decode("latin-1")


def _cells(line: str, name: Path | str, line_number: int) -> str:
    cells = line.translate(_CELL_OF).rstrip(BLANK)
    for column, (cell, code) in enumerate(zip(cells, line, strict=False), 1):
        if not is_cell(cell):
            number = f"byte 0x{ord(code):02X}" if ord(code) < 256 else f"U+{ord(code):04X}"
            kind = _NAMES.get(code) or (repr(code) if code.isprintable() else "a control code")
            raise BrailleError(
                f"{name}, line {line_number}, column {column}: {number} is {kind}, not ASCII "
                "Braille. Export the file again as BRF; if it is a text, rename it so that it "
                f"does not end in {Path(name).suffix or '.brf'}"
            )
    return cells


def _without_padding(pages: Pages) -> Pages:
    """Remove the empty lines that fill up pages. Keep them if no line is indented, because they can
    then separate paragraphs."""
    indents = any(line.startswith(BLANK) for page in pages for line in page)
    if indents and any(page[-2:] == ["", ""] for page in pages[:-1]):
        for page in pages[:-1]:
            while page[1:] and not page[-1]:
                page.pop()
    return pages


def without_page_numbers(pages: Pages, note: Callable[[str], None]) -> Pages:
    """Remove page numbers in the same corner of two or more pages, and repeated text beside them.

    ``note`` is called with a sentence for each corner.
    """
    for (side, corner), (edge, edge_index) in itertools.product(_CORNERS.items(), _EDGES.items()):
        lines = ((k, corner.fullmatch(page[edge_index])) for k, page in enumerate(pages) if page)
        offsets = {k: (int(line["number"].translate(_DIGITS)) - k, line["rest"].strip(BLANK))
                 for k, line in lines if line}  # fmt: skip
        counts = Counter(ahead for ahead, _ in offsets.values())
        ((first, times),) = counts.most_common(1) or [(0, 0)]
        if times < 2:
            continue
        numbered = {k: rest for k, (ahead, rest) in offsets.items() if ahead == first}
        heads = [head for head, times in Counter(numbered.values()).items() if head and times > 1]
        for k, rest in numbered.items():
            pages[k][edge_index : edge_index + 1 or None] = (
                [rest] if rest and rest not in heads else []
            )
        numbers = f"page numbers {first + min(numbered)} to {first + max(numbered)}, {edge} {side}"
        note(f"{', '.join([numbers, *heads])}, are left out")
    return pages
