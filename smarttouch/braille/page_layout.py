"""Break paragraphs of Braille cells into lines and pages, and join lines to paragraphs again."""

import re
from collections.abc import Sequence

from smarttouch.base.errors import BrailleError
from smarttouch.braille.cells import BLANK, Pages

COLUMNS = 40
ROWS = 25  # lines of a North American Braille page
INDENT = 2
"""Number of blank cells before a paragraph: in Braille, a paragraph usually begins in cell 3."""
CONTINUED = "⠐"
"""UEB's line continuation indicator, at the end of a line that divides a word."""


def lay_out(
    paragraphs: Sequence[str], columns: int = COLUMNS, rows: int = ROWS, indent: int = INDENT
) -> Pages:
    """Lay out paragraphs of cells as pages of lines; an empty paragraph becomes an empty line.
    Blank cells at both ends of a paragraph are removed, and ``indent`` blank cells are put before
    its first line. If ``indent`` is 0, `join` cannot find the paragraphs again."""
    if columns < indent + 2 or rows < 1:
        raise BrailleError(
            f"a page of {columns} x {rows} cells is too small: give at least {indent + 2} columns "
            "and 1 row"
        )
    lines = [line for paragraph in paragraphs for line in _wrap(paragraph, columns, indent)]
    return [lines[first : first + rows] for first in range(0, len(lines), rows)]


def join(pages: Pages, columns: int | None = None) -> list[str]:
    """Join lines of pages to paragraphs. A paragraph begins at a line that starts with a blank cell
    or follows an empty line."""
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
    """Return whether a line is full and ends with the continuation indicator."""
    return len(line) == columns and line.endswith(CONTINUED)
