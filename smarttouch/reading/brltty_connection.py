"""Connection to BRLTTY's virtual Braille display, and its messages.

The host sends ``cells 20``, names of BRLTTY's commands, and ``quit``. BRLTTY sends the content of
the display as ``Visual "Hello"`` and ``Braille "1257|15|123|123|135"``, the dots of each cell
between bars and a space where there are none; quotes and backslashes follow a backslash.
"""

import contextlib
import re
import select
import socket
import threading
import time
from dataclasses import dataclass, replace
from typing import Self

from smarttouch.base.errors import SourceError
from smarttouch.braille.cells import BLANK

LONGEST_LINE = 16_384  # most bytes of a line; longer ones are dropped
MOST_CELLS = 255
_MESSAGE = re.compile(r'(Braille|Visual) "(.*)"')
_DOTS = re.compile(r" ?|1?2?3?4?5?6?7?8?")
_CURSOR = 0b1100_0000


@dataclass(frozen=True)
class DisplayContent:
    """Content of the display: cells, their text, the count of updates, and when it arrived."""

    cells: str = ""
    text: str = ""
    number: int = 0
    time_ns: int = 0  # of time.perf_counter_ns; 0 if unknown

    @property
    def cursor(self) -> int | None:
        """Index of the cursor, the only cell with dots 7 and 8; None without one."""
        under = [index for index, cell in enumerate(self.cells) if ord(cell) & _CURSOR == _CURSOR]
        return under[0] if len(under) == 1 else None

    @property
    def length(self) -> int:
        """Number of cells up to the last that is not blank."""
        return len(self.cells.rstrip(BLANK))

    def first_new(self, before: "DisplayContent") -> int | None:
        """Return the first cell to be presented again; None if nothing but a cursor has changed.

        A cursor at the first change or right behind it means typing: that cell; otherwise the
        line is another one, presented from its beginning.
        """
        size = max(len(self.cells), len(before.cells))
        now, former = (each.cells.ljust(size, BLANK) for each in (self, before))
        for index, (cell, other) in enumerate(zip(now, former, strict=True)):
            if (ord(cell) ^ ord(other)) & ~_CURSOR:
                cursor = self.cursor
                return index if cursor is not None and 0 <= cursor - index <= 1 else 0
        return None


class BrlttyMessages:
    """Parser of lines that arrive in pieces of any length; what is no message is dropped."""

    def __init__(self, shown: DisplayContent | None = None) -> None:
        self.shown: DisplayContent = shown or DisplayContent()
        self._rest = b""

    def feed(self, data: bytes) -> None:
        """Parse the bytes that have arrived."""
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest if len(rest) <= LONGEST_LINE else b""
        for line in lines:
            self._take(line.decode("utf-8", "replace").rstrip("\r"))

    def _take(self, line: str) -> None:
        found = _MESSAGE.fullmatch(line)
        kind, content = found.groups() if found else ("", "")
        if kind == "Visual":
            self.shown = replace(self.shown, text=re.sub(r"\\(.)", r"\1", content).rstrip())
        dots = content.split("|")
        if kind == "Braille" and len(dots) <= MOST_CELLS and all(map(_DOTS.fullmatch, dots)):
            cells = "".join(
                chr(ord(BLANK) + sum(1 << (int(dot) - 1) for dot in cell.strip())) for cell in dots
            )
            number, now_ns = self.shown.number + 1, time.perf_counter_ns()
            self.shown = replace(self.shown, cells=cells, number=number, time_ns=now_ns)


USUAL_PORT = 35752  # port to which BRLTTY's virtual driver connects by default
AGAIN_S = 0.25  # interval between attempts, and longest time until a close is noticed
JOIN_S = 1.0


@dataclass(frozen=True)
class Address:
    """Address at which BRLTTY and this end meet; the one that ``listens`` may be this end."""

    host: str
    port: int
    listens: bool

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the address in ``HOST:PORT``, ``listen:PORT`` or ``listen:HOST:PORT``."""
        first, _, rest = text.partition(":")
        listens = first in ("", "listen")
        host, _, port = (rest if listens else text).rpartition(":")
        host = host.strip("[]") or "127.0.0.1"
        number = int(port or USUAL_PORT) if re.fullmatch(r"\d{0,5}", port) else 0
        if not 0 < number < 65536:
            raise SourceError(
                f"{text!r} is not an address of BRLTTY: give listen:PORT, listen:HOST:PORT or "
                f"HOST:PORT, as in listen:{USUAL_PORT}"
            )
        return cls(host, number, listens)

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"


class BrlttyConnection:
    """Keeps the newest cells and sends commands; survives BRLTTY's restarts.

    ``cells`` is the width reported to BRLTTY, and ``shown`` its newest content, None without a
    connection.
    """

    def __init__(self, address: Address, cells: int) -> None:
        if not 1 <= cells <= MOST_CELLS:
            raise SourceError(f"a display of {cells} cells is not possible: give 1 to {MOST_CELLS}")
        self.address: Address = address
        self.cells: int = cells
        self.shown: DisplayContent | None = None
        self._closing = threading.Event()
        self._line: socket.socket | None = None
        self._listener: socket.socket | None = None
        self._thread = threading.Thread(target=self._keep, name="brltty", daemon=True)

    def open(self) -> Self:
        """Listen, or connect for the first time."""
        where = (self.address.host, self.address.port)
        try:
            if self.address.listens:
                self._listener = socket.create_server(where, backlog=1)
                self._listener.settimeout(AGAIN_S)
            else:
                self._line = socket.create_connection(where, timeout=AGAIN_S)
        except (OSError, UnicodeError) as error:
            verb, remedy = (
                ("listen", "give another port, as in listen:4101")
                if self.address.listens
                else ("connect", f"start brltty -b vr -d server:{self.address} first")
            )
            reason = getattr(error, "strerror", None) or error
            raise SourceError(f"cannot {verb} at {self.address}: {reason}: {remedy}") from None
        self._thread.start()
        return self

    def send(self, command: str) -> None:
        """Send a command of BRLTTY's, such as ``fwinrt``; it is dropped without a connection."""
        line = self._line
        if line is not None:
            with contextlib.suppress(OSError):
                line.sendall(f"{command}\r\n".encode())

    def close(self) -> None:
        """End the connection; BRLTTY tries to reconnect by itself."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join(JOIN_S)

    def _keep(self) -> None:
        """Hold the connection until closing; sockets are closed by this thread alone."""
        shown = DisplayContent()
        with self._listener or contextlib.nullcontext():
            while not self._closing.is_set():
                line = self._line or self._connect()
                if line is not None:
                    with line, contextlib.suppress(OSError):
                        shown = self._serve(line, shown)
                    self.shown = self._line = None

    def _connect(self) -> socket.socket | None:
        """Return a connection, or None if there is none yet."""
        with contextlib.suppress(OSError):
            if self._listener is not None:
                self._line = self._listener.accept()[0]
            else:
                self._closing.wait(AGAIN_S)
                where = (self.address.host, self.address.port)
                self._line = socket.create_connection(where, timeout=AGAIN_S)
        return self._line

    def _serve(self, line: socket.socket, shown: DisplayContent) -> DisplayContent:
        """Read messages until the connection ends; return the last content."""
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        line.settimeout(None)
        line.sendall(f"cells {self.cells}\r\n".encode())
        messages = BrlttyMessages(DisplayContent(number=shown.number))
        with contextlib.suppress(OSError):
            while not self._closing.is_set():
                if select.select([line], [], [], AGAIN_S)[0]:
                    data = line.recv(65536)
                    if not data:
                        break
                    messages.feed(data)
                    if messages.shown.number > shown.number:
                        self.shown = messages.shown
        return messages.shown
