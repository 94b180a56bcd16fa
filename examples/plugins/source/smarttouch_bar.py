"""Source of a black bar that passes under the finger: ``bar:`` or ``bar:WIDTH``, in mm."""

import math

import numpy as np

import smarttouch as st
from smarttouch.plugins import Pose

PAPER, INK = 220, 30
"""Gray levels of the paper and of the bar."""
PASSES = 5
DEFAULT_MM = 1.0


def open_bar(rest: str, profile: st.Profile, *, speed_mm_s: float = 10.0) -> "BarSource":
    """Open ``bar:`` or ``bar:WIDTH``; keyword-only parameters are options of the URL."""
    try:
        width_mm = float(rest or DEFAULT_MM)
    except ValueError:
        width_mm = math.nan
    if not 0 < width_mm <= profile.optics.field_width_mm:
        raise st.SourceError(
            f"bar:{rest} is not a width: give a number of millimeters above 0 and at most "
            f"{profile.optics.field_width_mm:g}"
        )
    if not 0 < speed_mm_s <= 1000:
        message = f"speed_mm_s={speed_mm_s:g} is out of range: give above 0 and at most 1000 mm/s"
        raise st.SourceError(message)
    return BarSource(width_mm, speed_mm_s, profile)


class BarSource(st.OpticalSource):
    """Source of frames: a bar that moves through the field from left to right, five times.

    Parameters
    ----------
    width_mm : float, mm
    speed_mm_s : float, mm/s
    profile : Profile
        Profile whose optics state the size of a frame in pixels and in mm.
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
        """Return the frame at a time since the start of the run; None after the last pass."""
        time_s = time_ns / 1e9
        if time_s > self._end_s:
            return None
        right_mm = time_s * self._speed_mm_s % self._way_mm
        x_mm = (np.arange(self._shape[1]) + 0.5) * self._field_mm / self._shape[1]
        dark = (x_mm < right_mm) & (x_mm > right_mm - self._width_mm)
        image = np.tile(np.where(dark, INK, PAPER).astype(np.uint8), (self._shape[0], 1))
        self.frames += 1  # number of frames read, which each source must count
        pose = Pose(-time_s * self._speed_mm_s, 0.0)
        return st.Frame(image, time_ns, pose, math.nan, number=self.frames - 1)
