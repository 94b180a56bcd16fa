"""BRF files for Braille printers: North American ASCII Braille, pages separated by form feeds."""

from pathlib import Path

from smarttouch.braille.cells import BLANK, SIX_DOT_PATTERNS, Pages, pattern, require_cells
from smarttouch.braille.files import MOST_BYTES
from smarttouch.errors import BrailleError
from smarttouch.files import read_bytes, write_bytes

# North American Braille ASCII, as printers take it; in the order of the patterns 0 to 63.
_CODE = " A1B'K2L@CIF/MSP\"E3H9O6R^DJG>NTQ,*5<-U8V.%[$+X!&;:4\\0Z7(_?W]#Y)="
_CELL_OF = {ord(each): chr(ord(BLANK) + k) for k, each in enumerate(_CODE)}
_CELL_OF |= {code + 32: cell for code, cell in _CELL_OF.items() if 64 <= code < 95}
"""Extension to the lower case of each code."""


def read_brf(path: Path) -> Pages:
    """Read a BRF file."""
    return parse_brf(read_bytes(path, BrailleError, MOST_BYTES), str(path))


def write_brf(path: Path, pages: Pages) -> None:
    """Write a BRF file; raise if a cell has dots 7 or 8, which BRF cannot hold."""
    write_bytes(path, format_brf(pages), BrailleError)


def format_brf(pages: Pages) -> bytes:
    """Return pages in BRF."""
    sheets = []
    for number, page in enumerate(pages, 1):
        lines = [_codes(line, f"page {number}, line {k}") for k, line in enumerate(page, 1)]
        sheets.append("".join(f"{line}\r\n" for line in lines))
    return "\f".join(sheets).encode("ascii")


def parse_brf(data: bytes, name: str = "BRF") -> Pages:
    """Return the pages of a BRF file; ``name`` is for error messages."""
    # A DOS file may end in ^Z, and a page in a form feed.
    text = data.removesuffix(b"\x1a").decode("latin-1").replace("\r\n", "\n")
    pages, count = [], 0
    for page in text.removesuffix("\f").split("\f") if text else []:
        lines = page.split("\n")
        if lines[-1] == "":
            lines.pop()
        pages.append([_cells(line, name, count + k) for k, line in enumerate(lines, 1)])
        count += len(lines)
    return pages


def _codes(line: str, where: str) -> str:
    require_cells(line)
    for column, cell in enumerate(line, 1):
        if pattern(cell) >= SIX_DOT_PATTERNS:
            raise BrailleError(
                f"{cell} ({where}, cell {column}) has dots 7 or 8, which BRF files cannot hold: "
                "write a .pef file, or choose a table of 6 dots",
                about="cell",
            )
    return "".join(_CODE[pattern(cell)] for cell in line)


def _cells(line: str, name: str, count: int) -> str:
    cells = line.translate(_CELL_OF)
    for column, (cell, code) in enumerate(zip(cells, line, strict=True), 1):
        if ord(cell) < ord(BLANK):
            raise BrailleError(
                f"{name}, line {count}, column {column}: {code!r} is not ASCII Braille: is this a "
                "BRF file?",
                about="cell",
            )
    return cells
