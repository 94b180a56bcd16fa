"""A hand's way as it was recorded."""

import csv
import io
from pathlib import Path

import numpy as np

from smarttouch.errors import SensorError
from smarttouch.files import read_text
from smarttouch.texture.motion import Motion

RESOLUTION_MM = 0.01
"""Recorded ways are rounded; an estimate of ours."""
_NEEDED = ("time_s", "x_mm", "y_mm")


def open_it(rest: str) -> "PathMotion":
    """Open ``path:CSV``."""
    if not rest:
        message = "path: names no file: give one, as in path:way.csv"
        raise SensorError(message, about="file", problem="missing")
    return PathMotion(Path(rest))


class PathMotion(Motion):
    """Goes the way of a table, in straight lines between its rows.

    Parameters
    ----------
    path : Path
        CSV file whose heading names the columns ``time_s``, ``x_mm`` and ``y_mm`` (on the
        texture, from its top left corner) and may name ``force_n``; others are not used.

    Raises
    ------
    SensorError
        If the file is missing or wrong; it says in which line.
    """

    resolution_mm = RESOLUTION_MM

    def __init__(self, path: Path) -> None:
        super().__init__(f"the way of {path.name}")
        heading, rows = _read_table(path)
        self.knows_force = "force_n" in heading
        columns = [*_NEEDED, *(["force_n"] if self.knows_force else [])]
        places = [heading.index(name) for name in columns]
        table = np.array([_numbers(path, line, row, places, columns) for line, row in rows])
        falling = np.diff(table[:, 0]) <= 0
        if falling.any():
            line = rows[int(np.argmax(falling)) + 1][0]
            message = f"{path}, line {line}: time must rise from line to line"
            raise SensorError(message, about="line", problem="falling", value=line)
        table[:, 0] -= table[0, 0]
        self._table = table
        self.duration_s = float(table[-1, 0])
        self.origin_mm = (float(table[0, 1]), float(table[0, 2]))

    def read(self, time_ns: int) -> tuple[float, float] | None:
        """Return how far the way has led from its first point; None after the last."""
        time_s, times = time_ns / 1e9, self._table[:, 0]
        if time_s > times[-1]:
            return None
        x, y, *force = (float(np.interp(time_s, times, each)) for each in self._table.T[1:])
        if force:
            self.force_n = max(0.0, force[0])
        assert self.origin_mm is not None
        return x - self.origin_mm[0], y - self.origin_mm[1]


def _read_table(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    try:
        reader = csv.reader(io.StringIO(read_text(path, SensorError), newline=""))
        heading = [cell.strip() for cell in next(reader, [])]
        rows = [(reader.line_num, row) for row in reader if row]
    except csv.Error:
        message = f"cannot read the path {path}: it is not a text table"
        raise SensorError(message, about="file", problem="malformed", value=path) from None
    if not set(_NEEDED) <= set(heading):
        message = f"{path} must begin with a line that names {','.join(_NEEDED)}"
        raise SensorError(message, about="columns", value=tuple(heading), allowed=_NEEDED)
    if len(rows) < 2:
        message = f"{path} has {len(rows)} points: a path needs at least two"
        raise SensorError(message, about="rows", problem="too few", value=len(rows), allowed=2)
    return heading, rows


def _numbers(
    path: Path, line: int, row: list[str], places: list[int], columns: list[str]
) -> list[float]:
    try:
        numbers = [float(row[place]) for place in places]
    except (ValueError, IndexError):
        numbers = [float("nan")]
    if not np.isfinite(numbers).all():
        message = f"{path}, line {line}: needs numbers for {','.join(columns)}, has {row}"
        raise SensorError(message, about="line", problem="malformed", value=line)
    return numbers
