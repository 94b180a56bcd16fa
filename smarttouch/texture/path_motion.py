"""Recorded path of a hand."""

from pathlib import Path

import numpy as np

from smarttouch.errors import SourceError
from smarttouch.tables import read_csv
from smarttouch.texture.motion import Motion

_PATH_RESOLUTION_MM = 0.01
"""Resolution of recorded paths; an estimate of ours."""
_NEEDED = ("time_s", "x_mm", "y_mm")


def open_path(rest: str) -> "PathMotion":
    """Open ``path:CSV``."""
    if not rest:
        raise SourceError("path: names no file: give one, as in path:way.csv", about="file")
    return PathMotion(Path(rest))


class PathMotion(Motion):
    """Motion along the points of a table, in straight lines.

    The heading of the CSV file names the columns ``time_s``, ``x_mm`` and ``y_mm`` (on the texture,
    from its top left corner) and may name ``force_n``; others are not used.
    """

    resolution_mm = _PATH_RESOLUTION_MM

    def __init__(self, path: Path) -> None:
        super().__init__(f"the way of {path.name}")
        read = read_csv(path, SourceError)
        self.knows_force = "force_n" in read.head
        table = read.numbers((*_NEEDED, "force_n") if self.knows_force else _NEEDED)
        table[:, 0] -= table[0, 0]
        self._table = table
        self.duration_s = float(table[-1, 0])
        self.origin_mm = (float(table[0, 1]), float(table[0, 2]))

    def read(self, time_ns: int) -> tuple[float, float] | None:
        """Return the displacement from the first point; None after the last."""
        time_s, times = time_ns / 1e9, self._table[:, 0]
        if time_s > times[-1]:
            return None
        x, y, *force = (float(np.interp(time_s, times, each)) for each in self._table.T[1:])
        if force:
            self.force_n = max(0.0, force[0])
        assert self.origin_mm is not None
        return x - self.origin_mm[0], y - self.origin_mm[1]
