"""Hosts and emulated boards as forks of one process that has imported everything.

A program that is started takes a second of processor time; a fork of one that has begun
takes a hundredth. `Emulated` writes down, by the board's own clock, when a signal was sent
to its host and when its last pulse began.
"""

import contextlib
import faulthandler
import json
import mmap
import os
import signal
import struct
import sys
import termios
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from smarttouch.base.posix import prioritized
from smarttouch.base.wire.device_lines import PtyLine
from smarttouch.cli import main
from smarttouch.emulator.etactilekit_firmware import ETactileKitFirmware
from smarttouch.emulator.firmware import DeliveryLog, Firmware
from smarttouch.emulator.kajimoto61_firmware import Kajimoto61Firmware
from smarttouch.emulator.link_firmware import LinkFirmware
from smarttouch.emulator.server import Server
from smarttouch.views import keys_and_signals

KINDS = {"link": 64, "kajimoto61": 61, "etactilekit": 32}
FLOWS_UA = 20
ALONE_S = 0.3
"""A board that goes on without its host shows it within that time."""
"""Its real-time priority: above those of loop and watchdog."""
AWAY_NS = 10_000_000
"""A board that did not look at its line for so long notes that: it was kept waiting."""
_PAGE = struct.Struct("<qqqqqq")
_NEVER = -1


class _Noted(Firmware):
    """A firmware whose last pulse, and the time of a flag, are kept in shared memory."""

    def __init__(self, firmware, page, trace):
        self.firmware, self.books, self._page, self._trace = firmware, firmware.books, page, trace
        self._enter, self.books.enter = self.books.enter, self._note_pulse
        self._looked_ns = time.monotonic_ns()

    @property
    def busy(self):
        return self.firmware.busy

    def feed(self, data, now_ns):
        self._look(now_ns)
        # What was due before these bytes is not of them.
        answer = self.firmware.advance(now_ns)
        # By the machine's clock: the board's stands still while this process is kept waiting.
        self._trace.write(struct.pack("<qi", time.monotonic_ns(), -1))
        answer += self.firmware.feed(data, now_ns)
        self._state()
        return answer

    def advance(self, now_ns):
        self._look(now_ns)
        answer = self.firmware.advance(now_ns)
        self._state()
        return answer

    def hang_up(self, now_ns):
        self.firmware.hang_up(now_ns)
        self._state()

    def zero(self, reason, now_ns):
        self.firmware.zero(reason, now_ns)
        self._state()

    def _look(self, now_ns):
        looked_ns, self._looked_ns = self._looked_ns, time.monotonic_ns()
        if self._looked_ns - looked_ns > AWAY_NS:
            self._trace.write(struct.pack("<qi", self._looked_ns, -2))
        flag, at_ns, *rest = _PAGE.unpack(self._page[: _PAGE.size])
        if flag and at_ns == _NEVER:
            self._page[: _PAGE.size] = _PAGE.pack(flag, now_ns, *rest)

    def _state(self):
        values = list(_PAGE.unpack(self._page[: _PAGE.size]))
        values[4] = self.books.state == "driving"
        values[5] = self.books.unsafe + self.books.violations
        # The flag is the other process's.
        self._page[8 : _PAGE.size] = _PAGE.pack(*values)[8:]

    def _note_pulse(self, number, slot, site, delivered, width_us, residual_uc, time_us, **more):
        self._enter(number, slot, site, delivered, width_us, residual_uc, time_us, **more)
        peak_ua = int(abs(delivered.current_ua).max(initial=0))
        if peak_ua < FLOWS_UA:
            return
        pulses = _PAGE.unpack(self._page[: _PAGE.size])[3] + 1
        self._page[16:32] = struct.pack("<qq", int(1000 * time_us), pulses)
        self._trace.write(struct.pack("<qi", time.monotonic_ns(), peak_ua))


class Emulated:
    """A board in a fork, on a line of its own."""

    def __init__(self, kind, trace=None):
        self.kind = kind
        self._page = mmap.mmap(-1, mmap.PAGESIZE)
        self._page[: _PAGE.size] = _PAGE.pack(0, _NEVER, _NEVER, 0, 0, 0)
        line = PtyLine()
        self.url = f"{kind}:{line.name}"
        self.process = os.fork()
        if self.process == 0:
            run_and_exit(lambda: self._serve(line, trace))
        line.close()

    def _serve(self, line, trace):
        quiet(out=os.devnull)
        books = DeliveryLog(KINDS[self.kind])
        firmware = {
            "link": lambda: LinkFirmware("weighted", books),
            "kajimoto61": lambda: Kajimoto61Firmware(books),
            "etactilekit": lambda: ETactileKitFirmware(books),
        }[self.kind]()
        # A board is kept waiting by nothing: before the hosts, where that is allowed.
        with Path(trace or os.devnull).open("wb") as file, prioritized():
            Server(_Noted(firmware, self._page, file), line).serve(60.0)

    @property
    def pulses(self):
        """Number of pulses delivered until now."""
        return _PAGE.unpack(self._page[: _PAGE.size])[3]

    def flag(self):
        """Write down when it is, by the board's clock."""
        self._page[:8] = struct.pack("<q", 1)

    def ended(self):
        """Leave it alone for a while, switch it off, and return what was noted."""
        time.sleep(ALONE_S)
        os.kill(self.process, signal.SIGTERM)
        os.waitpid(self.process, 0)
        _, flag_ns, pulse_ns, pulses, keys_and_signals, wrong = _PAGE.unpack(
            self._page[: _PAGE.size]
        )
        self._page.close()
        return {
            "pulses": pulses,
            "driving": bool(keys_and_signals),
            "wrong": wrong,
            "zero_after_ms": (pulse_ns - flag_ns) / 1e6 if pulses and flag_ns != _NEVER else None,
        }


def start_host(arguments, state, *, out=os.devnull, terminal=None, delay_s=0.0):
    """Fork the program with arguments; return its process."""
    process = os.fork()
    if process == 0:
        run_and_exit(lambda: _host(arguments, state, out, terminal, delay_s))
    return process


def _host(arguments, state, out, terminal, delay_s):
    os.setsid()
    # Whoever started this in the background has them ignored, until the program heeds them.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    os.environ["XDG_STATE_HOME"] = str(state)
    os.environ["TERM"] = "xterm"
    quiet(out, terminal)
    by_force = keys_and_signals._give_up

    def tell_and_give_up(number):
        with (Path(state) / "forced").open("a") as file:
            file.write(f"{sys.argv}\n")
            file.flush()
            faulthandler.dump_traceback(file)
        by_force(number)

    keys_and_signals._give_up = tell_and_give_up
    # As long as a program takes that imports, and has told nobody of itself.
    time.sleep(delay_s)
    sys.argv = ["smarttouch", *map(str, arguments)]
    main()


def quiet(out, terminal=None):
    """Let this process read from and write to other places."""
    with contextlib.suppress(ValueError, OSError):
        sys.stdout.flush()
    inward = os.open(terminal or os.devnull, os.O_RDWR | os.O_NOCTTY)
    outward = inward if terminal else os.open(out, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
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


def stuck_terminal(keys):
    """Return both ends of a terminal that has stopped reading, with keys pressed already."""
    ours, theirs = os.openpty()
    name = os.ttyname(theirs)
    settings = termios.tcgetattr(theirs)
    settings[3] &= ~termios.ECHO
    termios.tcsetattr(theirs, termios.TCSANOW, settings)
    os.set_blocking(theirs, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(theirs, b"." * 64)
    os.set_blocking(theirs, True)
    os.write(ours, keys)
    return ours, theirs, name


def wait_for_end(process, seconds):
    """Return the exit code of a process and how long it took; None and the time if it did not."""
    begin = time.monotonic()
    while time.monotonic() - begin < seconds:
        done, status = os.waitpid(process, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status), time.monotonic() - begin
        time.sleep(0.002)
    return None, time.monotonic() - begin


def spread(work, count, workers, folder):
    """Do work for each of so many numbers, in some forks at once; return all that it returned.

    It is given a number and a folder of its own, and returns what JSON can hold.
    """
    processes = []
    for worker in range(workers):
        own = Path(folder) / f"{worker}"
        own.mkdir()
        processes.append(os.fork())
        if processes[-1] == 0:
            run_and_exit(lambda own=own, worker=worker: _work(work, count, worker, workers, own))
    for process in processes:
        os.waitpid(process, 0)
    files = [Path(folder) / f"{worker}" / "found.json" for worker in range(workers)]
    return [each for file in files for each in json.loads(file.read_text())]


def _work(work, count, worker, workers, own):
    found = [work(each, own) for each in range(worker, count, workers)]
    (own / "found.json").write_text(json.dumps(found))
