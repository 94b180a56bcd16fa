"""A black bar that passes under the finger again and again: ``bar:`` or ``bar:1.5`` (mm wide)."""

import math

import numpy as np

import smarttouch as st
from smarttouch.plugins import Pose

PAPER, INK = 220, 30
"""Grey levels."""
PASSES = 5
USUAL_MM = 1.0


def open_bar(rest: str, profile: st.Profile, *, speed_mm_s: float = 10.0) -> "BarSource":
    """Open ``bar:`` or ``bar:WIDTH``; what follows the star are its options."""
    try:
        width_mm = float(rest or USUAL_MM)
    except ValueError:
        width_mm = math.nan
    if not 0 < width_mm <= profile.optics.field_width_mm:
        raise st.SourceError(
            f"bar:{rest} is no width: give millimeters above 0, at most "
            f"{profile.optics.field_width_mm:g}"
        )
    if not 0 < speed_mm_s <= 1000:
        raise st.SourceError(f"{speed_mm_s:g} mm/s cannot be: give above 0, at most 1000")
    return BarSource(width_mm, speed_mm_s, profile)


class BarSource(st.OpticalSource):
    """Frames of a bar that enters at the left and leaves at the right, five times.

    Parameters
    ----------
    width_mm : float, mm
    speed_mm_s : float, mm/s
    profile : Profile
        Its optics: how large a frame is, and of what.
    """

    ended = "the bar has passed"

    def __init__(self, width_mm: float, speed_mm_s: float, profile: st.Profile) -> None:
        super().__init__(f"a bar of {width_mm:g} mm")
        optics = profile.optics
        self._shape = (optics.sensor_rows, optics.sensor_columns)
        self._field_mm = optics.field_width_mm
        self._width_mm, self._speed_mm_s = width_mm, speed_mm_s
        self._way_mm = self._field_mm + width_mm
        self.duration_s = self._end_s = PASSES * self._way_mm / speed_mm_s

    def read(self, time_ns: int) -> st.Frame | None:
        """Return the frame at a time since the start; None when the bar has passed."""
        time_s = time_ns / 1e9
        if time_s > self._end_s:
            return None
        right_mm = time_s * self._speed_mm_s % self._way_mm
        x_mm = (np.arange(self._shape[1]) + 0.5) * self._field_mm / self._shape[1]
        dark = (x_mm < right_mm) & (x_mm > right_mm - self._width_mm)
        image = np.tile(np.where(dark, INK, PAPER).astype(np.uint8), (self._shape[0], 1))
        # Every frame that it gives is one more that was read.
        self.frames += 1
        pose = Pose(-time_s * self._speed_mm_s, 0.0)
        return st.Frame(image, time_ns, pose, math.nan, number=self.frames - 1)
