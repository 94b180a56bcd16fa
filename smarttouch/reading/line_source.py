"""Source of lines of text: a thread prepares the lines, and a virtual finger moves along them."""

import atexit
import contextlib
import math
import queue
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import ReadingError, require_within
from smarttouch.base.events import Note
from smarttouch.imaging.reading_profile import pixel_pitch_mm, reading_force_n
from smarttouch.pages.page_and_lines import Page
from smarttouch.profile import Profile
from smarttouch.sources.source_contract import Frame, OpticalSource, Pose, Sheet

LAND_S = 0.15  # time from the start of a line until the virtual finger presses on it
SETTLE_S = 0.75
"""Rest at the start of a line. During the rest, intensity rises, and a point marks the start."""
SLOWEST_MM_S, FASTEST_MM_S = 0.1, 2000.0
LONGEST_PAUSE_S = 3600.0
LINE_GAP_MM = 4.0
"""Gap between lines on the sheet, which shows each line below the line before it."""
AHEAD = 30  # largest number of lines prepared in advance
BEHIND = 60  # number of past lines that are stored for going back
_JOIN_S, _AGAIN_S = 0.3, 0.1


@dataclass(frozen=True, eq=False)
class TouchLine:
    """A line of letter shapes or Braille cells, at the size of the array."""

    image: NDArray[np.uint8]  # (H, W), dark on white, as high as the array
    start_mm: float  # x of the array's center when motion begins; 0 is the image's left edge
    end_mm: float  # x of the array's center when the end of the line is reached
    text: str = ""
    cells: str = ""


@dataclass(frozen=True)
class LineMotion:
    """Motion of lines under the finger in steps of `step_mm`, or smooth if the step is 0."""

    speed_mm_s: float
    step_mm: float = 0.0

    def __post_init__(self) -> None:
        require_within(ReadingError, "speed_mm_s", self.speed_mm_s, SLOWEST_MM_S, FASTEST_MM_S)


class ReadingSource(OpticalSource):
    """Source of images of lines that pass under the finger.

    Poses are places on a sheet, at the scale of the array. On the sheet, each line is below the
    line before it. If ``lines`` raises an error, `read` raises it after the last line.

    Parameters
    ----------
    title : str
        Name of the text.
    profile : Profile
        Result of `profile_for_reading`.
    lines : iterator of TouchLine
        Lines, which a thread prepares in advance.
    motion : LineMotion
        Speed and steps.
    pause_s : float, s
        Pause after each line; if infinite, a key starts the next line.

    Attributes
    ----------
    index : int
        Index of the line under the finger.
    total : int, optional
        Number of lines, once all are prepared.
    """

    knows_force = True
    ended = "end of the text"
    keys_help = "← → line    r again    "

    def __init__(
        self,
        title: str,
        profile: Profile,
        lines: Iterator[TouchLine],
        motion: LineMotion,
        pause_s: float = 0.0,
    ) -> None:
        super().__init__(title)
        if pause_s != math.inf:
            require_within(ReadingError, "pause_s", pause_s, 0, LONGEST_PAUSE_S)
        self.index: int = 0
        self.total: int | None = None
        self._name, self._motion, self._pause_s = title, motion, pause_s
        self._press_n = reading_force_n(profile)
        self._pixel_mm = pixel_pitch_mm(profile)
        self._shape = (profile.optics.sensor_rows, profile.optics.sensor_columns)
        wide_mm, high_mm = profile.electrodes.cell_mm
        self._mark_px = (round(high_mm / self._pixel_mm), round(wide_mm / self._pixel_mm))
        self._line_s = 0.0  # time on the current line
        self._before_ns: int | None = None
        self._paused = self._again = False
        self._asked: deque[int] = deque()
        self._under: tuple[int, TouchLine] | None = None
        self._texts: dict[int, str] = {}
        self._queue: queue.Queue[TouchLine | Exception | None] = queue.Queue(AHEAD)
        self._lines: deque[TouchLine] = deque(maxlen=BEHIND)
        self._count = 0  # lines taken from the queue
        self._end: Exception | None = None
        self._is_over = False
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._prepare, args=(lines,), daemon=True)
        self._thread.start()
        # Stop the thread at exit: a thread that still runs library code aborts the interpreter.
        atexit.register(self._stop)

    @property
    def keys(self) -> Mapping[str, Callable[[], None]]:
        """The function of each key: next line, previous line, repeat, or pause."""
        steps = {"right": 1, "n": 1, "left": -1, "p": -1, "r": 0}
        keys = {key: partial(self._asked.append, step) for key, step in steps.items()}
        return {**keys, " ": self._toggle_pause}

    @property
    def account(self) -> str:
        """Return the number of lines that were read, and their texts."""
        lines = f"{len(self._texts)} line{'s' * (len(self._texts) != 1)} read"
        words = " / ".join(text for _, text in sorted(self._texts.items()) if text)
        return f"{lines}: {words}" if words else lines

    @property
    def words(self) -> str:
        """Return the text of the line under the finger, if known."""
        return self._texts.get(self.index, "")

    @property
    def sheet(self) -> Sheet | None:
        """Return the line under the finger."""
        if self._under is None:
            return None
        index, line = self._under
        top_mm = index * self.line_step_mm - line.image.shape[0] * self._pixel_mm / 2
        return Sheet(index, Page(line.image, self._pixel_mm), (0.0, top_mm))

    @property
    def line_step_mm(self) -> float:
        """Distance between the middles of lines on the sheet."""
        return self._shape[0] * self._pixel_mm + LINE_GAP_MM

    def read(self, time_ns: int) -> Frame | None:
        """Return a frame with the image under the array; None after the last line."""
        elapsed_s = 0.0 if self._before_ns is None else (time_ns - self._before_ns) / 1e9
        self._before_ns = time_ns
        while self._asked:
            earliest = self._count - len(self._lines)
            self._go_to(max(earliest, self.index + self._asked.popleft()))
        line = self.line(self.index)
        self.tell_notes(time_ns)
        if line is None and self._is_over:
            return None
        image = np.full(self._shape, 255, np.uint8)
        x_mm = force_n = 0.0
        index = self.index
        if line is not None:
            self._announce(line, time_ns)
            self._line_s += 0.0 if self._paused else elapsed_s
            way_mm = max(0.0, (self._line_s - SETTLE_S) * self._motion.speed_mm_s)
            if way_mm <= line.end_mm - line.start_mm:
                step_mm = self._motion.step_mm
                steps_mm = math.floor(way_mm / step_mm + 1e-6) * step_mm if step_mm else way_mm
                x_mm = line.start_mm + steps_mm
                force_n = self._press_n if self._line_s >= LAND_S else 0.0
                self._draw(line, x_mm, image)
            else:
                self._go_on(way_mm - (line.end_mm - line.start_mm))
        self.frames += 1
        pose = Pose(x_mm, index * self.line_step_mm)
        return Frame(image, time_ns, pose, force_n, number=self.frames - 1)

    def close(self) -> None:
        """Stop preparing lines."""
        self._closing.set()
        self._thread.join(_JOIN_S)
        if not self._thread.is_alive():
            atexit.unregister(self._stop)

    def _stop(self) -> None:
        self._closing.set()
        self._thread.join()

    def _prepare(self, lines: Iterator[TouchLine]) -> None:
        """Put all lines into the queue. Then put None, or the exception if there was an error."""
        count, end = 0, None
        try:
            for line in lines:
                self._put(line)
                if self._closing.is_set():
                    return
                count += 1
            self.total = count
        except Exception as error:
            end = error
        self._put(end)

    def _put(self, item: TouchLine | Exception | None) -> None:
        while not self._closing.is_set():
            with contextlib.suppress(queue.Full):
                self._queue.put(item, timeout=_AGAIN_S)
                return

    def line(self, index: int, wait: bool = False) -> TouchLine | None:
        """Return a line, or None if it is not stored. Without ``wait``, also return None if it is
        not ready. Call this only in the thread that calls `read`."""
        while index >= self._count and not self._is_over:
            try:
                item = self._queue.get(wait)
            except queue.Empty:
                return None
            if isinstance(item, TouchLine):
                self._lines.append(item)
                self._count += 1
            else:
                self._is_over, self._end = True, item
        if index >= self._count and self._end is not None:
            raise self._end
        earliest = self._count - len(self._lines)
        return self._lines[index - earliest] if earliest <= index < self._count else None

    def _toggle_pause(self) -> None:
        self._paused = not self._paused

    def _go_to(self, index: int) -> None:
        self._again = index == self.index
        self.index, self._line_s = index, 0.0

    def _go_on(self, beyond_mm: float) -> None:
        """Go to the next line after the pause. After the last line, leave out an infinite pause."""
        pause_s = self._pause_s
        if pause_s == math.inf and self.line(self.index + 1) is None and self._is_over:
            pause_s = 0.0
        if beyond_mm > pause_s * self._motion.speed_mm_s:
            self._go_to(self.index + 1)

    def _announce(self, line: TouchLine, time_ns: int) -> None:
        """Show a line in the title; emit a note if a key repeated the line."""
        if self._under is None or self._under[0] != self.index:
            self._under = (self.index, line)
            self._texts[self.index] = line.text
            of = "" if self.total is None else f" of {self.total}"
            text = f": {line.text}" if line.text else ""
            self.title: str = f"{self._name}, line {self.index + 1}{of}{text}"
        elif self._again:
            self.emit(Note(time_ns, self.title))
        self._again = False

    def _draw(self, line: TouchLine, x_mm: float, image: NDArray[np.uint8]) -> None:
        """Draw the part of a line under the array, and the point that marks the start of the line.

        Pulses at the point let intensity rise before the text arrives.
        """
        rows, columns = self._shape
        left = x_mm / self._pixel_mm - columns / 2
        top = (line.image.shape[0] - rows) / 2
        cv2.warpAffine(
            line.image, np.array([[1.0, 0.0, left], [0.0, 1.0, top]]), (columns, rows),
            dst=image, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT, borderValue=255,
        )  # fmt: skip
        if self._line_s < SETTLE_S:
            (top, left), (high, wide) = (rows // 2, columns // 2), self._mark_px
            image[top : top + high, left : left + wide] = 0
