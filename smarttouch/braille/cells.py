"""Braille cells and their dots."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import BrailleError

Pages: TypeAlias = list[list[str]]  # pages of lines of cells

BLANK = "\u2800"
"""The empty cell. It has the smallest character code of all cells."""
PATTERNS = 256
SIX_DOT_PATTERNS = 64

POSITION = np.array([(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (0, 3), (1, 3)])
"""(8, 2) int: column and row of dots 1 to 8."""


def is_cell(character: str) -> bool:
    """Return whether a character is a Braille cell (U+2800 to U+28FF)."""
    return 0 <= ord(character) - ord(BLANK) < PATTERNS


def pattern(cell: str) -> int:
    """Return the dots of a cell as a number from 0 to 255. Bit k is 1 if the cell has dot k + 1."""
    return ord(cell) - ord(BLANK)


def require_cells(line: str) -> None:
    """Raise BrailleError unless a line consists of cells."""
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
    """Return the cells for dots, (N, 8) or (N, 6) bool; column k is dot k + 1."""
    if dots.ndim != 2 or dots.shape[1] not in (6, 8):
        raise BrailleError(f"dots of shape {dots.shape} are not cells: give (N, 6) or (N, 8)")
    patterns = np.packbits(dots.astype(bool), axis=1, bitorder="little")
    return "".join(chr(ord(BLANK) + int(pattern)) for pattern in patterns.ravel())
