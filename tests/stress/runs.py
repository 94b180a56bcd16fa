"""Runs that are ended by signals at random instants: ``runs.py COUNT SEED``.

Hosts and emulated boards are forks of one process that has imported everything. A program that is
started takes a second of processor time; a fork of one that has begun takes a hundredth.
"""

import contextlib
import json
import mmap
import os
import random
import signal
import struct
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from smarttouch.base.posix import prioritized
from smarttouch.cli import main
from smarttouch.emulator.device_lines import PtyLine
from smarttouch.emulator.devices import Server
from smarttouch.emulator.etactilekit_firmware import ETactileKitFirmware
from smarttouch.emulator.firmware import DeliveryLog
from smarttouch.emulator.kajimoto61_firmware import Kajimoto61Firmware
from smarttouch.emulator.link_firmware import LinkFirmware

LONGEST_START_S = 4.0
"""A run drives its board well before that."""
NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
KINDS = {"link": 64, "kajimoto61": 61, "etactilekit": 32}
FLOWS_UA = 20
ALONE_S = 0.3
"""A board that goes on without its host shows it within that time."""
_PAGE = struct.Struct("<qqqq")


class _Shared(DeliveryLog):
    """Books of which four numbers are in shared memory: when the last pulse began, by the machine's
    clock, how many there were, whether the board drives, and how often something was wrong."""

    def __init__(self, electrodes, page):
        super().__init__(electrodes)
        self.last_ns, self.page = 0, page

    def keep(self, number, width_us, current_ua):
        if abs(current_ua).max(initial=0) >= FLOWS_UA:
            self.last_ns = time.monotonic_ns()

    def __setattr__(self, name, value):
        super().__setattr__(name, value)
        if name in ("state", "unsafe", "violations", "last_ns") and "page" in vars(self):
            driving, wrong = self.state == "driving", self.unsafe + self.violations
            self.page[: _PAGE.size] = _PAGE.pack(self.last_ns, self.pulses, driving, wrong)


class Emulated:
    """A board in a fork, on a line of its own."""

    def __init__(self, kind):
        self.kind, self._flag_ns = kind, None
        self._page = mmap.mmap(-1, mmap.PAGESIZE)
        line = PtyLine()
        self.url = f"{kind}:{line.name}"
        self.process = os.fork()
        if self.process == 0:
            run_and_exit(lambda: self._serve(line))
        line.close()

    def _serve(self, line):
        quiet(os.devnull)
        books = _Shared(KINDS[self.kind], self._page)
        firmware = {
            "link": lambda: LinkFirmware("weighted", books),
            "kajimoto61": lambda: Kajimoto61Firmware(books),
            "etactilekit": lambda: ETactileKitFirmware(books),
        }[self.kind]()
        # A board is kept waiting by nothing: before the hosts, where that is allowed.
        with prioritized():
            Server(firmware, line).serve(60.0)

    def flag(self):
        """Note when it is."""
        self._flag_ns = time.monotonic_ns()

    def ended(self):
        """Leave it alone for a while, and return what was noted; then switch it off."""
        time.sleep(ALONE_S)
        pulse_ns, pulses, driving, wrong = _PAGE.unpack(self._page[: _PAGE.size])
        os.kill(self.process, signal.SIGTERM)
        os.waitpid(self.process, 0)
        self._page.close()
        late_ms = (pulse_ns - self._flag_ns) / 1e6 if pulses else None
        return {
            "pulses": pulses, "driving": bool(driving), "wrong": wrong, "zero_after_ms": late_ms,
        }  # fmt: skip


def start_host(arguments, state, out):
    """Fork the program with arguments; return its process."""
    process = os.fork()
    if process == 0:
        run_and_exit(lambda: _host(arguments, state, out))
    return process


def _host(arguments, state, out):
    os.setsid()
    # Whoever started this in the background has them ignored, until the program heeds them.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    os.environ["XDG_STATE_HOME"] = str(state)
    os.environ["TERM"] = "xterm"
    quiet(out)
    sys.argv = ["smarttouch", *map(str, arguments)]
    main()


def quiet(out):
    """Let this process read from and write to other places."""
    with contextlib.suppress(ValueError, OSError):
        sys.stdout.flush()
    inward = os.open(os.devnull, os.O_RDWR)
    outward = os.open(out, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(inward, 0)
    os.dup2(outward, 1)
    os.dup2(outward, 2)
    for name, number, mode in (("stdin", 0, "r"), ("stdout", 1, "w"), ("stderr", 2, "w")):
        stream = os.fdopen(number, mode, buffering=1, closefd=False)
        setattr(sys, name, stream)
        setattr(sys, f"__{name}__", stream)


def run_and_exit(act):
    """Run something in a fork, and never return to what the fork was made of."""
    code = 99
    try:
        act()
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 0
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        with contextlib.suppress(ValueError, OSError):
            if not os.isatty(1):
                sys.stdout.flush()
        os._exit(code)


def wait_for_end(process, seconds):
    """Return the exit code of a process and how long it took; None and the time if it did not."""
    begin = time.monotonic()
    while time.monotonic() - begin < seconds:
        done, status = os.waitpid(process, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status), time.monotonic() - begin
        time.sleep(0.002)
    return None, time.monotonic() - begin


def signalled(draw, number, kind, folder):
    """Start a run, end it by a signal, and return what came of it."""
    board = Emulated(kind)
    run = ["live", "--board", board.url, "--force", "fixed:1", "--intensity", "1"]
    host = start_host([*run, "--seconds", "60"], folder, folder / "out")
    after_s = draw.uniform(0.0, LONGEST_START_S)
    time.sleep(after_s)
    board.flag()
    os.kill(host, number)
    code, took_s = wait_for_end(host, 15.0)
    if code is None:
        os.kill(host, signal.SIGKILL)
        os.waitpid(host, 0)
    return {
        "signal": signal.Signals(number).name, "board": kind,
        "after_s": after_s, "code": code, "took_s": took_s, **board.ended(),
    }  # fmt: skip


def signals(count, seed, folder):
    """Send so many signals."""
    kinds = list(KINDS)
    return [
        signalled(
            random.Random(1000 * seed + each), NUMBERS[each % 3], kinds[(each + each // 3) % 3],
            Path(folder),
        )
        for each in range(count)
    ]  # fmt: skip


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as own:
        json.dump(signals(*map(int, sys.argv[1:]), own), sys.stdout)
