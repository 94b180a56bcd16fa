"""Tables in CSV files, checked as they are read."""

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import SmartTouchError
from smarttouch.base.files import read_text


@dataclass(frozen=True, eq=False)
class CsvTable:
    """Rows of a CSV file below its heading, with their line numbers; blank ones are left out."""

    path: Path
    error: type[SmartTouchError]
    head: tuple[str, ...]
    rows: list[list[str]]
    lines: list[int]

    def numbers(
        self, names: Sequence[str], fewest: int = 2, rising: bool = True
    ) -> NDArray[np.float64]:
        """Return the named columns of numbers, (N, len(names)); the first must rise, if ``rising``.

        Raises the error of the table about ``columns``, ``rows`` or a ``line``.
        """
        if not set(names) <= set(self.head):
            message = (
                f"{self.path} has the columns {', '.join(self.head) or 'none'}: its first line "
                f"must name {', '.join(names)}"
            )
            raise self.error(message)
        places = [self.head.index(name) for name in names]
        values = np.array([self._row(row, places) for row in range(len(self.rows))])
        if len(values) < fewest:
            message = f"{self.path} has {len(values)} rows of numbers: give {fewest} or more"
            raise self.error(message)
        falls = np.flatnonzero(np.diff(values[:, 0]) <= 0)
        if rising and len(falls):
            row = int(falls[0]) + 1
            now, before = values[row, 0], values[row - 1, 0]
            words = f"{names[0]} {now:g} is not above the {before:g} before it: it must rise"
            raise self.wrong(row, words)
        return values

    def wrong(self, row: int, words: str) -> SmartTouchError:
        """Return the error of a row, with its line."""
        line = self.lines[row]
        message = f"{self.path}, line {line}: {words}"
        return self.error(message)

    def _row(self, row: int, places: list[int]) -> list[float]:
        cells = self.rows[row]
        # A decimal comma shows as one cell too many, and moves all others.
        if any(map(str.strip, cells[len(self.head) :])):
            raise self.wrong(row, f"{len(cells)} cells, where the heading has {len(self.head)}")
        cells = cells + [""] * (len(self.head) - len(cells))
        numbers = [finite(cells[place]) for place in places]
        for place, number in zip(places, numbers, strict=True):
            if math.isnan(number):
                words = f"{self.head[place]} is {cells[place]!r}, not a number: correct it"
                raise self.wrong(row, words)
        return numbers


def read_csv(path: Path, error: type[SmartTouchError]) -> CsvTable:
    """Read a table of cells between commas; raises the given type of error."""
    try:
        reader = csv.reader(io.StringIO(read_text(path, error), newline=""))
        found = [(reader.line_num, row) for row in reader if any(map(str.strip, row))]
    except csv.Error as failure:
        message = f"{path} is no CSV file ({failure}): save it as one in UTF-8"
        raise error(message) from None
    lines, (head, *rows) = [line for line, _ in found[1:]], [row for _, row in found] or [[]]
    return CsvTable(path, error, tuple(map(str.strip, head)), rows, lines)


def finite(text: str) -> float:
    """Return the number in a cell; NaN where there is none, or an infinite one."""
    try:
        number = float(text)
    except ValueError:
        return math.nan
    return number if math.isfinite(number) else math.nan
