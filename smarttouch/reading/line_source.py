"""Lines under the finger as a source of frames, and the cursor over them."""

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from smarttouch.base.errors import ReadingError, require_within
from smarttouch.base.events import Note
from smarttouch.imaging.array_window import pixel_pitch_mm
from smarttouch.pages.page_image import Page
from smarttouch.profile import Profile
from smarttouch.reading.line_feed import LineFeed, TouchLine
from smarttouch.sources.source_contract import Frame, OpticalSource, Pose, Sheet

LAND_S = 0.15  # time of landing on a line, when intensity begins to rise
SETTLE_S = 0.75
"""Time of rest at the line's start while intensity rises; a point marks the start meanwhile."""
SLOWEST_MM_S, FASTEST_MM_S = 0.1, 2000.0
LONGEST_PAUSE_S = 3600.0
GAP = 0.2
"""Silent part of each step of text that moves in steps: two equal cells would be felt as one."""


@dataclass(frozen=True)
class Spot:
    """Position of the finger on a line."""

    index: int
    line: TouchLine | None  # None where there is nothing under the finger
    x_mm: float = 0.0  # of the array's middle, from the line's left end
    force_n: float = 0.0
    marked: bool = False
    """Whether a point in the middle of the array marks the line's start: intensity rises with
    delivered pulses alone, and with these before those of the text."""


@dataclass(frozen=True)
class LineMotion:
    """Motion of lines under the finger: smooth if the step is 0; with ``gaps`` steps begin
    silently.
    """

    speed_mm_s: float
    step_mm: float = 0.0
    gaps: bool = False

    def __post_init__(self) -> None:
        require_within(ReadingError, "speed_mm_s", self.speed_mm_s, SLOWEST_MM_S, FASTEST_MM_S)


class SweepingCursor:
    """Cursor that sweeps line after line, pressing with ``press_n``, with a pause after each.

    After an infinite pause the next line comes only when a key asks for it.
    """

    def __init__(
        self,
        feed: LineFeed,
        motion: LineMotion,
        press_n: float,
        pause_s: float = 0.0,
    ) -> None:
        if pause_s != math.inf:
            require_within(ReadingError, "pause_s", pause_s, 0, LONGEST_PAUSE_S)
        self._feed, self._motion = feed, motion
        self._press_n, self._pause_s = press_n, pause_s
        self._index, self._line_s = 0, 0.0  # index of the line, and the time spent on it
        self._before_ns: int | None = None
        self._paused = False
        self._asked: deque[int] = deque()

    @property
    def keys(self) -> dict[str, Callable[[], None]]:
        """Forward and back by a line, the line again, and a pause."""
        return {
            "right": lambda: self._asked.append(1),
            "n": lambda: self._asked.append(1),
            "left": lambda: self._asked.append(-1),
            "p": lambda: self._asked.append(-1),
            "r": lambda: self._asked.append(0),
            " ": self.toggle_pause,
        }

    def toggle_pause(self) -> None:
        """Pause or resume."""
        self._paused = not self._paused

    def at(self, time_ns: int) -> Spot | None:
        """Advance by the time that has passed."""
        elapsed_s = 0.0 if self._before_ns is None else (time_ns - self._before_ns) / 1e9
        self._before_ns = time_ns
        while self._asked:
            self._go_to(max(self._feed.earliest, self._index + self._asked.popleft()))
        line = self._feed.line(self._index)
        if line is None:
            # A key may have moved beyond the last line.
            return None if self._feed.ended(self._index) else Spot(self._index, None)
        if not self._paused:
            self._line_s += elapsed_s
        way_mm = (self._line_s - SETTLE_S) * self._motion.speed_mm_s
        length_mm = line.end_mm - line.start_mm
        if way_mm <= length_mm:
            return self._on_line(line, max(0.0, way_mm))
        pause_s = self._pause_s
        if pause_s == math.inf and self._feed.ended(self._index + 1):
            pause_s = 0.0
        if self._line_s > SETTLE_S + length_mm / self._motion.speed_mm_s + pause_s:
            self._go_to(self._index + 1)
        return Spot(self._index, None)

    def _go_to(self, index: int) -> None:
        self._index, self._line_s = index, 0.0
        self._feed.reach(index)

    def _on_line(self, line: TouchLine, way_mm: float) -> Spot:
        shown: TouchLine | None = line
        step_mm = self._motion.step_mm
        if step_mm:
            steps = way_mm / step_mm + 1e-6
            if self._motion.gaps and steps % 1 < GAP:
                shown = None
            way_mm = math.floor(steps) * step_mm
            if self._motion.gaps and self._line_s < SETTLE_S:
                # All steps are equally strong and long, the first one too.
                shown, way_mm = None, -step_mm
        press_n = self._press_n if self._line_s >= LAND_S else 0.0
        marked = self._line_s < SETTLE_S
        return Spot(self._index, shown, line.start_mm + way_mm, press_n, marked)


LINE_GAP_MM = 4.0
"""Gap between lines where their poses are placed on one sheet, one below the other."""


class ReadingSource(OpticalSource):
    """Frames of lines that pass under the finger, for a profile of `profile_for_reading`.

    The pose of a frame is on a sheet on which all lines lie below each other, at the scale of the
    array.
    """

    frames: int

    knows_force = True
    ended = "end of the text"

    def __init__(
        self, title: str, profile: Profile, feed: LineFeed, cursor: SweepingCursor
    ) -> None:
        super().__init__(title)
        self._name = title
        self.index: int = -1  # index of the line under the finger
        self._feed, self._cursor = feed, cursor
        self._titled = self._marked = self._announced = False
        self._texts: dict[int, str] = {}
        self._pixel_mm = pixel_pitch_mm(profile)
        self._shape = (profile.optics.sensor_rows, profile.optics.sensor_columns)
        wide_mm, high_mm = profile.electrodes.cell_mm
        self._cell_px = (round(high_mm / self._pixel_mm), round(wide_mm / self._pixel_mm))

    @property
    def keys(self) -> Mapping[str, Callable[[], None]]:
        """Keys of the cursor: forward, back, again, pause."""
        return self._cursor.keys

    @property
    def account(self) -> str:
        """Return in words which lines were read, and their text."""
        lines = f"{len(self._texts)} line{'s' * (len(self._texts) != 1)} read"
        words = " / ".join(text for _, text in sorted(self._texts.items()) if text)
        return f"{lines}: {words}" if words else lines

    @property
    def words(self) -> str:
        """Return the text of the line under the finger, if it is known."""
        return self._texts.get(self.index, "")

    @property
    def sheet(self) -> Sheet | None:
        """Return the line under the finger."""
        line = self._feed.line(self.index) if self.index >= 0 else None
        if line is None:
            return None
        middle_mm = self.index * self.line_step_mm
        top_mm = middle_mm - line.image.shape[0] * self._pixel_mm / 2
        return Sheet(self.index, Page(line.image, self._pixel_mm), (0.0, top_mm))

    @property
    def line_step_mm(self) -> float:
        """Distance of lines on the sheet, from middle to middle."""
        return self._shape[0] * self._pixel_mm + LINE_GAP_MM

    def read(self, time_ns: int) -> Frame | None:
        """Return the image under the array at a time; None after the last line."""
        spot = self._cursor.at(time_ns)
        self.tell_notes(time_ns)
        if spot is None:
            return None
        if spot.index != self.index or not self._titled:
            self.index = spot.index
            line = self._feed.line(self.index)
            # A line that is still being recognized is named when it is there.
            self._titled = line is not None
            if line is not None:
                text = f": {line.text}" if line.text else ""
                total = self._feed.total
                of = "" if total is None else f" of {total}"
                self.title: str = f"{self._name}, line {self.index + 1}{of}{text}"
                self._texts[self.index] = line.text
            self._announced = True
        if spot.marked and not self._marked:
            # A key has asked for the line again.
            if not self._announced:
                self.emit(Note(time_ns, self.title))
            self._announced = False
        self._marked = spot.marked
        image = np.full(self._shape, 255, np.uint8)
        if spot.line is not None:
            rows, columns = self._shape
            # Of the window's top left pixel in the line's image.
            left = spot.x_mm / self._pixel_mm - columns / 2
            top = (spot.line.image.shape[0] - rows) / 2
            cv2.warpAffine(
                spot.line.image, np.array([[1.0, 0.0, left], [0.0, 1.0, top]]), (columns, rows),
                dst=image, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                borderMode=cv2.BORDER_CONSTANT, borderValue=255,
            )  # fmt: skip
        if spot.marked:
            (top, left), (high, wide) = (each // 2 for each in self._shape), self._cell_px
            image[top : top + high, left : left + wide] = 0
        self.frames += 1
        pose = Pose(spot.x_mm, spot.index * self.line_step_mm)
        return Frame(image, time_ns, pose, spot.force_n, number=self.frames - 1)

    def close(self) -> None:
        """Stop preparing lines."""
        self._feed.close()
