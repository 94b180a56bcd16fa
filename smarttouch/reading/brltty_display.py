"""``brltty:``: Braille display for the screen reader BRLTTY.

BRLTTY's virtual driver connects to a port of this process. The display sends ``cells 20`` and names
of BRLTTY's commands. BRLTTY sends the content of the display as ``Visual "Hello"`` and
``Braille "1257|15|123|123|135"``: the dots of each cell, separated by bars, with a space for an
empty cell. A backslash escapes quotes and backslashes. BrlAPI does not suffice, because its clients
cannot read the content of a display.
"""

import contextlib
import re
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import SourceError, require_within
from smarttouch.braille.cells import BLANK
from smarttouch.imaging.reading_profile import reading_force_n, usual_speed_mm_s
from smarttouch.pages.page_and_lines import Page
from smarttouch.profile import Profile
from smarttouch.reading.braille_lines import CellLayout, cell_layout
from smarttouch.reading.line_source import FASTEST_MM_S, LINE_GAP_MM, SLOWEST_MM_S
from smarttouch.sources.source_contract import Pose, Sheet, Stimulus, StimulusSource

LONGEST_LINE = 16_384  # longest message, bytes
MOST_CELLS = 255
USUAL_CELLS, USUAL_PORT = 20, 35752  # BRLTTY's virtual driver uses port 35752 by default
_DOT_PX = 4  # side of a dot in the picture of a line
REST_S = 0.3  # rest on the first cell after a jump
_ACCEPT_S, _JOIN_S = 0.05, 1.0
_MESSAGE = re.compile(r'(Braille|Visual) "(.*)"\s*')
_DOTS = re.compile(r" ?|1?2?3?4?5?6?7?8?")
_CURSOR = 0b1100_0000


@dataclass(frozen=True)
class DisplayContent:
    """Content of the display: cells, text, number of the update, and time of arrival."""

    cells: str = ""
    text: str = ""
    number: int = 0
    time_ns: int = 0  # by time.perf_counter_ns; 0 if unknown

    @property
    def cursor(self) -> int | None:
        """Index of the cell with the cursor (the only cell with dots 7 and 8), or None."""
        under = [index for index, cell in enumerate(self.cells) if ord(cell) & _CURSOR == _CURSOR]
        return under[0] if len(under) == 1 else None

    def first_new(self, before: "DisplayContent") -> int | None:
        """Return the index of the first cell to present; None if nothing but the cursor changed.

        If the cursor is at the first changed cell or directly after it, the user is typing. In this
        case, return the index of the first changed cell. Otherwise, return 0 (start of the line).
        """
        size = max(len(self.cells), len(before.cells))
        now, former = (content.cells.ljust(size, BLANK) for content in (self, before))
        for index, (cell, other) in enumerate(zip(now, former, strict=True)):
            if (ord(cell) ^ ord(other)) & ~_CURSOR:
                cursor = self.cursor
                return index if cursor is not None and 0 <= cursor - index <= 1 else 0
        return None


def parse_message(line: bytes) -> tuple[str, str]:
    """Parse a message: return its kind, ``Visual`` or ``Braille``, and its text or cells. Returns
    two empty strings if the line is not a message."""
    match = _MESSAGE.fullmatch(line.decode("utf-8", "replace"))
    kind, content = match.groups() if match else ("", "")
    if kind != "Braille":
        return kind, re.sub(r"\\(.)", r"\1", content).rstrip()
    dots = content.split("|")
    if len(dots) > MOST_CELLS or not all(map(_DOTS.fullmatch, dots)):
        return "", ""
    patterns = (sum(1 << (int(dot) - 1) for dot in cell.strip()) for cell in dots)
    return kind, "".join(chr(ord(BLANK) + pattern) for pattern in patterns)


class BrailleDisplaySource(StimulusSource):
    """Source of the cells that BRLTTY shows, with one electrode for each dot.

    After a change, the finger moves over the cells up to the end of the line. It starts at the cell
    that `DisplayContent.first_new` returns. If only the cursor moved, it starts at the cursor.
    Without a connection, nothing is presented.

    Parameters
    ----------
    address : str
        ``PORT`` or ``HOST:PORT`` of this machine, where BRLTTY connects; the default is 35752.
    profile : Profile
        Result of `profile_for_reading`.
    cells : int
        Number of cells that the display reports to BRLTTY.
    speed_mm_s : float, mm/s, optional
        Speed of the cells under the finger; by default derived from the profile's pulse rate.

    Attributes
    ----------
    shown : DisplayContent, optional
        Current content; None without a connection.
    """

    knows_force = True
    ended = "the display is switched off"
    keys_help = "← →  window    n p  line    [ ]  cell    r  again    Enter  route    h  cursor    "

    def __init__(
        self,
        address: str,
        profile: Profile,
        *,
        cells: int = USUAL_CELLS,
        speed_mm_s: float | None = None,
    ) -> None:
        host, _, port = address.rpartition(":")
        number = int(port or USUAL_PORT) if re.fullmatch(r"\d{0,5}", port) else 0
        if not 0 < number < 65536:
            raise SourceError(
                f"{address!r} is not an address: give PORT or HOST:PORT, for example {USUAL_PORT}"
            )
        if not 1 <= cells <= MOST_CELLS:
            raise SourceError(f"a display cannot have {cells} cells: give 1 to {MOST_CELLS}")
        self.address: tuple[str, int] = (host.strip("[]") or "127.0.0.1", number)
        where = ":".join(map(str, self.address))
        super().__init__(f"BRLTTY at {where}")
        speed_mm_s = usual_speed_mm_s(profile) if speed_mm_s is None else speed_mm_s
        require_within(SourceError, "speed_mm_s", speed_mm_s, SLOWEST_MM_S, FASTEST_MM_S)
        self.layout: CellLayout = cell_layout(profile, eight=True)
        self.shown: DisplayContent | None = None
        self._cells, self._name = cells, self.title
        self._press_n = reading_force_n(profile)
        self._shape = (profile.optics.sensor_columns, profile.optics.sensor_rows)
        self._columns_a_s = speed_mm_s / self.layout.pitch_mm[0]
        self._taken = DisplayContent()
        self._dots = np.zeros((self.layout.rows, 0), np.bool_)
        self._first, self._since_s = 0, 0.0
        """Cell at the start of the motion, and duration of the motion."""
        self._cursor: int | None = None
        self._before_ns: int | None = None
        self._paused = False
        self._jumps = 0
        self._place: tuple[int, int] | None = None
        self._asked: deque[Callable[[], None]] = deque()
        self._closing = threading.Event()
        self._line: socket.socket | None = None
        try:
            listener = socket.create_server(self.address, backlog=1)
        except (OSError, UnicodeError) as error:
            reason = getattr(error, "strerror", None) or error
            raise SourceError(f"cannot listen at {where}: {reason}: give another port") from None
        listener.settimeout(_ACCEPT_S)
        self._thread = threading.Thread(target=self._listen, args=(listener,), daemon=True)
        self._thread.start()

    def _listen(self, listener: socket.socket) -> None:
        """Accept connections from BRLTTY."""
        with listener:
            while not self._closing.is_set():
                with contextlib.suppress(OSError), listener.accept()[0] as line:
                    self._serve(line)
                self.shown = self._line = None

    def _serve(self, line: socket.socket) -> None:
        """Read messages until the connection ends."""
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        line.settimeout(None)
        line.sendall(f"cells {self._cells}\r\n".encode())
        self._line = line
        text, number = "", self._taken.number
        with line.makefile("rb") as messages:
            while not self._closing.is_set() and (data := messages.readline(LONGEST_LINE)):
                kind, content = parse_message(data)
                if kind == "Visual":
                    text = content
                elif kind == "Braille":
                    number += 1
                    self.shown = DisplayContent(content, text, number, time.perf_counter_ns())

    def send(self, command: str) -> None:
        """Send a command to BRLTTY, such as ``fwinrt``. Does nothing without a connection."""
        line = self._line
        if line is not None:
            with contextlib.suppress(OSError):
                line.sendall(f"{command}\r\n".encode())

    def close(self) -> None:
        """Close the connection."""
        self._closing.set()
        if self._line is not None:
            with contextlib.suppress(OSError):
                self._line.shutdown(socket.SHUT_RDWR)
        self._thread.join(_JOIN_S)

    @property
    def cell(self) -> int:
        """Index of the cell in the middle of the array."""
        return min(self._step() // self.layout.cell, max(0, len(self._taken.cells) - 1))

    @property
    def keys(self) -> dict[str, Callable[[], None]]:
        """The function of each key. The functions send commands to BRLTTY or move the finger. Any
        thread can call them."""
        commands = {"right": "fwinrt", "left": "fwinlt", "n": "lndn", "p": "lnup", "h": "home"}
        return {
            **{key: partial(self.send, command) for key, command in commands.items()},
            "\n": lambda: self.send(f"route {self.cell}"),
            "\r": lambda: self.send(f"route {self.cell}"),
            "r": lambda: self._asked.append(lambda: self._go_to(0)),
            "]": lambda: self._asked.append(lambda: self._go_to(self.cell + 1)),
            "[": lambda: self._asked.append(lambda: self._go_to(max(0, self.cell - 1))),
            " ": lambda: self._asked.append(self._toggle_pause),
        }

    @property
    def sheet(self) -> Sheet | None:
        """Return the line of dots under the finger."""
        if not self._dots.size:
            return None
        (rows, columns), (across, down) = self._dots.shape, self.layout.pitch_mm
        size = (_DOT_PX * columns, round(_DOT_PX * rows * down / across))
        light = np.where(self._dots, 0, 255).astype(np.uint8)
        grey = np.asarray(cv2.resize(light, size, interpolation=cv2.INTER_NEAREST), np.uint8)
        top_mm = self._jumps * (rows * down + LINE_GAP_MM) - rows * down / 2
        # A jump or an update increases one of these counts, so the sheet gets a new number.
        number = self._jumps + self._taken.number
        return Sheet(number, Page(grey, across / _DOT_PX), (0.0, top_mm))

    def read(self, time_ns: int) -> Stimulus | None:
        """Return a stimulus with the dots under the array, marked as stale without a connection."""
        shown, age_ns = self.shown, 0
        elapsed_s = 0.0 if self._before_ns is None else (time_ns - self._before_ns) / 1e9
        self._before_ns = time_ns
        while self._asked:
            self._asked.popleft()()
        if shown is not None and shown != self._taken:
            age_ns = max(0, time.perf_counter_ns() - shown.time_ns)
            self._take(shown)
        elif shown is not None and not self._paused:
            self._since_s += elapsed_s
        step, layout = self._step(), self.layout
        if self._place != (self._taken.number, step):
            self._place = (self._taken.number, step)
            self.frames += 1
        self.title: str = f"{self._name}: {self._taken.text if shown else 'not connected'}"
        # Copy the dots under the array. Columns outside of the text stay blank.
        left = step - layout.margin
        window = np.zeros((layout.rows, layout.columns), np.bool_)
        first, last = max(left, 0), min(left + layout.columns, self._dots.shape[1])
        window[:, first - left : max(first, last) - left] = self._dots[:, first:last]
        light = np.where(window, 0, 255).astype(np.uint8)
        image = cv2.resize(light, self._shape, interpolation=cv2.INTER_NEAREST)
        activation = np.zeros((len(Afferent), window.size), np.float32)
        activation[:] = window.ravel()
        # Poses are places on a sheet. Each jump begins a new line on it, below the previous line.
        across, down = layout.pitch_mm
        pose = Pose(
            (left + layout.columns / 2) * across, self._jumps * (layout.rows * down + LINE_GAP_MM)
        )
        return Stimulus(
            activation, time_ns, self._press_n, pose=pose, number=self.frames - 1,
            age_ns=age_ns, stale=shown is None, image=np.asarray(image, np.uint8),
        )  # fmt: skip

    def _toggle_pause(self) -> None:
        self._paused = not self._paused

    def _go_to(self, cell: int) -> None:
        self._jumps += 1
        self._first, self._since_s = cell, 0.0

    def _take(self, shown: DisplayContent) -> None:
        """Store new content, and go to the first cell to present."""
        before, self._taken = self._taken, shown
        if shown.number == before.number:
            return
        missed = shown.number - before.number - 1
        self.frames += missed
        self.dropped_frames += missed
        rows, columns = self.layout.dots_of(shown.cells)
        width = len(shown.cells.rstrip(BLANK)) * self.layout.cell
        self._dots = np.zeros((self.layout.rows, width), np.bool_)
        self._dots[rows, columns] = True
        new, cursor = shown.first_new(before), shown.cursor
        if new is None and cursor is not None and cursor != self._cursor:
            new = cursor
        self._cursor = self._cursor if cursor is None else cursor
        if new is not None:
            self._go_to(new)

    def _step(self) -> int:
        """Return the index of the column of dots that is in the middle of the array. It increases
        with time until it is `margin` columns after the text."""
        moved_s = max(0.0, self._since_s - REST_S)
        step = self._first * self.layout.cell + int(moved_s * self._columns_a_s + 1e-6)
        return min(step, self._dots.shape[1] + self.layout.margin)
