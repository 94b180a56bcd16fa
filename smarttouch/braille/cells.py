"""Cells of Braille, their dots, and files of them: BRF."""

from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import BrailleError
from smarttouch.base.files import read_bytes

Pages: TypeAlias = list[list[str]]  # pages of lines of cells

BLANK = "\u2800"
"""The cell without a dot; the pattern of a cell is its distance from it, bit k is dot k + 1."""
PATTERNS = 256
SIX_DOT_PATTERNS = 64

POSITION = np.array([(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (0, 3), (1, 3)])
"""(8, 2) int, column and row of dots 1 to 8: 1 to 3 run down on the left, 7 and 8 lie below."""


def is_cell(character: str) -> bool:
    """Return whether a character is a cell."""
    return 0 <= ord(character) - ord(BLANK) < PATTERNS


def pattern(cell: str) -> int:
    """Return the dots of a cell as a number from 0 to 255: bit k is dot k + 1."""
    return ord(cell) - ord(BLANK)


def require_cells(line: str) -> None:
    """Raise unless a line consists of cells."""
    for column, character in enumerate(line):
        if not is_cell(character):
            raise BrailleError(
                f"{character!r} at position {column + 1} is not a Braille cell: give characters "
                "U+2800 to U+28FF"
            )


def cells_to_dots(cells: str) -> NDArray[np.bool_]:
    """Return the dots of a line of cells, (N, 8) bool; column k is dot k + 1."""
    require_cells(cells)
    patterns = np.array([pattern(cell) for cell in cells], np.uint8)
    return np.unpackbits(patterns[:, None], axis=1, bitorder="little").astype(bool)


def dots_to_cells(dots: NDArray[Any]) -> str:
    """Return a line of cells from its dots, (N, 8) or (N, 6) bool; column k is dot k + 1."""
    if dots.ndim != 2 or dots.shape[1] not in (6, 8):
        raise BrailleError(f"dots of shape {dots.shape} are not cells: give (N, 6) or (N, 8)")
    patterns = np.packbits(dots.astype(bool), axis=1, bitorder="little")
    return "".join(chr(ord(BLANK) + int(each)) for each in patterns.ravel())


MOST_BYTES = 50_000_000  # largest file; a book has a few million cells

# North American Braille ASCII, as printers take it; in the order of the patterns 0 to 63.
_CODE = " A1B'K2L@CIF/MSP\"E3H9O6R^DJG>NTQ,*5<-U8V.%[$+X!&;:4\\0Z7(_?W]#Y)="
_CELL_OF = {ord(each): chr(ord(BLANK) + k) for k, each in enumerate(_CODE)}
_CELL_OF |= {code + 32: cell for code, cell in _CELL_OF.items() if 64 <= code < 95}
"""Extension to the lower case of each code."""


def read_brf(path: Path) -> Pages:
    """Read a BRF file."""
    return parse_brf(read_bytes(path, BrailleError, MOST_BYTES), str(path))


def format_brf(pages: Pages) -> bytes:
    """Return pages in BRF; raise if a cell has dots 7 or 8, which it cannot hold."""
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
                "choose a table of 6 dots"
            )
    return "".join(_CODE[pattern(cell)] for cell in line)


def _cells(line: str, name: str, count: int) -> str:
    cells = line.translate(_CELL_OF)
    for column, (cell, code) in enumerate(zip(cells, line, strict=True), 1):
        if ord(cell) < ord(BLANK):
            raise BrailleError(
                f"{name}, line {count}, column {column}: {code!r} is not ASCII Braille: is this a "
                "BRF file?"
            )
    return cells
