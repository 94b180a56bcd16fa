"""Runs an emulated device on a line: as long as there is a host, and a while longer.

Faults are events as texts: seconds since a host first opened the line, kind, and duration in
seconds (for ever if not given)::

    2 garbage 0.5       random bytes in place of messages
    3 nan 1             readings that are not numbers (load cells)
    4 freeze 3          the same image or reading again and again (sensors)
    5 silent 1          nothing passes
"""

import contextlib
import math
import os
import random
import select
import signal
import sys
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from types import FrameType

from smarttouch.base.errors import BoardError
from smarttouch.base.wire.device_lines import PtyLine, TcpLine
from smarttouch.emulator.finger_events import DeviceEvent, parse
from smarttouch.emulator.firmware import DeviceClock, Firmware

FAULTS = dict.fromkeys(("garbage", "nan", "freeze", "silent"), "[SECONDS]")
FIRST_HOST_S = 8.0  # time beyond its lingering that it waits for the first host
_WRITE_EVERY_NS = 50_000_000
_FULL_WAIT_S = 0.0005  # time after which the rest of a message is tried again


@dataclass
class LineStatistics:
    """Counts of messages, each counted when its last byte was taken."""

    sent: int = 0
    dropped: int = 0  # due, but not sent: the line was still full
    garbage: int = 0


def faults_at(faults: Iterable[DeviceEvent], time_s: float) -> frozenset[str]:
    """Return the kinds of faults at a time."""
    return frozenset(
        fault.kind
        for fault in faults
        if fault.time_s <= time_s < fault.time_s + (*fault.values, math.inf)[0]
    )


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
    """Serves one host after another. ``orders`` are for the device, or are events without their
    time, such as ``garbage 0.5``."""

    def __init__(
        self,
        firmware: Firmware,
        line: PtyLine | TcpLine,
        faults: Iterable[DeviceEvent] = (),
        orders: Orders | None = None,
    ) -> None:
        self.statistics: LineStatistics = LineStatistics()
        self._firmware, self._line, self._faults = firmware, line, list(faults)
        self._orders = orders
        self._first_host_ns: int | None = None
        self._hosted = False
        self._waiting: deque[tuple[bytes, bool]] = deque()
        """Messages that wait for the line, and whether they are garbage."""
        self._random = random.Random(0)

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
        if data is not None and self._first_host_ns is None:
            self._first_host_ns = now_ns
        wrong = self._wrong_at(now_ns)
        had_host, self._hosted = self._hosted, data is not None
        if data is None:
            self._waiting.clear()
            if had_host:
                self._firmware.hang_up(now_ns)
                self._write_books()
        self._push()
        if data is None or "silent" in wrong:
            self._firmware.idle(now_ns)
            return
        self._firmware.wrong = wrong
        feed, advance = self._firmware.feed, self._firmware.advance
        if message := feed(data, now_ns) if data else advance(now_ns):
            self._send(message, "garbage" in wrong)

    def _send(self, message: bytes, garbage: bool) -> None:
        if sum(len(each) for each, _ in self._waiting) >= self._firmware.backlog:
            self.statistics.dropped += 1
            return
        if garbage:
            # Ends of lines and packets stay, so that a host can find the next one.
            message = self._random.randbytes(max(0, len(message) - 2)) + message[-2:]
        self._waiting.append((message, garbage))
        self._push()

    def _push(self) -> None:
        while self._waiting:
            message, garbage = self._waiting.popleft()
            if rest := self._line.write(message):
                self._waiting.appendleft((rest, garbage))
                return
            self.statistics.garbage += garbage
            self.statistics.sent += not garbage

    def _wrong_at(self, now_ns: int) -> frozenset[str]:
        first_ns = now_ns if self._first_host_ns is None else self._first_host_ns
        time_s = (now_ns - first_ns) / 1e9
        for line in self._orders.read() if self._orders is not None else ():
            with contextlib.suppress(BrokenPipeError):
                try:
                    if not self._firmware.take_order(line.split()):
                        self._faults.append(parse(f"{time_s:.6f} {line}", FAULTS))
                except BoardError as error:
                    print(error, file=sys.stderr, flush=True)
        return frozenset() if self._first_host_ns is None else faults_at(self._faults, time_s)

    def _write_books(self) -> None:
        if self._firmware.books is not None:
            self._firmware.books.write()
