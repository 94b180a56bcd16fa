"""Keeps an emulated board on a line: as long as there is a host, and a while longer."""

import math
import os
import select
import signal
import socket
import time
from types import FrameType
from typing import Protocol

from smarttouch.boards.emulator.books import Books

FIRST_HOST_S = 8.0
"""How much longer than its lingering it waits for the first host."""
_WRITE_EVERY_NS = 50_000_000
_LONGEST_STEP_NS = 10_000_000
_LARGEST_READ = 65536


class Firmware(Protocol):
    """What runs on a board; it has no clock of its own."""

    books: Books

    @property
    def busy(self) -> bool: ...

    def feed(self, data: bytes, now_ns: int) -> bytes: ...

    def advance(self, now_ns: int) -> bytes: ...

    def hang_up(self, now_ns: int) -> None: ...

    def zero(self, reason: str, now_ns: int) -> None: ...


class Line(Protocol):
    """What a board hangs on."""

    name: str

    def read(self, timeout_s: float) -> bytes | None:
        """Return what has come, empty if nothing; None while there is no host."""

    def write(self, data: bytes) -> bytes:
        """Write what fits; return the rest."""


class TcpLine:
    """A TCP port of this machine, for one host at a time.

    Parameters
    ----------
    discovery_port : int, optional
        UDP port on which ``ETK?`` is answered.
    """

    def __init__(self, discovery_port: int | None = None) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0), backlog=1)
        self._port = int(self._listener.getsockname()[1])
        self.name = f"tcp://127.0.0.1:{self._port}"
        self._host: socket.socket | None = None
        self._discovery: socket.socket | None = None
        if discovery_port is not None:
            self._discovery = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._discovery.bind(("127.0.0.1", discovery_port))

    def read(self, timeout_s: float) -> bytes | None:
        line = self._host or self._listener
        watched = [line] if self._discovery is None else [line, self._discovery]
        ready = select.select(watched, [], [], timeout_s)[0]
        if self._discovery in ready:
            self._answer_discovery()
        if self._host is None:
            if self._listener not in ready:
                return None
            self._host = self._listener.accept()[0]
            self._host.setblocking(False)
            self._host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return b""
        if self._host not in ready:
            return b""
        try:
            data = self._host.recv(_LARGEST_READ)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if data:
            return data
        self._host.close()
        self._host = None
        return None

    def write(self, data: bytes) -> bytes:
        if self._host is None:
            return b""
        try:
            return data[self._host.send(data) :]
        except BlockingIOError:
            return data
        except OSError:
            return b""

    def _answer_discovery(self) -> None:
        assert self._discovery is not None
        question, sender = self._discovery.recvfrom(64)
        if question.strip() == b"ETK?":
            busy = int(self._host is not None)
            answer = (
                f"ETK!;id=A1B2C3;name=emulator;ip=127.0.0.1;port={self._port};mode=STA;"
                f"busy={busy};fw=1.0"
            )
            self._discovery.sendto(answer.encode(), sender)


def serve(firmware: Firmware, line: Line, linger_s: float = 2.0, parent: int | None = None) -> None:
    """Print a line's name and run a board on it until SIGTERM, or so long without a host.

    With the process id of its ``parent`` it ends too when that has, even where it was killed.

    Ctrl-C belongs to the host, which ends with a stop and a closed port; it ends the
    board only if that would go on for ever by itself.
    """
    ended: list[int] = []

    def end(number: int, _frame: FrameType | None) -> None:
        ended.append(number)

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, end if math.isinf(linger_s) else signal.SIG_IGN)
    # Who reads the name may signal at once.
    print(line.name, flush=True)
    clock = BoardClock(getattr(firmware, "longest_step_ns", _LONGEST_STEP_NS))
    alone_since: float | None = FIRST_HOST_S * 1e9
    had_host = False
    written_ns, pending = 0, b""
    while not ended:
        if parent is not None and os.getppid() != parent:
            firmware.zero("parent gone", clock.now_ns())
            break
        data = line.read(0.001 if firmware.busy else 0.004)
        now = clock.now_ns()
        firmware.books.stood_still_ms = clock.stood_still_ns / 1e6
        if data is None:
            if had_host:
                had_host, alone_since = False, now
                firmware.hang_up(now)
                firmware.books.write()
            # A board may go on without a host; what it says then, nobody hears.
            firmware.advance(now)
            pending = b""
            if alone_since is not None and now > alone_since + linger_s * 1e9:
                break
        else:
            had_host, alone_since = True, None
            pending += firmware.feed(data, now) if data else firmware.advance(now)
            if pending:
                # A host that never reads loses the oldest answers.
                pending = line.write(pending)[-_LARGEST_READ:]
        if now - written_ns > _WRITE_EVERY_NS:
            firmware.books.write()
            written_ns = now
    if ended:
        firmware.zero("signal", clock.now_ns())
    firmware.books.write()


class BoardClock:
    """The board's time, from 0 on, which stands still while the machine runs other processes.

    Hardware is never kept waiting; what plays it is, and must not take its own
    absence for the host's silence, nor for pulses delivered.

    Parameters
    ----------
    longest_step_ns : int
        How long it may have been away without standing still.
    """

    def __init__(self, longest_step_ns: int = _LONGEST_STEP_NS) -> None:
        self._longest_step_ns = longest_step_ns
        self._begun = self._last = time.monotonic_ns()
        self.stood_still_ns = 0

    def now_ns(self) -> int:
        now = time.monotonic_ns()
        self.stood_still_ns += max(0, now - self._last - self._longest_step_ns)
        self._last = now
        return now - self._begun - self.stood_still_ns
