"""``python -m smarttouch.boards.emulator``: the board's process.

It prints the name of its serial port, serves it, and ends by itself a while
after the host has closed it.
"""

import argparse
import errno
import os
import pty
import select
import signal
import time
from pathlib import Path
from types import FrameType

from smarttouch.boards.emulator.books import Books
from smarttouch.boards.emulator.firmware import Firmware
from smarttouch.boards.protocol import OUTPUTS

_WRITE_EVERY_NS = 50_000_000
_LONGEST_STEP_NS = 10_000_000


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m smarttouch.boards.emulator", description=__doc__
    )
    parser.add_argument("--electrodes", type=int, required=True)
    parser.add_argument("--output", choices=OUTPUTS, default="weighted")
    parser.add_argument("--books", type=Path, help="folder for state.json and delivered.bin")
    parser.add_argument(
        "--linger", type=float, default=2.0, help="seconds to live on without a host"
    )
    arguments = parser.parse_args()
    # Ctrl-C belongs to the host, which ends with a STOP and a closed port.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    firmware = Firmware(
        arguments.electrodes, arguments.output, Books(arguments.electrodes, arguments.books)
    )
    master, slave = pty.openpty()
    name = os.ttyname(slave)
    os.set_blocking(master, False)
    firmware.books.write()
    print(name, flush=True)
    # With our end of the slave closed, the host's last close shows as a hang-up.
    os.close(slave)
    _serve(firmware, master, arguments.linger)


def _serve(firmware: Firmware, master: int, linger_s: float) -> None:
    ended: list[int] = []

    def end(number: int, _frame: FrameType | None) -> None:
        ended.append(number)

    signal.signal(signal.SIGTERM, end)
    clock = _BoardClock()
    now = clock.now_ns()
    alone_since: int | None = now + int(8e9)
    written_ns, pending = now, b""
    while True:
        data = _read(master, 0.001 if firmware.busy else 0.004)
        now = clock.now_ns()
        if data is None:
            if alone_since is None:
                alone_since = now
                firmware.hang_up(now)
                firmware.books.write()
            if now > alone_since + linger_s * 1e9:
                break
            time.sleep(0.002)
        elif data:
            alone_since = None
            pending += firmware.feed(data, now)
        else:
            alone_since = None
            pending += firmware.advance(now)
        pending = _write(master, pending)
        if ended:
            firmware.zero("signal", now)
            break
        if now - written_ns > _WRITE_EVERY_NS:
            firmware.books.write()
            written_ns = now
    firmware.books.write()


class _BoardClock:
    """The board's time, which stands still while the machine runs other processes.

    Hardware is never kept waiting; what plays it is, and must not take its own
    absence for the host's silence, nor for pulses delivered.
    """

    def __init__(self) -> None:
        self._lost = 0
        self._last = time.monotonic_ns()

    def now_ns(self) -> int:
        now = time.monotonic_ns()
        self._lost += max(0, now - self._last - _LONGEST_STEP_NS)
        self._last = now
        return now - self._lost


def _read(master: int, timeout_s: float) -> bytes | None:
    """Return what has come, empty if nothing; None while no host has the port open."""
    try:
        if not select.select([master], [], [], timeout_s)[0]:
            return b""
        return os.read(master, 65536)
    except BlockingIOError:
        # A hang-up looks readable; the host has opened the port since.
        return b""
    except OSError as error:
        if error.errno == errno.EIO:
            return None
        raise


def _write(master: int, data: bytes) -> bytes:
    """Write what fits; return the rest. A host that never reads loses the oldest answers."""
    if not data:
        return data
    try:
        return data[os.write(master, data) :]
    except BlockingIOError:
        return data[-65536:]
    except OSError:
        return b""


if __name__ == "__main__":
    main()
