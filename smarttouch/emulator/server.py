"""Runs an emulated device on a line: as long as there is a host, and a while longer."""

import contextlib
import math
import os
import select
import signal
import sys
from collections.abc import Callable
from types import FrameType

from smarttouch.base.errors import BoardError
from smarttouch.base.wire.device_lines import PtyLine, TcpLine
from smarttouch.emulator.firmware import DeviceClock, Firmware

FIRST_HOST_S = 8.0  # time beyond its lingering that it waits for the first host
_WRITE_EVERY_NS = 50_000_000
_FULL_WAIT_S = 0.0005  # time after which the rest of a message is tried again


class Orders:
    """Lines on standard input, as long as it is open."""

    def __init__(self) -> None:
        # In the background of a terminal, reading must not stop the process.
        signal.signal(signal.SIGTTIN, signal.SIG_IGN)
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
    """Serves one host after another; ``orders`` are for the device."""

    def __init__(
        self, firmware: Firmware, line: PtyLine | TcpLine, orders: Orders | None = None
    ) -> None:
        self._firmware, self._line, self._orders = firmware, line, orders
        self._hosted = False
        self._waiting = b""  # of messages that the line has not taken yet

    def serve(self, linger_s: float = 2.0, describe: Callable[[str], str] = str) -> None:
        """Print the port's name, as ``describe`` words it, and run until SIGTERM, or ``linger_s``
        without a host.

        While there is a host, Ctrl-C is meant for the host, which ends with a stop and a closed
        port. It ends the device only if that would linger for ever.
        """
        ended = False

        def end(number: int, _frame: FrameType | None) -> None:
            nonlocal ended
            ended |= number == signal.SIGTERM or math.isinf(linger_s) or not self._hosted

        signal.signal(signal.SIGTERM, end)
        signal.signal(signal.SIGINT, end)
        self._write_books()
        # Handlers come first: a reader of the name may signal at once.
        print(describe(self._line.name), flush=True)
        clock = DeviceClock(self._firmware.longest_step_ns)
        host_ns, written_ns = FIRST_HOST_S * 1e9, 0
        while not ended:
            data = self._line.read(_FULL_WAIT_S if self._waiting else self._firmware.wait_s(clock))
            now_ns = clock.now_ns()
            if self._firmware.books is not None:
                self._firmware.books.stood_still_ms = clock.stood_still_ns / 1e6
            self.step(data, now_ns)
            if self._hosted:
                host_ns = now_ns
            elif now_ns > host_ns + linger_s * 1e9:
                break
            if now_ns - written_ns > _WRITE_EVERY_NS:
                self._write_books()
                written_ns = now_ns
        if ended:
            self._firmware.zero("signal", clock.now_ns())
        self._write_books()

    def step(self, data: bytes | None, now_ns: int) -> None:
        """Execute what is due, with the bytes of the host; None if there is no host."""
        firmware, had_host = self._firmware, self._hosted
        self._hosted = data is not None
        self._obey()
        if data is None:
            self._waiting = b""
            if had_host:
                firmware.hang_up(now_ns)
                self._write_books()
            firmware.idle(now_ns)
            return
        self._push()
        message = firmware.feed(data, now_ns) if data else firmware.advance(now_ns)
        # A message for which there is no room is dropped whole.
        if len(self._waiting) < firmware.backlog:
            self._waiting += message
            self._push()

    def _push(self) -> None:
        if self._waiting:
            self._waiting = self._line.write(self._waiting)

    def _obey(self) -> None:
        for order in self._orders.read() if self._orders is not None else ():
            with contextlib.suppress(BrokenPipeError):
                try:
                    self._firmware.take_order(order)
                except BoardError as error:
                    print(error, file=sys.stderr, flush=True)

    def _write_books(self) -> None:
        if self._firmware.books is not None:
            self._firmware.books.write()
