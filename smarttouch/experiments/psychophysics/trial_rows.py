"""CSV file with one row for each trial, in PsychoPy's layout; each row on disk at once."""

import csv
import io
import math
import os
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from types import NoneType
from typing import Any, get_args

from smarttouch.base.errors import ExperimentError
from smarttouch.base.files import (
    MOST_TABLE_BYTES,
    decoded,
    open_alone,
    read_bytes,
    require_file,
    unwritable,
)
from smarttouch.base.stopping import Closing
from smarttouch.base.tables import parse_csv


def read_cell(text: str, kind: Any) -> str | bool | float | None:
    """Return the value in a cell; kinds are those of the attributes of `TrialRow`."""
    if kind is str:
        return text
    kinds = get_args(kind) or (kind,)
    if not text and NoneType in kinds:
        return None
    if bool in kinds:
        return bool(("0", "1").index(text))
    if int in kinds:
        return int(text)
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(text)
    return number


def write_cell(value: str | float | None, column: str) -> str:
    """Return the text of a cell."""
    if isinstance(value, str):
        if "\n" in value or "\r" in value:
            raise ExperimentError(f"{column} {value!r} has a line break: leave it out")
        return value
    if value is None:
        return ""
    if not math.isfinite(value):
        raise ExperimentError(f"{column} is {value}, which no trial can be: give a number")
    # What comes from numpy would be written with its type's name.
    return repr(float(value)) if isinstance(value, float) else str(int(value))


def write_line(cells: Iterable[str]) -> bytes:
    """Return a line of the file, in UTF-8."""
    line = io.StringIO(newline="")
    csv.writer(line, lineterminator="\n").writerow(cells)
    return line.getvalue().encode()


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

    An existing file is continued if it is of the same identity; a line that was cut off when a
    program was killed is dropped from it first. As long as it is open no other run can write to it.
    """

    def __init__(self, path: Path, about: About, overwrite: bool = False) -> None:
        self.path: Path = path
        self.about: About = about
        if path.suffix.lower() != ".csv":
            raise ExperimentError(f"answers go into a .csv file, not {path}: give such a name")
        if path.exists():
            require_file(path, ExperimentError, MOST_TABLE_BYTES)
        self._file = open_alone(path, ExperimentError)
        try:
            self._begin(b"" if overwrite else read_bytes(path, ExperimentError))
        except BaseException:
            self._file.close()
            raise

    def _begin(self, data: bytes) -> None:
        """Read existing lines, and drop one that was cut off."""
        whole = data[: data.rfind(b"\n") + 1]
        self.rows: list[TrialRow] = _parse(whole, self.path) if whole else []
        self._require_same(self.rows[:1] + self.rows[-1:])
        try:
            self._file.truncate(len(whole))
            self._file.seek(len(whole))
            if not whole:
                self._write(_BOM + write_line(COLUMNS.values()))
        except OSError as error:
            raise unwritable(ExperimentError, self.path, error) from None

    def append(self, row: TrialRow) -> None:
        """Add one trial."""
        self._require_same([row])
        line = write_line(write_cell(getattr(row, name), COLUMNS[name]) for name in COLUMNS)
        try:
            self._write(line)
        except OSError as error:
            raise unwritable(ExperimentError, self.path, error) from None
        self.rows.append(row)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _write(self, data: bytes) -> None:
        self._file.write(data)
        self._file.flush()
        os.fsync(self._file.fileno())

    def _require_same(self, rows: list[TrialRow]) -> None:
        for row in rows:
            for name in _SAME:
                has, wanted = getattr(row, name), getattr(self.about, name)
                if has != wanted:
                    raise ExperimentError(
                        f"{self.path} has {name} {has!r}, not {wanted!r}: give another file, or "
                        "remove it"
                    )


def read_rows(path: Path) -> list[TrialRow]:
    """Return the trials of a file; a line that was cut off at its end is dropped."""
    data = read_bytes(path, ExperimentError)
    return _parse(data[: data.rfind(b"\n") + 1], path)


def _parse(data: bytes, path: Path) -> list[TrialRow]:
    table = parse_csv(decoded(data, path, ExperimentError), path, ExperimentError, strict=True)
    head = table.head
    for column in COLUMNS.values():
        if column not in head:
            raise ExperimentError(
                f"{path} has no column {column} in its first line: give a file of answers"
            )
    place = {each.name: head.index(COLUMNS[each.name]) for each in fields(TrialRow)}
    kinds = {each.name: each.type for each in fields(TrialRow)}
    rows, name = [], ""
    for number, line in zip(table.lines, table.rows, strict=True):
        try:
            values: dict[str, Any] = {}
            for name, kind in kinds.items():
                values[name] = read_cell(line[place[name]], kind)
            rows.append(TrialRow(**values))
        except (IndexError, ValueError):
            raise ExperimentError(
                f"{path}, line {number}: {COLUMNS[name]} is missing or not what belongs there; "
                "correct or delete the line"
            ) from None
    return rows
