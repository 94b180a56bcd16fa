"""How hard the finger presses, where the sensor does not tell."""

import csv
import io
import math
from abc import ABC, abstractmethod
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smarttouch.errors import SensorError
from smarttouch.files import read_text
from smarttouch.profile import Profile
from smarttouch.registry import find_opener
from smarttouch.sources.device import Device

LARGEST_FIXED_N = 20.0
LARGEST_RECORDED_N = 100.0
"""No finger presses harder: the numbers are not newtons."""
_COLUMNS = ("time_s", "force_n")


class ForceSource(Device, ABC):
    """Where finger force comes from, opened by its URL."""

    @abstractmethod
    def read(self, time_ns: int) -> float:
        """Return the force at a time since the start of the run, N; NaN where it is not known.

        Never waits and never raises.
        """


def open_force(url: str, profile: Profile) -> ForceSource:
    """Open a source of finger force by its URL.

    Raises
    ------
    SensorError
        If there is no such kind or it cannot be opened.
    """
    opener, rest = find_opener(
        "smarttouch.forces", url, SensorError, ForceSource, ("rest", "profile")
    )
    source: ForceSource = opener(rest, profile)
    return source


def open_fixed(rest: str, profile: Profile) -> ForceSource:
    """Open ``fixed:N``, always the same newtons: for where nothing can measure."""
    return FixedForce(rest)


def open_recorded(rest: str, profile: Profile) -> ForceSource:
    """Open ``recorded:FILE``, a CSV file with the columns time_s and force_n."""
    return RecordedForce(Path(rest))


class FixedForce(ForceSource):
    """Always the same force.

    Parameters
    ----------
    text : str
        0 to 20 N.

    Raises
    ------
    SensorError
        If it is another number, or none.
    """

    def __init__(self, text: str) -> None:
        try:
            self._force_n = float(text)
        except ValueError:
            self._force_n = math.nan
        if not 0 <= self._force_n <= LARGEST_FIXED_N:
            raise SensorError(
                f"fixed:{text} is no force: give newtons from 0 to {LARGEST_FIXED_N:g}, as in "
                "fixed:0.5",
                about="force",
                problem="impossible",
                value=text,
                allowed=LARGEST_FIXED_N,
            )
        super().__init__(f"fixed {self._force_n:g} N")

    def read(self, time_ns: int) -> float:
        """Return the force."""
        return self._force_n


class RecordedForce(ForceSource):
    """Force from a table, linear between its rows; not known before the first and after the last.

    Parameters
    ----------
    path : Path
        CSV with a heading; the columns ``time_s`` (since the start of the run, rising) and
        ``force_n`` are used, others are not, so a recorded path will do.

    Raises
    ------
    SensorError
        If the file is missing or wrong; it says in which line.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(f"force of {path.name}")
        self._time_s, self._force_n = _read_table(path)

    def read(self, time_ns: int) -> float:
        """Return the force at a time since the start, N; NaN outside the table."""
        nothing = math.nan
        force_n = np.interp(time_ns / 1e9, self._time_s, self._force_n, nothing, nothing)
        return nothing if np.isnan(force_n) else max(0.0, float(force_n))


def _read_table(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    try:
        reader = csv.reader(io.StringIO(read_text(path, SensorError), newline=""))
        heading = [cell.strip() for cell in next(reader, [])]
        if not set(_COLUMNS) <= set(heading):
            raise SensorError(
                f"{path} must begin with a line that names the columns {','.join(_COLUMNS)}",
                about="columns",
                value=tuple(heading),
                allowed=_COLUMNS,
            )
        where = [heading.index(name) for name in _COLUMNS]
        # The line in the file: a row may be blank, or quoted over several lines.
        rows = [
            (reader.line_num, _numbers(path, reader.line_num, row, where)) for row in reader if row
        ]
    except csv.Error:
        raise SensorError(
            f"cannot read the force {path}: it is not a text table",
            about="file",
            problem="malformed",
            value=path,
        ) from None
    if len(rows) < 2:
        raise SensorError(
            f"{path} has {len(rows)} rows: a recorded force needs at least two",
            about="rows",
            problem="too few",
            value=len(rows),
            allowed=2,
        )
    table = np.array([numbers for _, numbers in rows])
    falling = np.diff(table[:, 0]) <= 0
    if falling.any():
        line = rows[int(np.argmax(falling)) + 1][0]
        raise SensorError(
            f"{path}, line {line}: time must rise from line to line",
            about="line",
            problem="falling",
            value=line,
        )
    return table[:, 0].copy(), table[:, 1].copy()


def _numbers(path: Path, line: int, row: list[str], where: list[int]) -> tuple[float, float]:
    try:
        time_s, force_n = (float(row[column]) for column in where)
    except (ValueError, IndexError):
        time_s = force_n = math.nan
    if not (math.isfinite(time_s) and math.isfinite(force_n)):
        raise SensorError(
            f"{path}, line {line}: needs numbers for {' and '.join(_COLUMNS)}, has {row}",
            about="line",
            problem="malformed",
            value=line,
        )
    if abs(force_n) > LARGEST_RECORDED_N:
        raise SensorError(
            f"{path}, line {line}: {force_n:g} N is more than any finger presses: give newtons",
            about="force_n",
            problem="too large",
            value=force_n,
            allowed=LARGEST_RECORDED_N,
        )
    return time_s, force_n
