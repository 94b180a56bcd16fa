"""``brltty:``: cells of a screen reader under the finger, moving or one by one."""

import time
from collections import deque
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import SourceError, require_within
from smarttouch.imaging.array_window import reading_force_n, usual_speed_mm_s
from smarttouch.profile import Profile
from smarttouch.reading.braille_lines import CellLayout, Presentation, cell_layout
from smarttouch.reading.brltty_connection import Address, BrlttyConnection, DisplayContent
from smarttouch.reading.line_source import FASTEST_MM_S, GAP, LINE_GAP_MM, SLOWEST_MM_S
from smarttouch.sources.source_contract import Pose, Stimulus, StimulusSource

USUAL_CELLS = 20
REST_S = 0.3  # time for which the first cell after a jump stays before the others follow


def open_brltty(
    rest: str,
    profile: Profile,
    *,
    cells: int = USUAL_CELLS,
    show: str = Presentation.LINE,
    speed_mm_s: float | None = None,
    pan: bool = False,
) -> "BrailleDisplaySource":
    """Open ``brltty:HOST:PORT``, where BRLTTY listens, or ``brltty:listen:PORT``.

    The port is 35752 of this machine if none is given; the speed follows the profile's pulse rate.
    ``show`` is "line" for cells that move under the finger, or "cell" for one at a time; with
    ``pan`` the window moves on by itself at its end.
    """
    if show not in list(Presentation):
        raise SourceError(f"cells cannot be shown as {show!r}: choose line or cell")
    connection = BrlttyConnection(Address.parse(rest), cells)
    source = BrailleDisplaySource(connection, profile, Presentation(show), speed_mm_s, pan)
    connection.open()
    return source


class BrailleDisplaySource(StimulusSource):
    """Presents the cells that BRLTTY shows, one electrode a dot; closes the connection with itself.

    Changed cells are presented from the first that is new, and where only the cursor moved, from
    there, up to the last cell. Nothing is presented without BRLTTY. With ``pan`` BRLTTY moves its
    window on after the last cell.
    """

    knows_force = True
    ended = "the display is switched off"
    keys_help = "← →  window    n p  line    [ ]  cell    r  again    Enter  route    h  cursor    "

    def __init__(
        self,
        connection: BrlttyConnection,
        profile: Profile,
        presentation: Presentation = Presentation.LINE,
        speed_mm_s: float | None = None,
        pan: bool = False,
    ) -> None:
        super().__init__(f"BRLTTY at {connection.address}")
        speed_mm_s = usual_speed_mm_s(profile) if speed_mm_s is None else speed_mm_s
        require_within(SourceError, "speed_mm_s", speed_mm_s, SLOWEST_MM_S, FASTEST_MM_S)
        self.connection = connection
        self.layout: CellLayout = cell_layout(profile, eight=True)
        self.apart: bool = presentation is Presentation.CELL
        self._name, self._pan = self.title, pan
        self._press_n = reading_force_n(profile)
        self._shape = (profile.optics.sensor_columns, profile.optics.sensor_rows)
        # A step is an electrode or a cell, and takes as long as that needs to pass.
        self._steps_a_cell = 1 if self.apart else self.layout.cell
        self._steps_a_s = speed_mm_s / self.layout.cell_mm * self._steps_a_cell
        self._shown = DisplayContent()
        self._dots = np.zeros((self.layout.rows, 0), np.bool_)
        self._first, self._since_s = 0, 0.0
        """Cell at the start of the motion, and its duration so far."""
        self._cursor: int | None = None
        self._before_ns: int | None = None
        self._paused = self._panned = False
        self._jumps = 0
        self._place: tuple[int, int] | None = None
        self._asked: deque[Callable[[], None]] = deque()

    @property
    def cell(self) -> int:
        """Index of the cell in the middle of the array."""
        return min(self._step() // self._steps_a_cell, max(0, len(self._shown.cells) - 1))

    @property
    def update(self) -> int:
        """Number of the update under the finger."""
        return self._shown.number

    @property
    def at_end(self) -> bool:
        """Whether the last cell has passed."""
        return self._left(self._step()) >= self._dots.shape[1]

    @property
    def keys(self) -> dict[str, Callable[[], None]]:
        """Commands to BRLTTY and to the finger, callable from any thread."""
        send = self.connection.send
        return {
            "right": lambda: send("fwinrt"),
            "left": lambda: send("fwinlt"),
            "n": lambda: send("lndn"),
            "p": lambda: send("lnup"),
            "h": lambda: send("home"),
            "\n": lambda: send(f"route {self.cell}"),
            "\r": lambda: send(f"route {self.cell}"),
            "r": lambda: self._asked.append(lambda: self._go_to(0)),
            "]": lambda: self._asked.append(lambda: self._go_to(self.cell + 1)),
            "[": lambda: self._asked.append(lambda: self._go_to(max(0, self.cell - 1))),
            " ": lambda: self._asked.append(self._toggle_pause),
        }

    def read(self, time_ns: int) -> Stimulus | None:
        """Return the cells under the array at a time; stale while BRLTTY is away."""
        shown, age_ns = self.connection.shown, 0
        elapsed_s = 0.0 if self._before_ns is None else (time_ns - self._before_ns) / 1e9
        self._before_ns = time_ns
        while self._asked:
            self._asked.popleft()()
        if shown is not None and shown != self._shown:
            age_ns = max(0, time.perf_counter_ns() - shown.time_ns)
            self._take(shown)
        elif shown is not None and not self._paused:
            self._since_s += elapsed_s
        if self._pan and not self._panned and self._shown.length and self.at_end:
            self._panned = True
            self.connection.send("fwinrt")
        step = self._step()
        if self._place != (self._shown.number, step):
            self._place = (self._shown.number, step)
            self.frames += 1
        window = self._window(step)
        self.title: str = f"{self._name}: {self._shown.text if shown else 'waiting for it'}"
        activation = np.zeros((len(Afferent), window.size), np.float32)
        activation[:] = window.ravel()
        return Stimulus(
            activation, time_ns, self._press_n, pose=self._pose(step), number=self.frames - 1,
            age_ns=age_ns, stale=shown is None, image=self._image(window),
        )  # fmt: skip

    def close(self) -> None:
        """Close the connection to BRLTTY."""
        self.connection.close()

    def _toggle_pause(self) -> None:
        self._paused = not self._paused

    def _go_to(self, cell: int) -> None:
        self._jumps += 1
        self._first, self._since_s, self._panned = cell, 0.0, False

    def _take(self, shown: DisplayContent) -> None:
        """Take over what BRLTTY shows, and go to its first new cell."""
        before, self._shown = self._shown, shown
        if shown.number == before.number:
            return
        missed = shown.number - before.number - 1
        self.frames += missed
        self.dropped_frames += missed
        layout = self.layout
        rows, columns = layout.dots_of(shown.cells, layout.columns if self.apart else layout.cell)
        columns = columns + self.layout.margin * self.apart
        width = shown.length * (layout.columns if self.apart else layout.cell)
        self._dots = np.zeros((layout.rows, max(width, 1)), np.bool_)
        self._dots[rows, columns] = True
        new, cursor = shown.first_new(before), shown.cursor
        if new is None and cursor is not None and cursor != self._cursor:
            new = cursor
        self._cursor = self._cursor if cursor is None else cursor
        if new is not None:
            self._go_to(new)

    def _step(self) -> int:
        """Return the number of steps from the first cell to the finger."""
        moved_s = self._since_s if self.apart else max(0.0, self._since_s - REST_S)
        step = self._first * self._steps_a_cell + int(moved_s * self._steps_a_s + 1e-6)
        # Motion ends behind the last cell.
        end = self._shown.length * self._steps_a_cell + self.layout.margin * (not self.apart)
        return min(step, end)

    def _left(self, step: int) -> int:
        """Return the column of the text at the array's left edge."""
        return step * self.layout.columns if self.apart else step - self.layout.margin

    def _pose(self, step: int) -> Pose:
        """Return the place of the array's middle on a sheet where every jump is a line."""
        layout = self.layout
        across, down = layout.pitch_mm
        line_mm = layout.rows * down + LINE_GAP_MM
        return Pose((self._left(step) + layout.columns / 2) * across, self._jumps * line_mm)

    def _image(self, window: NDArray[np.bool_]) -> NDArray[np.uint8]:
        """Return dots dark on white, as large as the frames of the profile."""
        light = np.where(window, 0, 255).astype(np.uint8)
        return np.asarray(cv2.resize(light, self._shape, interpolation=cv2.INTER_NEAREST), np.uint8)

    def _window(self, step: int) -> NDArray[np.bool_]:
        """Return the dots under the array, (rows, columns)."""
        layout = self.layout
        window = np.zeros((layout.rows, layout.columns), np.bool_)
        if self.apart and (self._since_s * self._steps_a_s + 1e-6) % 1 < GAP:
            # Two equal cells would be felt as one.
            return window
        left = self._left(step)
        first, last = max(left, 0), min(left + layout.columns, self._dots.shape[1])
        if first < last:
            window[:, first - left : last - left] = self._dots[:, first:last]
        return window
