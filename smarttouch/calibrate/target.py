"""The printed target: a grid of dots around a large L, to be laid under the array's middle."""

import math
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from smarttouch.errors import CalibrationError, require_within
from smarttouch.files import write_bytes
from smarttouch.profile import Profile

LARGE_DOTS = ((0, -1), (0, 0), (0, 1), (1, 1))
"""Columns and rows of the large dots: an L, whose orientation is unambiguous."""
DOT_SHARE = 0.42
LARGE_SHARE = 0.7
"""Diameter of large dots, as a part of the pitch."""
FEWEST_PIXELS = 6
"""Fewest pixels across a pitch; with fewer, dots merge."""
FEWEST_PITCHES = 4
"""Fewest pitches across the field of view; with fewer, the L does not fit."""
PRINT_DPI = 1270
"""Resolution of the print, 50 dots a millimeter: every usual pitch is a whole number of them."""
_FINEST_MM = 0.01
_PITCHES_MM = (0.1, 0.2, 0.25, 0.5, 1.0, 2.0, 2.5, 5.0, 10.0, 20.0, 50.0)
_WISHED_PITCHES = 5
_SPARE = 3
"""Dots beyond the field of view on each side, so that the target need not be laid exactly."""
_MOST_DOTS = 40
_MARGIN_MM = 8.0
_INCH_MM = 25.4


@dataclass(frozen=True)
class DotTarget:
    """Square grid of dots on paper.

    Columns and rows are counted right and down from the dot where the L has
    its middle: that one is laid under the middle of the array, with the L
    upright as one reads.
    """

    pitch_mm: float  # from dot to dot
    reach: int  # columns and rows on each side of the middle

    @cached_property
    def dots(self) -> NDArray[np.float64]:
        """Columns, rows and radii of all dots, (N, 3), radii in mm."""
        side = np.arange(-self.reach, self.reach + 1)
        columns, rows = (each.ravel() for each in np.meshgrid(side, side))
        return np.column_stack([columns, rows, self.radius_mm(columns, rows)])

    def radius_mm(self, columns: NDArray[np.int_], rows: NDArray[np.int_]) -> NDArray[np.float64]:
        """Return the radius of dots."""
        large = np.zeros(np.shape(columns), bool)
        for column, row in LARGE_DOTS:
            large |= (columns == column) & (rows == row)
        return np.where(large, LARGE_SHARE, DOT_SHARE) * self.pitch_mm / 2

    def ink(self, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether there is ink at places around the middle."""
        columns = np.rint(x_mm / self.pitch_mm).astype(int)
        rows = np.rint(y_mm / self.pitch_mm).astype(int)
        away = np.hypot(x_mm - columns * self.pitch_mm, y_mm - rows * self.pitch_mm)
        there = np.maximum(np.abs(columns), np.abs(rows)) <= self.reach
        return np.asarray((away <= self.radius_mm(columns, rows)) & there)

    def draw(self, path: Path) -> None:
        """Write the target as a PNG file with its resolution."""
        dot_per_mm = PRINT_DPI / _INCH_MM
        middle = round(((self.reach + 0.5) * self.pitch_mm + _MARGIN_MM) * dot_per_mm)
        side = 2 * middle + 1
        image = Image.new("L", (side, side), 255)
        pen = ImageDraw.Draw(image)
        for column, row, radius in self.dots:
            x, y = (middle + each * self.pitch_mm * dot_per_mm for each in (column, row))
            reach = radius * dot_per_mm
            pen.ellipse([x - reach, y - reach, x + reach, y + reach], fill=0)
        text = f"SmartTouch {self.pitch_mm:g} mm: print at 100 %, measure {self._ruler()}"
        size = 2.2 * dot_per_mm
        while pen.textlength(text, font_size=size) > side - 2 * dot_per_mm:
            size *= 0.9
        pen.text((dot_per_mm, dot_per_mm), text, fill=0, font_size=size)
        content = BytesIO()
        image.save(content, format="PNG", dpi=(PRINT_DPI, PRINT_DPI))
        write_bytes(path, content.getvalue(), CalibrationError)

    def _ruler(self) -> str:
        return f"{2 * self.reach * self.pitch_mm:g} mm from first to last dot"


def target_for(profile: Profile, dot_pitch_mm: float | None = None) -> DotTarget:
    """Return the target for a sensor, with about five dots across its field, or of the given
    pitch."""
    optics = profile.optics
    field_mm = min(optics.field_width_mm, optics.field_height_mm)
    pitch_mm = dot_pitch_mm
    if pitch_mm is None:
        finest_mm = FEWEST_PIXELS * max(
            optics.field_width_mm / optics.sensor_columns,
            optics.field_height_mm / optics.sensor_rows,
        )
        fit = [each for each in _PITCHES_MM if finest_mm <= each <= field_mm / FEWEST_PITCHES]
        wished = [each for each in fit if each <= field_mm / _WISHED_PITCHES]
        if not fit:
            raise CalibrationError(
                f"{optics.sensor_columns} × {optics.sensor_rows} pixels over "
                f"{optics.field_width_mm:g} × {optics.field_height_mm:g} mm are too coarse for a "
                "target: set optics.rotation_deg, offset_x_mm and offset_y_mm by hand, or give the "
                "pitch of its dots if the sensor is finer than the profile says",
                about="optics",
                remedy="dot_pitch_mm",
            )
        pitch_mm = max(wished) if wished else min(fit)
    words = f"a pitch of {pitch_mm:g} mm between dots in a field of {field_mm:g} mm"
    require_within(CalibrationError, "dot_pitch_mm", pitch_mm, _FINEST_MM, field_mm, words)
    longest = max(optics.field_width_mm, optics.field_height_mm) / pitch_mm
    return DotTarget(pitch_mm, min(_MOST_DOTS, math.ceil(0.75 * longest) + _SPARE))
