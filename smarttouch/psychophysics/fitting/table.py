"""Reader of answers from CSV files: ours, and others with a comparison and a success."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from smarttouch.errors import ExperimentError
from smarttouch.files import read_text
from smarttouch.psychophysics.fitting.answers import Answers
from smarttouch.tables import finite, parse_csv

_DELIMITERS = (",", ";", "\t")
_YES = {"1", "1.0", "true", "yes", "y", "correct"}
_NO = {"0", "0.0", "false", "no", "n", "incorrect", "wrong"}
_NONE = {"", "nan", "na", "n/a", "none"}
_Cells = dict[str, str]


@dataclass(frozen=True, eq=False)
class Table:
    """The answers of one file."""

    name: str  # of the file, without its ending
    unit: str  # of standards and comparisons, if it says so
    answers: tuple[Answers, ...]  # to each standard, rising


def read_table(
    path: Path,
    # x, y, standard: columns of comparison, success and standard; the last need not be there. The
    # interval of the comparison (`comparison_interval`) and the words answered (`response`) are
    # used if there are such columns.
    x: str = "comparison",
    y: str = "success",
    standard: str = "standard",
) -> Table:
    """Read comparisons and answers.

    Comma, semicolon or tab separate the cells. With a semicolon a decimal comma is one. An answer
    is 1, true, yes, correct or their contraries; an empty cell is none. If the file does not end
    in a line break its last line was cut off where it has fewer cells than the others: it is
    dropped.
    """
    head, lines = _cells(path)
    for parameter, name in (("x", x), ("y", y), ("standard", standard)):
        if name not in head and name != "standard":
            raise ExperimentError(
                f"{path} has no column {name!r} for {parameter}: choose {' or '.join(head)}",
                about=parameter,
            )
    rows = []
    for number, cells in lines:
        where = f"{path}, line {number}"
        interval = cells.get("comparison_interval", "")
        rows.append(
            (
                _number(cells.get(standard, ""), where, standard) if cells.get(standard) else 0.0,
                _number(cells[x], where, x),
                _success(cells[y], where, y),
                int(_number(interval, where, "comparison_interval")) if interval else 0,
            )
        )
    if not rows:
        raise ExperimentError(
            f"{path} has no trials below its first line: give one that has", about="file"
        )
    table = np.array(rows, np.float64)
    alternatives = _alternatives([cells for _, cells in lines])
    found = []
    for each in np.unique(table[:, 0]):
        _, comparison, success, interval = table[table[:, 0] == each].T
        found.append(
            Answers(float(each), comparison, success, interval.astype(np.int64), alternatives)
        )
    units = {cells.get("unit", "") for _, cells in lines}
    return Table(path.stem, units.pop() if len(units) == 1 else "", tuple(found))


def _cells(path: Path) -> tuple[tuple[str, ...], list[tuple[int, _Cells]]]:
    """Return names of columns, and the cells of each line with its number in the file."""
    text = read_text(path, ExperimentError)
    first = text.partition("\n")[0]
    delimiter = max(_DELIMITERS, key=first.count)
    table = parse_csv(text, path, ExperimentError, delimiter, strict=True)
    head, rows = table.head, table.rows
    if not head:
        raise ExperimentError(f"{path} is empty: give a file of answers", about="file")
    if rows and not text.endswith("\n") and len(rows[-1]) < len(head):
        rows.pop()
    found = []
    for number, row in zip(table.lines, rows, strict=False):
        if len(row) < len(head):
            raise ExperimentError(
                f"{path}, line {number}: {len(row)} cells, not {len(head)} as in the first line; "
                "correct or delete it",
                about="line",
            )
        cells = dict(zip(head, map(str.strip, row), strict=False))
        if delimiter == ";":
            cells = {name: cell.replace(",", ".") for name, cell in cells.items()}
        found.append((number, cells))
    return head, found


def _number(text: str, where: str, column: str) -> float:
    number = finite(text)
    if math.isnan(number):
        raise ExperimentError(
            f"{where}: {column} is {text!r}, not a number; correct or delete it", about=column
        )
    return number


def _success(text: str, where: str, column: str) -> float:
    word = text.lower()
    if word in _NONE:
        return math.nan
    if word not in _YES | _NO:
        raise ExperimentError(
            f"{where}: {column} is {text!r}, not 1 or 0; name another column for y",
            about=column,
            remedy="y",
        )
    return float(word in _YES)


def _alternatives(lines: list[_Cells]) -> int:
    """Return the number of alternatives; 0 if *yes* and *no*, or not known."""
    if any(cells.get("comparison_interval") for cells in lines):
        return 2
    said = {cells.get("response", "") for cells in lines}
    shown = {cells.get("target", "") for cells in lines} if said - {""} else set()
    if said - {""} <= {"y", "n"}:
        return 0
    return max(2, len(said | shown - {""}))
