"""Connection to BRLTTY: kept on a thread, made again whenever it is lost."""

import contextlib
import re
import select
import socket
import threading
import time
from dataclasses import dataclass, replace
from typing import Self

from smarttouch.braille_display.messages import MOST_CELLS, BrlttyMessages, DisplayContent
from smarttouch.errors import SourceError

USUAL_PORT = 35752
"""Port to which BRLTTY's virtual driver connects by default."""
AGAIN_S = 0.25
"""Interval between attempts, and longest time until a close is noticed."""
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
                f"HOST:PORT, as in listen:{USUAL_PORT}",
                about="address",
            )
        return cls(host, number, listens)

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"


class BrlttyConnection:
    """Keeps the newest cells and sends commands; survives BRLTTY's restarts.

    ``cells`` is the width reported to BRLTTY, ``shown`` its newest content, None without a
    connection, and ``connections`` the number made so far.
    """

    def __init__(self, address: Address, cells: int) -> None:
        if not 1 <= cells <= MOST_CELLS:
            raise SourceError(
                f"a display of {cells} cells is not possible: give 1 to {MOST_CELLS}", about="cells"
            )
        self.address, self.cells = address, cells
        self.shown: DisplayContent | None = None
        self.connections = 0
        self.garbled = 0
        self._number = 0
        self._closing = False
        self._line: socket.socket | None = None
        self._listener: socket.socket | None = None
        self._thread = threading.Thread(target=self._keep, name="brltty", daemon=True)

    def open(self) -> Self:
        """Listen, or connect for the first time."""
        where = (self.address.host, self.address.port)
        try:
            if self.address.listens:
                self._listener = socket.create_server(where, backlog=1)
            else:
                self._line = socket.create_connection(where, timeout=AGAIN_S)
        except (OSError, UnicodeError) as error:
            remedy = (
                "give another port, as in listen:4101"
                if self.address.listens
                else f"start brltty -b vr -d server:{self.address} first"
            )
            raise SourceError(
                f"cannot {'listen' if self.address.listens else 'connect'} at {self.address}: "
                f"{getattr(error, 'strerror', None) or error}: {remedy}",
                about="address",
            ) from None
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
        self._closing = True
        if self._thread.is_alive():
            self._thread.join(JOIN_S)

    def _keep(self) -> None:
        """Hold the connection until closing; sockets are closed by this thread alone."""
        try:
            self._hold()
        finally:
            for each in (self._line, self._listener):
                if each is not None:
                    each.close()
            self._line = None

    def _hold(self) -> None:
        wait = threading.Event()
        while not self._closing:
            line = self._line or self._connect()
            if line is None:
                wait.wait(AGAIN_S * (self._listener is None))
                continue
            self.connections += 1
            with contextlib.suppress(OSError):
                self._serve(line)
            self.shown = None
            self._line = None
            line.close()

    def _connect(self) -> socket.socket | None:
        with contextlib.suppress(OSError):
            if self._listener is None:
                where = (self.address.host, self.address.port)
                self._line = socket.create_connection(where, timeout=AGAIN_S)
            elif select.select([self._listener], [], [], AGAIN_S)[0]:
                self._line = self._listener.accept()[0]
        return self._line

    def _serve(self, line: socket.socket) -> None:
        """Read messages until the connection ends."""
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        line.settimeout(None)
        line.sendall(f"cells {self.cells}\r\n".encode())
        messages = BrlttyMessages()
        while not self._closing:
            if not select.select([line], [], [], AGAIN_S)[0]:
                continue
            data = line.recv(65536)
            if not data:
                return
            updates, garbled = messages.shown.number, messages.garbled
            messages.feed(data)
            shown = messages.shown
            self.garbled += messages.garbled - garbled
            if shown.number:
                self._number += shown.number - updates
                now_ns = time.perf_counter_ns()
                self.shown = replace(shown, number=self._number, time_ns=now_ns)
