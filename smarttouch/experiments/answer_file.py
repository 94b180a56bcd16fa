"""Answers of an experiment and their CSV file, with one row for each trial in PsychoPy's layout.

Each row is written to disk at once. Files that a spreadsheet has saved can be read and continued.
"""

import csv
import io
import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smarttouch.base import __version__
from smarttouch.base.errors import ExperimentError
from smarttouch.base.files import (
    MOST_TABLE_BYTES,
    decoded,
    finite,
    open_alone,
    read_bytes,
    require_file,
    unwritable,
)
from smarttouch.base.stopping import Closing
from smarttouch.experiments.psychometric import Array, Counts, Guess, Model

WORDS, NUMBER, OPTIONAL, ANSWER = "words", "number", "optional number", "answer"
"""Kinds of columns. Cells of the kinds `OPTIONAL` and `ANSWER` can be empty."""
COLUMNS = {
    # Counted from 0: repetition, trial in the repetition, trial in the file, and condition.
    "thisRepN": NUMBER, "thisTrialN": NUMBER, "thisN": NUMBER, "thisIndex": NUMBER,
    "experiment": WORDS, "procedure": WORDS,
    "standard": OPTIONAL,  # empty in trials without a standard
    "comparison": NUMBER,  # current, frequency, distance or softness
    "comparison_interval": OPTIONAL,  # 1 or 2; empty in trials with a single interval
    "unit": WORDS,  # unit of standard and comparison, such as Hz, mA or mm
    "target": WORDS,  # correct response
    "response": WORDS,  # empty if the participant did not answer
    "success": ANSWER,  # 1 if judged higher, felt or correct, else 0; empty without an answer
    "rt": OPTIONAL,  # reaction time from the end of the stimulus, s
    "time_s": NUMBER,  # time in the run
    "level": NUMBER,  # intensity chosen by the user, 0 to 1
    "participant": WORDS, "session": WORDS, "date": WORDS,  # date: start of the session
    "seed": NUMBER, "frameRate": OPTIONAL, "version": WORDS,
}  # fmt: skip
"""Columns of a file of answers, and the kind of each column."""
Value = str | float | None
Row = dict[str, Value]
"""Values of a row by column name."""

_BOM = "\N{ZERO WIDTH NO-BREAK SPACE}".encode()
"""Byte order mark: spreadsheets need it to detect UTF-8."""
_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
_YES = {"1", "1.0", "true", "yes", "y", "correct"}
_NO = {"0", "0.0", "false", "no", "n", "incorrect", "wrong"}
_NONE = {"", "nan", "na", "n/a", "none"}
_SPREADSHEET = "a spreadsheet may have changed it: correct it, or delete the line"


@dataclass(frozen=True)
class Dialect:
    """Cell separator, decimal separator and line break of a CSV file."""

    delimiter: str = ","
    comma: bool = False  # whether numbers have a decimal comma
    line_end: str = "\n"

    def line(self, values: Iterable[tuple[str, Value]]) -> bytes:
        """Return the values of a row as a line in UTF-8."""
        line = io.StringIO(newline="")
        writer = csv.writer(line, delimiter=self.delimiter, lineterminator=self.line_end)
        writer.writerow([self._cell(*value) for value in values])
        return line.getvalue().encode()

    def _cell(self, column: str, value: Value) -> str:
        if value is None:
            return ""
        if isinstance(value, str):
            if "\n" in value or "\r" in value:
                raise ExperimentError(f"{column} {value!r} contains a line break: remove it")
            return value
        if not math.isfinite(value):
            raise ExperimentError(f"{column} is {value}: give a finite number")
        # Convert numpy scalars, because their repr contains the type.
        text = repr(float(value)) if isinstance(value, float) else str(int(value))
        return text.replace(".", ",") if self.comma else text


@dataclass(frozen=True)
class AnswerCells:
    """Cells of all lines below the heading, by column name."""

    path: Path
    head: tuple[str, ...]
    lines: list[tuple[int, dict[str, str]]]  # line number in the file, and cells
    dialect: Dialect
    ended: bool  # whether the last line ends with a line break
    cut: bool  # whether an incomplete last line was left out

    def number(self, line: int, column: str) -> float:
        """Return the number in a cell; ``line`` is an index into `lines`."""
        value = finite(self.lines[line][1][column])
        if math.isnan(value):
            raise self._wrong(line, column, "a number")
        return value

    def success(self, line: int, column: str) -> float:
        """Return 1 or 0 from a cell, or NaN if it is empty; ``line`` is an index into `lines`."""
        word = self.lines[line][1][column].strip().lower()
        if word not in _YES | _NO | _NONE:
            raise self._wrong(line, column, "1 or 0")
        return math.nan if word in _NONE else float(word in _YES)

    def rows(self, columns: Mapping[str, str]) -> list[Row]:
        """Return all lines as rows. ``columns`` gives the kind of each column."""
        for column in columns:
            if column not in self.head:
                raise ExperimentError(
                    f"{self.path} has no column {column} in its first line: give a file of answers"
                )
        return [
            {column: self._value(line, column, kind) for column, kind in columns.items()}
            for line in range(len(self.lines))
        ]

    def _value(self, line: int, column: str, kind: str) -> Value:
        cell = self.lines[line][1][column]
        if kind == WORDS:
            return cell
        if kind in (OPTIONAL, ANSWER) and not cell.strip():
            return None
        return bool(self.success(line, column)) if kind == ANSWER else self.number(line, column)

    def _wrong(self, line: int, column: str, needed: str) -> ExperimentError:
        number, cells = self.lines[line]
        return ExperimentError(
            f"{self.path}, line {number}: {column} is {cells[column]!r}, not {needed}; "
            f"{_SPREADSHEET}"
        )


def parse_cells(data: bytes, path: Path) -> AnswerCells:
    """Parse the content of a CSV file.

    Cells are separated by comma, semicolon or tab. A decimal comma is allowed if the separator
    is not a comma. A last line with too few cells and no line break is left out.
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
            f"{path} is not a CSV file ({failure}): save it as CSV in UTF-8"
        ) from None
    if not rows:
        raise ExperimentError(f"{path} is empty: give a file of answers")
    head = tuple(map(str.strip, rows.pop(0)[1]))
    lines = []
    for number, row in rows:
        if len(row) < len(head) or any(map(str.strip, row[len(head) :])):
            raise ExperimentError(
                f"{path}, line {number}: {len(row)} cells, not {len(head)} as in the first line; "
                f"{_SPREADSHEET}"
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


class AnswerFile(Closing):
    """CSV file to which rows are appended; each row is on disk before `append` returns.

    ``about`` holds the values that are equal in all rows. The rows of an existing file must have
    these values, too. New rows keep the `Dialect` of an existing file. An incomplete last line is
    removed. An open file is locked against other runs.
    """

    def __init__(
        self, path: Path, about: Mapping[str, Value], columns: Mapping[str, str] = COLUMNS
    ) -> None:
        self.path: Path = path
        self.rows: list[Row] = []
        self._about, self._columns = about, columns
        self._dialect = Dialect()
        if path.suffix.lower() != ".csv":
            raise ExperimentError(f"{path} is not a .csv file: choose a name that ends in .csv")
        if path.exists():
            require_file(path, ExperimentError, MOST_TABLE_BYTES)
        self._file = open_alone(path, ExperimentError)
        try:
            self._begin(read_bytes(path, ExperimentError))
        except BaseException:
            self._file.close()
            raise

    def _begin(self, data: bytes) -> None:
        """Read existing rows. Write a missing heading, and remove an incomplete last line."""
        head = _BOM + self._dialect.line((column, column) for column in self._columns)
        if head.startswith(data) and data != head:
            self._write(head, 0)
            return
        cells = parse_cells(data, self.path)
        self.rows, self._dialect = cells.rows(self._columns), cells.dialect
        for row in self.rows[:1] + self.rows[-1:]:
            self._require_same(row)
        begun = cells.cut
        if self.rows and not cells.ended and not cells.cut:
            last = str(self.rows[-1]["version"])
            begun = last != __version__ and __version__.startswith(last)
            del self.rows[len(self.rows) - begun :]
        if begun and not data.startswith(head):
            raise ExperimentError(f"last line of {self.path} is incomplete: complete or delete it")
        end = data.rfind(b"\n") + 1 if begun else len(data)
        self._write(b"" if cells.ended or begun else self._dialect.line_end.encode(), end)

    def append(self, row: Row) -> None:
        """Append the row of one trial, completed by the values of ``about`` and the version."""
        row = {**dict.fromkeys(self._columns), "version": __version__, **self._about, **row}
        self._write(
            self._dialect.line((column, row[column]) for column in self._columns), self._end
        )
        self.rows.append(row)

    def close(self) -> None:
        self._file.close()

    def _write(self, data: bytes, at: int) -> None:
        """Write at an offset, after removing all bytes beyond the offset."""
        try:
            if self._file.seek(0, os.SEEK_END) > at:
                self._file.truncate(at)
            self._file.seek(at)
            self._file.write(data)
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise unwritable(ExperimentError, self.path, error) from None
        self._end = at + len(data)

    def _require_same(self, row: Row) -> None:
        for name, value in self._about.items():
            if row[name] != value:
                raise ExperimentError(
                    f"{self.path} has {name} {row[name]!r}, not {value!r} (a spreadsheet may have "
                    "changed it): give another file, or remove this one"
                )


@dataclass(frozen=True, eq=False)
class Answers:
    """All trials with one standard, in order of presentation."""

    standard: float  # standard of the comparisons; 0 if there is none
    comparison: Array  # (N,): comparison of each trial, in the unit of the standard
    success: Array  # (N,): 1 if judged higher, felt or correct, else 0; NaN without an answer
    # (N,): interval of the comparison, 1 or 2; 0 in trials with a single interval
    interval: NDArray[np.int64]
    alternatives: int = 0  # number of responses to choose from; 0 for *yes* or *no*, or if unknown

    @property
    def presented(self) -> int:
        """Number of trials."""
        return len(self.success)

    @property
    def answered(self) -> int:
        """Number of trials with an answer."""
        return int(np.isfinite(self.success).sum())

    def chosen(self) -> tuple[int, int]:
        """Return how often the participant chose the first and the second interval."""
        two = np.isfinite(self.success) & (self.interval > 0)
        chosen = np.where(self.success == 1, self.interval, 3 - self.interval)[two]
        return int((chosen == 1).sum()), int((chosen == 2).sum())

    def counts(self) -> Counts:
        """Return the answered trials and the successes at each comparison."""
        is_answered = np.isfinite(self.success)
        stimulus, which = np.unique(self.comparison[is_answered], return_inverse=True)
        n, k = np.zeros(len(stimulus)), np.zeros(len(stimulus))
        np.add.at(n, which, 1.0)
        np.add.at(k, which, self.success[is_answered])
        return Counts(stimulus, n, k)


def usual_model(
    all_answers: Sequence[Answers],  # one for each standard
    guess: Guess | None = None,  # see `Model.guess`; None: chosen from the answers
    at: float | None = None,  # share of successes at the threshold, see `Model`
) -> Model:
    """Choose the psychometric model from the kind of answers."""
    stimulus = np.concatenate([answers.comparison for answers in all_answers])
    signed = bool((stimulus < 0).any())
    if guess is None:
        alternatives = max(answers.alternatives for answers in all_answers)
        if signed or any(answers.standard for answers in all_answers):
            guess = "equal"
        elif alternatives:
            guess = 1 / alternatives
        else:
            guess = "free" if (stimulus == 0).any() else 0.0
    return Model(guess, at, logarithmic=not signed)


@dataclass(frozen=True, eq=False)
class AnswerTable:
    """Answers of one file."""

    name: str  # name of the file, without suffix
    unit: str  # unit of standards and comparisons; empty if unknown
    answers: tuple[Answers, ...]  # one for each standard, ascending
    cut: bool = False  # whether an incomplete last line was left out


def read_table(
    path: Path,
    x: str = "comparison",  # name of the column of comparisons
    y: str = "success",  # name of the column of answers
) -> AnswerTable:
    """Read comparisons and answers from a CSV file, see `parse_cells`.

    A success is 1, true, yes or correct. A failure is 0, false, no or incorrect. An empty cell
    means no answer. Columns `standard`, `comparison_interval` and `response` are optional.
    """
    table = parse_cells(read_bytes(path, ExperimentError), path)
    for option, name in (("x", x), ("y", y)):
        if name not in table.head:
            raise ExperimentError(
                f"{path} has no column {name!r} for {option}: choose {' or '.join(table.head)}"
            )

    def number(line: int, column: str) -> float:
        return table.number(line, column) if table.lines[line][1].get(column, "").strip() else 0.0

    if not table.lines:
        raise ExperimentError(f"{path} has no trials below its heading: give a file with answers")
    rows = np.array([
        (number(line, "standard"), table.number(line, x), table.success(line, y),
         number(line, "comparison_interval"))
        for line in range(len(table.lines))
    ])  # fmt: skip
    cells = [cell_row for _, cell_row in table.lines]
    alternatives = _alternatives(cells)
    tables = []
    for standard in np.unique(rows[:, 0]):
        _, comparison, success, interval = rows[rows[:, 0] == standard].T
        tables.append(
            Answers(float(standard), comparison, success, interval.astype(np.int64), alternatives)
        )
    units = {cell_row.get("unit", "").strip() for cell_row in cells}
    return AnswerTable(path.stem, units.pop() if len(units) == 1 else "", tuple(tables), table.cut)


def _alternatives(lines: list[dict[str, str]]) -> int:
    """Return the number of responses to choose from; 0 for *yes* or *no*, or if unknown."""
    if any(cells.get("comparison_interval") for cells in lines):
        return 2
    responses = {cells.get("response", "") for cells in lines}
    shown = {cells.get("target", "") for cells in lines} if responses - {""} else set()
    return 0 if responses - {""} <= {"y", "n"} else max(2, len(responses | shown - {""}))
