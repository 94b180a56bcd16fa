"""Path of a finger over a page: line by line, or as recorded."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from smarttouch.documents.ink import separate_ink
from smarttouch.documents.page_image import Page
from smarttouch.documents.text_lines import TextLine, find_lines
from smarttouch.errors import SourceError, require_within
from smarttouch.profile import Profile
from smarttouch.sources.frame import Pose
from smarttouch.tables import read_csv

Floats = NDArray[np.float64]

RETURN_MM_S = 200.0
"""Speed of the lifted finger on its way to the next line."""
SETTLE_S = 0.6
"""Time of rest at the start of a line."""
LIFT_S = 0.15
SLOWEST_MM_S, FASTEST_MM_S = 0.1, 500.0
_PRESS = 1.1  # reading force, relative to the profile's full force
_WAVER = 0.08  # slow variation of the reading force
_STEP_MM = 2.0  # distance of the points of a path along a line: its bend between them is negligible
_COLUMNS = ("time_s", "x_mm", "y_mm", "angle_deg", "force_n")


class Path2D(Protocol):
    """Pose and force of the finger at any time."""

    duration_s: float

    def at(self, time_s: float) -> tuple[Pose, float]:
        """Return the pose and the force in newtons."""


class ReadingPath:
    """Path along the lines of a page, one after another; in strips if it has no lines.

    The seed is that of the slow variation of the force.
    """

    def __init__(
        self,
        page: Page,
        profile: Profile,
        speed_mm_s: float,
        seed: int = 0,
        light_on_dark: bool = False,
    ) -> None:
        require_within(SourceError, "speed_mm_s", speed_mm_s, SLOWEST_MM_S, FASTEST_MM_S)
        field = (profile.optics.field_width_mm, profile.optics.field_height_mm)
        lines = find_lines(page, light_on_dark) or [_printed(page, light_on_dark)]
        self.lines = [sweep for line in lines for sweep in _sweeps(line, field[1])]
        self._force_n = _PRESS * profile.force.full_n
        self._phases = np.random.default_rng(seed).uniform(0, 2 * math.pi, 2).tolist()
        rows: list[tuple[float, float, float, float, float]] = []
        time_s = 0.0
        for line in self.lines:
            x, y, angle, passed_mm = _middle_path(line, field[0])
            if rows:
                x_before, y_before = rows[-1][1:3]
                time_s += math.hypot(x[0] - x_before, y[0] - y_before) / RETURN_MM_S
            rows.append((time_s, x[0], y[0], angle[0], 0.0))
            rows.append((time_s + LIFT_S, x[0], y[0], angle[0], 1.0))
            sweep_at = time_s + SETTLE_S
            time_s = sweep_at + float(passed_mm[-1]) / speed_mm_s
            lifting_at = max(sweep_at, time_s - LIFT_S / 3)
            passing = sweep_at + passed_mm / speed_mm_s
            times = np.sort(np.append(passing, lifting_at))
            places = (np.interp(times, passing, each) for each in (x, y, angle))
            press = np.interp(times, (lifting_at, time_s), (1.0, 0.0))
            rows.extend(zip(times, *places, press, strict=True))
        self._table = np.array(rows).T.copy()
        self.duration_s = time_s

    def at(self, time_s: float) -> tuple[Pose, float]:
        """Return the pose and the force in newtons."""
        x, y, angle, press = _at(self._table, time_s)
        first, second = self._phases
        slow = math.sin(2 * math.pi * 0.7 * time_s + first)
        slow += math.sin(2 * math.pi * 1.9 * time_s + second)
        return Pose(x, y, angle), press * self._force_n * (1 + _WAVER / 2 * slow)


class RecordedPath:
    """A path from a CSV file with the columns time_s, x_mm, y_mm, angle_deg, force_n."""

    def __init__(self, path: Path) -> None:
        self._table = read_csv(path, SourceError).numbers(_COLUMNS).T.copy()
        self._table[0] -= self._table[0, 0]
        self.duration_s = float(self._table[0, -1])

    def at(self, time_s: float) -> tuple[Pose, float]:
        """Return the pose and the force in newtons."""
        x, y, angle, force = _at(self._table, time_s)
        return Pose(x, y, math.radians(angle)), force


def _at(table: Floats, time_s: float) -> Iterator[float]:
    """Interpolate the other rows of a table at a time of its first row."""
    return map(float, map(partial(np.interp, time_s, table[0]), table[1:]))


def _printed(page: Page, light_on_dark: bool) -> TextLine:
    """Return all print of a page without lines as one line; all of a page without print."""
    width_mm, height_mm = page.size_mm
    y, x = separate_ink(page.grey, light_on_dark).ink.nonzero()
    left, right, top, bottom = 0.0, width_mm, 0.0, height_mm
    if len(x):
        ends = (x.min(), x.max() + 1, y.min(), y.max() + 1)
        left, right, top, bottom = (float(end) * page.mm_per_pixel for end in ends)
    return TextLine(left, right, (bottom,), bottom - top, bottom - top, 0.0)


def _sweeps(line: TextLine, height_mm: float) -> list[TextLine]:
    """Cut a line that is taller than the field into parallel strips."""
    # Ascenders that reach just beyond the field need no second pass.
    count = max(1, math.ceil(line.height_mm / height_mm - 0.15))
    step = line.height_mm / count
    return [
        replace(
            line,
            baseline=(line.baseline[0] - line.ascent_mm + (k + 1) * step, *line.baseline[1:]),
            ascent_mm=step,
            descent_mm=0.0,
        )
        for k in range(count)
    ]


def _middle_path(line: TextLine, field_mm: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Return x, y, angle of a finger along the middle of a line, and the distance covered."""
    start, end = line.left_mm - field_mm / 2, line.right_mm + field_mm / 2
    x = np.linspace(start, end, max(2, math.ceil((end - start) / _STEP_MM)))
    y = line.baseline_mm(x) + (line.descent_mm - line.ascent_mm) / 2
    passed_mm = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    return x, y, np.arctan(line.slope(x)), passed_mm
