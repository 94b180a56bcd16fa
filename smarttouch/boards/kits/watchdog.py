"""Watchdog: a small process that puts a board at zero when the program that drives it is gone.

Boards that run freely repeat their last pattern when that program is killed. The watchdog has the
port as well. When the program ends, however it ends, its end of the ``control`` socket closes; when
it hangs or is stopped, its heartbeats stop. Either way the watchdog writes the board's zero command
and ends.

It runs in a session of its own (Ctrl-C, a closed terminal and a kill of the program's process group
do not reach it), and imports only the standard library, so that it starts within some 20 ms. The
program's side is `WatchedPort` in etactilekit_line.

The command line has the file descriptors of port and ``control``, and the zero command in hex.
Every byte from ``control`` is a heartbeat. Without the first one nothing is written: the device at
the port is not known to be the right one yet. A suspended computer counts as a silent program.
"""

import contextlib
import os
import select
import signal
import sys
import time

SILENCE_S = 0.09  # longest silence: with the time to wake up and write, .1 s to zero
PRIORITY = 2  # real-time, where allowed: above the program's 1, so a hung one cannot block it
STUCK_S = 0.4  # without a byte accepted while zero is written: the board is stuck
PIECE, PAUSE_S = 8, 0.003  # zero goes out once more in pieces, of which a busy USB chip loses none
GONE, SILENT, BLOCKED = 7, 3, 5
"""Exit codes: the program has closed or was silent, and the board is at zero; the port takes no
bytes. None is 0, which a program that ignores SIGCHLD reads of any process, killed ones too."""


def watch(port: int, control: int, zero: bytes) -> int:
    """Wait until the program is gone or silent, then write zero; return the exit code."""
    is_armed, slept_s = False, _slept_s()
    while True:
        ready = select.select([control], [], [], SILENCE_S if is_armed else None)[0]
        # A watchdog that was delayed itself may still find heartbeats.
        ready = ready or select.select([control], [], [], 0)[0]
        if not ready or (is_armed and _slept_s() > slept_s + SILENCE_S):
            return SILENT if write_zero(port, zero) else BLOCKED
        heard = b""
        with contextlib.suppress(OSError):
            heard = os.read(control, 4096)
        if not heard:
            return GONE if not is_armed or write_zero(port, zero) else BLOCKED
        is_armed = True


def write_zero(port: int, zero: bytes) -> bool:
    """Write the zero command twice, the second time in small pieces, as older firmware loses bytes
    that come fast; return whether the port accepted it."""
    for size in (len(zero), PIECE):
        for start in range(0, len(zero), size):
            piece = zero[start : start + size]
            while piece:
                try:
                    if not select.select([], [port], [], STUCK_S)[1]:
                        return False
                    piece = piece[os.write(port, piece) :]
                except BlockingIOError:
                    continue
                except OSError:
                    return False
            if size == PIECE:
                time.sleep(PAUSE_S)
    return True


def _slept_s() -> float:
    """Return the time for which the computer was suspended, s, up to a constant."""
    clock = getattr(time, "CLOCK_BOOTTIME", None)
    return 0.0 if clock is None else time.clock_gettime(clock) - time.monotonic()


def main() -> None:
    """Watch the program that the command line describes."""
    # Above the program and ordinary ones, where the system allows that.
    with contextlib.suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    port, control, zero = sys.argv[1:4]
    os.set_blocking(int(port), False)
    sys.exit(watch(int(port), int(control), bytes.fromhex(zero)))


if __name__ == "__main__":
    main()
