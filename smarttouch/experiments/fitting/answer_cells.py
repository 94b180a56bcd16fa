"""Cells of a CSV file of answers, as it was written or as a spreadsheet has saved it."""

import csv
import io
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from smarttouch.base.errors import ExperimentError
from smarttouch.base.files import decoded, read_bytes
from smarttouch.base.tables import finite

_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
_YES = {"1", "1.0", "true", "yes", "y", "correct"}
_NO = {"0", "0.0", "false", "no", "n", "incorrect", "wrong"}
_NONE = {"", "nan", "na", "n/a", "none"}
SPREADSHEET = "a spreadsheet may have changed it: correct it, or delete the line"


@dataclass(frozen=True)
class Dialect:
    """How cells, numbers and lines end in a file."""

    delimiter: str = ","
    comma: bool = False  # whether numbers have a decimal comma
    line_end: str = "\n"

    def line(self, cells: Iterable[str]) -> bytes:
        """Return a line of the file, in UTF-8."""
        line = io.StringIO(newline="")
        csv.writer(line, delimiter=self.delimiter, lineterminator=self.line_end).writerow(cells)
        return line.getvalue().encode()

    def number(self, value: float) -> str:
        """Return the text of a number, with all its digits."""
        # What comes from numpy would be written with its type's name.
        text = repr(float(value)) if isinstance(value, float) else str(int(value))
        return text.replace(".", ",") if self.comma else text


@dataclass(frozen=True)
class AnswerCells:
    """Cells of the lines below the first, by the names of their columns."""

    path: Path
    head: tuple[str, ...]
    lines: list[tuple[int, dict[str, str]]]  # number in the file, cells
    dialect: Dialect
    ended: bool  # whether the last line has its end
    cut: bool  # whether a last line without an end and with too few cells was left out

    def number(self, line: int, column: str) -> float:
        """Return the number in a cell of the line of this index."""
        number, cells = self.lines[line]
        value = finite(cells[column])
        if math.isnan(value):
            raise ExperimentError(
                f"{self.path}, line {number}: {column} is {cells[column]!r}, not a number; "
                f"{SPREADSHEET}"
            )
        return value

    def success(self, line: int, column: str) -> float:
        """Return 1, 0, or NaN for no answer, of a cell of the line of this index."""
        number, cells = self.lines[line]
        word = cells[column].strip().lower()
        if word in _NONE:
            return math.nan
        if word not in _YES | _NO:
            raise ExperimentError(
                f"{self.path}, line {number}: {column} is {cells[column]!r}, not 1 or 0; "
                f"{SPREADSHEET}"
            )
        return float(word in _YES)


def read_cells(path: Path) -> AnswerCells:
    """Read a file of answers; raises an ExperimentError if it is none."""
    return parse_cells(read_bytes(path, ExperimentError), path)


def parse_cells(data: bytes, path: Path) -> AnswerCells:
    """Return the cells in the content of a file.

    Comma, semicolon or tab separate the cells; between semicolons and tabs a decimal comma is one.
    Lines end by any line break. A last line without one was cut off if it has too few cells.
    """
    end = max(data.rfind(b"\n"), data.rfind(b"\r")) + 1
    first = data.split(b"\n", 1)[0].split(b"\r", 1)[0].decode(errors="replace")
    delimiter = max((",", ";", "\t"), key=first.count)
    last = next(csv.reader([data[end:].decode(errors="replace")], delimiter=delimiter), [])
    cut = 0 < len(last) <= first.count(delimiter) and end > 0
    text = decoded(data[:end] if cut else data, path, ExperimentError)
    try:
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
        rows = [(reader.line_num, row) for row in reader if any(map(str.strip, row))]
    except csv.Error as failure:
        raise ExperimentError(
            f"{path} is no CSV file ({failure}): save it as one in UTF-8"
        ) from None
    if not rows:
        raise ExperimentError(f"{path} is empty: give a file of answers")
    head = tuple(map(str.strip, rows.pop(0)[1]))
    lines = []
    for number, row in rows:
        if len(row) < len(head) or any(map(str.strip, row[len(head) :])):
            raise ExperimentError(
                f"{path}, line {number}: {len(row)} cells, not {len(head)} as in the first line; "
                f"{SPREADSHEET}"
            )
        lines.append((number, dict(zip(head, row, strict=False))))
    comma = False
    for _, cells in lines if delimiter != "," else ():
        for name, cell in cells.items():
            if _COMMA.fullmatch(cell.strip()):
                cells[name], comma = cell.replace(",", "."), True
    line_end = "\r\n" if "\r\n" in text else "\r" if "\r" in text and "\n" not in text else "\n"
    return AnswerCells(
        path, head, lines, Dialect(delimiter, comma, line_end), end == len(data), cut
    )
