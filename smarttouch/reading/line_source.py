"""Prepared lines as a source of frames: the image under the array over time."""

from collections.abc import Callable, Mapping

import cv2
import numpy as np

from smarttouch.profile import Profile
from smarttouch.reading.cursor import Cursor
from smarttouch.reading.feed import LineFeed
from smarttouch.reading.window import pixel_of
from smarttouch.sources.frame import Frame, Pose
from smarttouch.sources.source import OpticalSource

LINE_GAP_MM = 4.0
"""Gap between lines where their poses are placed on one sheet, one below the other."""


class ReadingSource(OpticalSource):
    """Frames of lines that pass under the finger, for a profile of `profile_for_reading`.

    The pose of a frame is on a sheet on which all lines lie below each other, at the scale of the
    array.
    """

    ended = "end of the text"

    def __init__(self, title: str, profile: Profile, feed: LineFeed, cursor: Cursor) -> None:
        super().__init__(title)
        self._name = title
        self.knows_force = cursor.knows_force
        self.measures_force = cursor.measures_force
        self.index = -1
        """Index of the line under the finger."""
        self._feed, self._cursor = feed, cursor
        self._pixel_mm = pixel_of(profile)
        self._shape = (profile.optics.sensor_rows, profile.optics.sensor_columns)
        wide_mm, high_mm = profile.electrodes.cell_mm
        self._cell_px = (round(high_mm / self._pixel_mm), round(wide_mm / self._pixel_mm))

    @property
    def keys(self) -> Mapping[str, Callable[[], None]]:
        """Keys of the cursor: forward, back, again, pause."""
        return self._cursor.keys

    @property
    def line_step_mm(self) -> float:
        """Distance of lines on the sheet, from middle to middle."""
        return self._shape[0] * self._pixel_mm + LINE_GAP_MM

    def read(self, time_ns: int) -> Frame | None:
        """Return the image under the array at a time; None after the last line."""
        spot = self._cursor.at(time_ns)
        if spot is None:
            return None
        if spot.index != self.index:
            self.index = spot.index
            line = self._feed.line(self.index)
            if line is not None:
                text = f": {line.text}" if line.text else ""
                self.title = f"{self._name}, line {self.index + 1}{text}"
        image = np.full(self._shape, 255, np.uint8)
        if spot.line is not None:
            rows, columns = self._shape
            # Of the window's top left pixel in the line's image.
            left = spot.x_mm / self._pixel_mm - columns / 2
            top = spot.y_mm / self._pixel_mm + (spot.line.image.shape[0] - rows) / 2
            cv2.warpAffine(
                spot.line.image,
                np.array([[1.0, 0.0, left], [0.0, 1.0, top]]),
                (columns, rows),
                dst=image,
                flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                borderMode=cv2.BORDER_CONSTANT,
                borderValue=255,
            )
        if spot.marked:
            (top, left), (high, wide) = (each // 2 for each in self._shape), self._cell_px
            image[top : top + high, left : left + wide] = 0
        self.frames += 1
        pose = Pose(spot.x_mm, spot.index * self.line_step_mm + spot.y_mm)
        return Frame(image, time_ns, pose, spot.force_n, number=self.frames - 1)

    def close(self) -> None:
        """Stop preparing lines."""
        self._feed.close()
