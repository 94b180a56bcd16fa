"""Keeps an emulated sensor on a line: as long as there is a host, and a while longer."""

import contextlib
import math
import os
import select
import signal
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from smarttouch.errors import SensorError
from smarttouch.sources.emulator.devices import Device
from smarttouch.sources.emulator.faults import Fault, Faults, parse_fault
from smarttouch.wire.pty_line import PtyLine

FIRST_HOST_S = 8.0
"""How much longer than its lingering it waits for the first host."""
_ALOFT_S = 0.0005
"""How soon the rest of a packet is tried again."""
_LONGEST_WAIT_S = 0.02
_BEHIND_NS = 100_000_000
"""After such a delay it goes on from now: hardware would not send in a burst."""


@dataclass
class Books:
    """What it sent, counted when the last byte had been taken."""

    sent: int = 0
    dropped: int = 0
    """Taken, but not sent: the line was still full."""
    garbage: int = 0


class Socket:
    """Where the device is plugged in, and its port for the host.

    Parameters
    ----------
    may_unplug : bool
        Whether the port's name must stay valid when the device is plugged in again.
    """

    def __init__(self, may_unplug: bool) -> None:
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        if may_unplug:
            self._folder = tempfile.TemporaryDirectory(prefix="smarttouch-")
        self._line: _Line | None = None
        self.plug_in()

    @property
    def keeps_name(self) -> bool:
        return self._folder is not None

    @property
    def plugged_in(self) -> bool:
        return self._line is not None

    @property
    def name(self) -> str:
        assert self._line is not None
        return self._line.name if self._folder is None else str(self._link())

    def plug_in(self) -> None:
        """Have a port."""
        self._line = _Line()
        if self._folder is not None:
            self._link().symlink_to(self._line.name)

    def pull_out(self) -> None:
        """Have none: the host's end hangs up."""
        if self._folder is not None:
            self._link().unlink(missing_ok=True)
        if self._line is not None:
            self._line.hang_up()
        self._line = None

    def close(self) -> None:
        """Leave nothing behind."""
        self.pull_out()
        if self._folder is not None:
            self._folder.cleanup()

    def wait(self, timeout_s: float) -> bool:
        """Wait; return whether there is a host."""
        if self._line is None:
            time.sleep(timeout_s)
            return False
        return self._line.read(timeout_s) is not None

    def write(self, data: bytes) -> bytes:
        """Write what fits; return the rest."""
        return b"" if self._line is None else self._line.write(data)

    def _link(self) -> Path:
        assert self._folder is not None
        return Path(self._folder.name) / "port"


class _Line(PtyLine):
    def hang_up(self) -> None:
        os.close(self._master)


class Orders:
    """Lines on standard input, as long as it is open."""

    def __init__(self) -> None:
        self._open = sys.stdin is not None
        self._waiting = b""

    def read(self) -> list[str]:
        """Return the lines that have come, without waiting."""
        try:
            if not self._open or not select.select([0], [], [], 0)[0]:
                return []
            data = os.read(0, 4096)
        except OSError:
            data = b""
        self._open = bool(data)
        *lines, self._waiting = (self._waiting + data).split(b"\n")
        return [line.decode("utf-8", "replace").strip() for line in lines if line.strip()]


class Server:
    """Sends what a device has at absolute deadlines.

    What is due while the line is still full is dropped, never queued.

    Parameters
    ----------
    device : Device
    socket : Socket
    faults : Faults
    rate_hz : float
    count : int, optional
        Falls silent after so many were sent in full.
    orders : Orders, optional
        Standard input if not given.
    """

    def __init__(
        self,
        device: Device,
        socket: Socket,
        faults: Faults,
        rate_hz: float,
        count: int | None = None,
        orders: Orders | None = None,
    ) -> None:
        self.books = Books()
        self._device, self._socket, self._faults = device, socket, faults
        self._period_ns = 1e9 / rate_hz
        self._count = math.inf if count is None else count
        self._orders = orders or Orders()
        self._start_ns: int | None = None
        self._next_ns = 0.0
        self._number = 0
        self._pending = b""
        self._pending_is_garbage = False

    def serve(self, linger_s: float, parent: int | None = None) -> None:
        """Print the port's name and run until SIGTERM or SIGINT, or so long without a host.

        With the process id of its ``parent`` it ends too when that has, even where it was killed.
        """
        ended: list[int] = []

        def end(number: int, _frame: FrameType | None) -> None:
            ended.append(number)

        for each in (signal.SIGTERM, signal.SIGINT):
            signal.signal(each, end)
        # Who reads the name may signal at once.
        print(self._socket.name, flush=True)
        patience_s = linger_s + FIRST_HOST_S
        alone_since = time.monotonic()
        while not ended and parent in (None, os.getppid()):
            present = self._socket.wait(self._wait_s())
            if present:
                patience_s = linger_s
            if present or not self._socket.plugged_in:
                alone_since = time.monotonic()
            elif time.monotonic() - alone_since > patience_s:
                break
            self.advance(time.perf_counter_ns(), present)

    def advance(self, now_ns: int, present: bool) -> None:
        """Do what is due now; ``present`` says whether there is a host."""
        if present and self._start_ns is None:
            self._start_ns = now_ns
            self._next_ns = now_ns
        time_s = 0.0 if self._start_ns is None else (now_ns - self._start_ns) / 1e9
        self._obey(time_s)
        wrong = self._faults.at(time_s) if self._start_ns is not None else frozenset()
        if ("unplug" in wrong) is self._socket.plugged_in:
            self._replug()
            present = False
        if not present or "silent" in wrong or self.books.sent >= self._count:
            # The rest of a packet goes with a host that is gone, not with one that waits.
            self._pending = self._pending if present else b""
            self._next_ns = now_ns + self._period_ns
            self._push()
            return
        self._push()
        if now_ns < self._next_ns:
            return
        if now_ns - self._next_ns > _BEHIND_NS:
            self._next_ns = now_ns
        self._next_ns += self._period_ns
        number, self._number = self._number, self._number + 1
        if self._pending:
            self.books.dropped += 1
            return
        self._pending = self._device.packet(number, time_s, wrong)
        self._pending_is_garbage = "garbage" in wrong
        self._push()

    def _push(self) -> None:
        if not self._pending:
            return
        self._pending = self._socket.write(self._pending)
        if self._pending:
            return
        if self._pending_is_garbage:
            self.books.garbage += 1
        else:
            self.books.sent += 1

    def _wait_s(self) -> float:
        if self._pending:
            return _ALOFT_S
        left_s = (self._next_ns - time.perf_counter_ns()) / 1e9
        return min(max(left_s, 0.0), _LONGEST_WAIT_S)

    def _replug(self) -> None:
        if self._socket.plugged_in:
            self._socket.pull_out()
        else:
            self._socket.plug_in()

    def _add(self, fault: Fault) -> None:
        if fault.kind == "unplug" and not self._socket.keeps_name:
            raise SensorError(
                "the port's name would change: start it with --event '0 unplug 0'",
                about="event",
                problem="impossible",
                value=fault.kind,
                remedy="--event",
            )
        self._faults.add(fault)

    def _obey(self, time_s: float) -> None:
        for line in self._orders.read():
            with contextlib.suppress(BrokenPipeError):
                try:
                    if not self._device.heed(line.split()):
                        self._add(parse_fault(f"{time_s:.6f} {line}"))
                except SensorError as error:
                    print(error, file=sys.stderr, flush=True)
