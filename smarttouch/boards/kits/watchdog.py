"""Watchdog: a small process that sets a board to zero when the program that drives it is gone.

Some boards repeat their last pattern when the program is killed. The watchdog shares the port. When
the program exits for any reason, its side of the ``control`` socket closes. When it hangs or is
suspended, no heartbeats arrive. In both cases the watchdog writes the zero command and exits.

The watchdog has its own POSIX session, so that Ctrl-C, a closed terminal and a kill of the process
group of the program do not reach it. It imports only the standard library, and starts within about
20 ms. The program's side is `WatchedPort` in etactilekit_protocol.

Arguments are the file descriptors of port and ``control``, and the zero command in hex. Each byte
from ``control`` is a heartbeat. Before the first heartbeat nothing is written, because the port
may lead to a wrong device. A suspended computer counts as a silent program.
"""

import contextlib
import os
import select
import signal
import sys
import time

SILENCE_S = 0.09  # host timeout; leaves time to wake up and write the zero command within 0.1 s
PRIORITY = 2  # real-time priority; the program has 1: if it hangs, it cannot block the watchdog
STUCK_S = 0.4  # after this time without an accepted byte, the port counts as blocked
PIECE, PAUSE_S = 8, 0.003  # write the second zero command 8 bytes at a time, with pauses of 3 ms
GONE, SILENT, BLOCKED = 7, 3, 5
"""Exit codes. GONE: the program has ended. SILENT: the heartbeats have stopped. BLOCKED: zero could
not be written. A program that ignores SIGCHLD sees 0 for any process, so 0 is not used."""


def watch(port: int, control: int, zero: bytes) -> int:
    """Wait until the program is gone or silent, then write zero; return the exit code."""
    is_armed, slept_s = False, _slept_s()
    while True:
        ready = select.select([control], [], [], SILENCE_S if is_armed else None)[0]
        # Check again: if the watchdog itself was delayed, a heartbeat may be waiting.
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
    """Write the zero command twice, the second time in small pieces, because older firmware loses
    bytes that arrive too fast. Return whether the port accepted all bytes."""
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
    """Return the total time for which the computer was suspended, s."""
    clock = getattr(time, "CLOCK_BOOTTIME", None)
    return 0.0 if clock is None else time.clock_gettime(clock) - time.monotonic()


def main() -> None:
    """Run the watchdog with the arguments of the command line."""
    # Use real-time priority if the system allows it.
    with contextlib.suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    port, control, zero = sys.argv[1:4]
    os.set_blocking(int(port), False)
    sys.exit(watch(int(port), int(control), bytes.fromhex(zero)))


if __name__ == "__main__":
    main()
