"""CSV file with one row for each trial, in PsychoPy's layout; each row on disk at once."""

import math
import os
from dataclasses import dataclass, fields
from pathlib import Path
from types import NoneType
from typing import Any, get_args

from smarttouch.base.errors import ExperimentError
from smarttouch.base.files import (
    MOST_TABLE_BYTES,
    open_alone,
    read_bytes,
    require_file,
    unwritable,
)
from smarttouch.base.stopping import Closing
from smarttouch.base.version import __version__
from smarttouch.experiments.fitting.answer_cells import (
    AnswerCells,
    Dialect,
    parse_cells,
    read_cells,
)

_BOM = "\N{ZERO WIDTH NO-BREAK SPACE}".encode()
"""Byte order mark by which spreadsheets detect UTF-8."""
_SAME = ("experiment", "procedure", "participant", "session", "seed")
"""Columns that are the same in all rows of a file."""


@dataclass(frozen=True)
class TrialRow:
    """One trial. The attributes are the columns of the file, in their order."""

    # repetition, trial, number, index: PsychoPy's thisRepN, thisTrialN, thisN and thisIndex:
    # repetition, trial in it, trial of all, which condition; all from 0
    repetition: int
    trial: int
    number: int
    index: int
    experiment: str
    procedure: str  # ``constant``, ``staircase`` or ``questplus``
    standard: float | None  # standard; None (an empty cell) if there is none
    comparison: float  # level, frequency or distance of what was tested
    comparison_interval: int | None  # 1 or 2; None where there are no two intervals
    unit: str  # of standard and comparison: Hz, mA, mm
    # target, response: stimulus and response as text; an empty response is none
    target: str
    response: str
    # discrimination: the comparison was judged higher or stronger. Detection: it was felt.
    # Identification: it was named. None if no answer came. 1, 0 or empty in the file.
    success: bool | None
    rt: float | None  # from the end of the stimulus to the answer
    time_s: float  # of the run, at the answer
    level: float  # amplitude that the user had chosen, 0 to 1
    # participant, session, date: participant, session, and the time it began
    participant: str
    session: str
    date: str
    seed: int  # of the order of trials
    frame_rate_hz: float | None  # PsychoPy's frameRate: sequences a second
    version: str


_PSYCHOPY = {
    "repetition": "thisRepN",
    "trial": "thisTrialN",
    "number": "thisN",
    "index": "thisIndex",
    "frame_rate_hz": "frameRate",
}
COLUMNS = {each.name: _PSYCHOPY.get(each.name, each.name) for each in fields(TrialRow)}
"""Column of each attribute."""


@dataclass(frozen=True)
class About:
    """Identity of a file: participant, session and experiment, repeated in each row."""

    experiment: str
    procedure: str
    participant: str
    session: str
    seed: int


class RowFile(Closing):
    """CSV file that rows are added to, each on disk before `append` returns.

    An existing file is continued in its own dialect if it is of the same identity. Of its content
    only a line that this program began and could not end is removed. As long as it is open no
    other run can write to it.
    """

    def __init__(self, path: Path, about: About) -> None:
        self.path: Path = path
        self.about: About = about
        self.rows: list[TrialRow] = []
        self._dialect = Dialect()
        if path.suffix.lower() != ".csv":
            raise ExperimentError(f"answers go into a .csv file, not {path}: give such a name")
        if path.exists():
            require_file(path, ExperimentError, MOST_TABLE_BYTES)
        self._file = open_alone(path, ExperimentError)
        try:
            self._begin(read_bytes(path, ExperimentError))
        except BaseException:
            self._file.close()
            raise

    def _begin(self, data: bytes) -> None:
        """Read existing lines, and go to where the next belongs."""
        head = _BOM + self._dialect.line(COLUMNS.values())
        if head.startswith(data) and data != head:
            self._write(head, 0)
            return
        cells = parse_cells(data, self.path)
        self.rows, self._dialect = _parse(cells), cells.dialect
        self._require_same(self.rows[:1] + self.rows[-1:])
        begun = cells.cut
        if self.rows and not cells.ended and not cells.cut:
            last = self.rows[-1].version
            begun = last != __version__ and __version__.startswith(last)
            del self.rows[len(self.rows) - begun :]
        if begun and not data.startswith(head):
            raise ExperimentError(
                f"{self.path} ends in a line that is not whole: complete or delete it"
            )
        end = data.rfind(b"\n") + 1 if begun else len(data)
        self._write(b"" if cells.ended or begun else self._dialect.line_end.encode(), end)

    def append(self, row: TrialRow) -> None:
        """Add one trial."""
        self._require_same([row])
        cells = [self._cell(getattr(row, name), name) for name in COLUMNS]
        self._write(self._dialect.line(cells), self._end)
        self.rows.append(row)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _write(self, data: bytes, at: int) -> None:
        """Write at a place; what a failed write left beyond it is removed."""
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

    def _cell(self, value: str | float | None, column: str) -> str:
        if value is None:
            return ""
        if isinstance(value, str):
            if "\n" in value or "\r" in value:
                raise ExperimentError(f"{column} {value!r} has a line break: leave it out")
            return value
        if not math.isfinite(value):
            raise ExperimentError(f"{column} is {value}, which no trial can be: give a number")
        return self._dialect.number(value)

    def _require_same(self, rows: list[TrialRow]) -> None:
        for row in rows:
            for name in _SAME:
                has, wanted = getattr(row, name), getattr(self.about, name)
                if has != wanted:
                    raise ExperimentError(
                        f"{self.path} has {name} {has!r}, not {wanted!r} (unless a spreadsheet has "
                        "changed it): give another file, or remove it"
                    )


def read_rows(path: Path) -> list[TrialRow]:
    """Return the trials of a file; a line that was cut off at its end is dropped."""
    return _parse(read_cells(path))


def _parse(cells: AnswerCells) -> list[TrialRow]:
    for column in COLUMNS.values():
        if column not in cells.head:
            raise ExperimentError(
                f"{cells.path} has no column {column} in its first line: give a file of answers"
            )
    kinds = {each.name: (COLUMNS[each.name], each.type) for each in fields(TrialRow)}
    return [
        TrialRow(**{
            name: _value(cells, line, column, kind) for name, (column, kind) in kinds.items()
        })
        for line in range(len(cells.lines))
    ]  # fmt: skip


def _value(cells: AnswerCells, line: int, column: str, kind: Any) -> Any:
    """Return the value in a cell; kinds are those of the attributes of `TrialRow`."""
    if kind is str:
        return cells.lines[line][1][column]
    kinds = get_args(kind) or (kind,)
    if NoneType in kinds and not cells.lines[line][1][column].strip():
        return None
    if bool in kinds:
        return bool(cells.success(line, column))
    number = cells.number(line, column)
    return int(number) if int in kinds else number
