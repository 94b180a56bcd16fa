"""Fixtures for boards: limits, small sequences, emulators, and a line with faults."""

import contextlib
import os
import select
import socket
import threading
import time
import tty
from functools import partial

import numpy as np
import pytest

from firmware.tests.conftest import start_cortex_m3, start_firmware
from smarttouch.base.errors import BoardRestartedError, SequenceLateError
from smarttouch.base.posix import prioritized
from smarttouch.boards.board import Board
from smarttouch.boards.open import make_board
from smarttouch.profile.profile_tables import Output
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence
from smarttouch.testing.driver_contract import DriverContract
from tests.boards.emulator_waits import fresh_state, starter

from ..safety.bounds import WHOLE as WHOLE_RISE
from ..safety.bounds import Bounds
from ..support.processes import emulator
from ..support.scans import one_each

SECOND = 10**9

__all__ = ["start_cortex_m3", "start_firmware"]
FIRMWARES = [pytest.param(kind, marks=pytest.mark.long) for kind in ("link C", "link M3")]
"""Kinds of the fixture `hosted` that run the C firmware, on this machine and on a Cortex-M3."""


@pytest.fixture(autouse=True)
def claimed_time(request, monkeypatch):
    """Let the gate use the times stated in sequences, and switch all ramps off.

    These tests are about drivers: after a first sequence with zero intensity, any intensity may
    follow. Tests of `DriverContract` keep the ramp of the gate; tests marked ``wall_clock`` keep
    the machine's clock and all ramps.
    """
    if "wall_clock" not in request.keywords:
        monkeypatch.setattr("smarttouch.boards.open.Board", partial(Board, claimed_time=True))
        if not issubclass(request.cls or object, DriverContract):
            monkeypatch.setattr("smarttouch.stimulation.safety_gate.LATE_NS", 3600 * SECOND)
            monkeypatch.setattr(Bounds, "late_rise", WHOLE_RISE)
        monkeypatch.setattr("smarttouch.emulator.link_board_limits.RAMP_MS", 0)


@pytest.fixture(scope="session")
def make_limits():
    """Return a function that makes limits for a number of electrodes."""

    def make(electrodes=8):
        return SafetyLimits(
            electrodes=electrodes, current_ma=3.0, pulse_us=200, charge_uc=0.5, rate_hz=100,
            duty=0.6, ramp_s=0.5, full_ma=2.4,
        )  # fmt: skip

    return make


@pytest.fixture(scope="session")
def make_sequence():
    """Return a function that makes sequences; each slot has one cathode, all others are anodes."""

    def make(step=1, *, electrodes=8, slots=4, period_us=10_000, level_ua=700, **other):
        site = np.arange(slots, dtype=np.uint16) % electrodes
        current = np.full((slots, electrodes), -level_ua // (electrodes - 1), np.int16)
        current[np.arange(slots), site] = 0
        current[np.arange(slots), site] = -current.sum(axis=1)
        if step == 0:
            current, site = current[:0], site[:0]
        fields = {
            "current_ua": current,
            "width_us": np.full(len(site), 100, np.uint16),
            "discharge_us": np.full(len(site), 50, np.uint16),
            "site": site,
            "period_us": period_us,
            # Step 0 has zero intensity; steps are one second apart.
            "intensity": float(step > 0),
            "time_ns": step * SECOND,
        }
        return ScanSequence(**(fields | other))

    return make


@pytest.fixture
def start_emulator():
    """Return a function that starts an emulator, and returns its process and port name."""
    with starter() as start:

        def start_one(*arguments, electrodes=8, output="weighted", protocol="link"):
            # The board has no ramp either: see the fixture `claimed_time`.
            arguments = ("ramp_ms=0", *arguments) if protocol == "link" else arguments
            if not any(option.startswith("linger=") for option in arguments):
                arguments = ("linger=2", *arguments)
            options = (f"electrodes={electrodes}", f"output={output}", *arguments)
            process = start(emulator(protocol, *options), start_new_session=True)
            assert select.select([process.stdout], [], [], 60)[0], "the emulator prints no port"
            return process, process.stdout.readline().strip()

        yield start_one


class KajimotoPort:
    """Simulated port of a 61-electrode kit, which records the bytes written to it."""

    timeout, is_open = 0.05, True

    def __init__(self):
        self.heard, self.incoming = bytearray(), bytearray()

    def packets(self):
        """Return the packets between the zero packets of opening and closing."""
        ends = bytes(61) + bytes([0xFF]) + bytes(61)
        heard, size = bytes(self.heard), len(ends)
        assert heard[:size] == heard[-size:] == ends
        return [heard[at : at + 62] for at in range(size, len(heard) - size, 62)]

    def write(self, data):
        self.heard += data
        return len(data)

    def read(self, count=1):
        taken = bytes(self.incoming[:count])
        del self.incoming[:count]
        return taken

    @property
    def in_waiting(self):
        return len(self.incoming)

    def reset_input_buffer(self):
        self.incoming.clear()

    def close(self):
        self.is_open = False


@pytest.fixture
def port(monkeypatch):
    """Let the next driver that opens a port get this `KajimotoPort`."""
    port = KajimotoPort()
    monkeypatch.setattr("smarttouch.boards.driver.open_port", lambda *_: port)
    monkeypatch.setattr("smarttouch.boards.kits.BOOT_S", 0.0)
    return port


def pour(ends, data):
    """Write as much as fits; drop bytes that nobody reads."""
    for end in ends:
        with contextlib.suppress(BlockingIOError):
            os.write(end, data)


class FaultyLine:
    """Serial line between host and board that can change bytes and be unplugged.

    ``to_board`` and ``to_host`` are functions: each gets a piece of bytes, and returns the bytes
    that arrive. The line's thread has real-time priority if allowed, so that it delays no bytes.
    """

    def __init__(self, behind, path):
        self.path = path
        self.to_board = self.to_host = bytes
        if behind.startswith("socket:"):
            host, _, number = behind.removeprefix("socket://").partition(":")
            line = socket.create_connection((host, int(number)))
            line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._behind = line.detach()
        else:
            self._behind = os.open(behind, os.O_RDWR | os.O_NOCTTY)
            tty.setraw(self._behind)
        os.set_blocking(self._behind, False)
        self._lock, self._ends = threading.Lock(), None
        self._come = select.epoll()
        self._come.register(self._behind, select.EPOLLIN)
        self._closing = False
        self.plug_in()
        self._thread = threading.Thread(target=self._pump, daemon=True)
        self._thread.start()

    def plug_in(self):
        """Create the port, each time under the same name."""
        master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        with self._lock:
            self._ends = (master, slave)
            self._come.register(master, select.EPOLLIN)
        self.path.symlink_to(os.ttyname(slave))

    def pull_out(self):
        """Remove the port, as if the cable were pulled."""
        with self._lock:
            ends, self._ends = self._ends, None
            if ends is not None:
                self._come.unregister(ends[0])
        for end in ends or ():
            os.close(end)
        self.path.unlink(missing_ok=True)

    @prioritized()
    def _pump(self):
        while not self._closing:
            self._come.poll(0.05)
            # Wait for the rest of a write, so that each piece is a complete write.
            time.sleep(0.0002)
            with self._lock:
                near = [] if self._ends is None else [self._ends[0]]
                ready, _, _ = select.select([*near, self._behind], [], [], 0)
                for end in ready:
                    data = os.read(end, 65536)
                    if end == self._behind:
                        pour(near, self.to_host(data))
                    else:
                        pour([self._behind], self.to_board(data))

    def close(self):
        self._closing = True
        self._thread.join()
        if self._ends is not None:
            self.pull_out()
        self._come.close()
        os.close(self._behind)


class Hosted:
    """Board behind a `FaultyLine`, with a method to send anodic pulses."""

    def __init__(self, kind, start_emulator, start_firmware, start_cortex_m3, folder, monkeypatch):
        monkeypatch.setattr("smarttouch.boards.kits.BOOT_S", 0.0)
        self.electrodes = {"kajimoto61": 61}.get(kind, 8)
        # The second word of a kind names the firmware: a version in "etactilekit newest", the C
        # firmware on this machine in "link C", or the C firmware on a Cortex-M3 in "link M3".
        kind, _, firmware = kind.partition(" ")
        if firmware == "C":
            _, port = start_firmware(f"--books={folder}", "--ramp-ms=0")
        elif firmware == "M3":
            port = start_cortex_m3(electrodes=8, ramp_ms=0, counts=True).name
        else:
            more = [f"firmware={firmware}"] if firmware else []
            _, port = start_emulator(
                f"books={folder}", *more, protocol=kind, electrodes=self.electrodes
            )
        self.line = FaultyLine(port, folder / "port")
        self.folder, self.kind = folder, kind
        self.limits = SafetyLimits(self.electrodes, 3.0, 200, 0.5, 100, 0.6, 0.5, 2.8)
        output = Output(kind="weighted" if kind == "link" else "one-against-all")
        option = f"?firmware={firmware or '71adee2'}" if kind == "etactilekit" else ""
        self.board = make_board(f"{kind}:{self.line.path}{option}", self.limits, output)
        self.step = 0

    def send(self, times=1, level_ua=1000):
        """Send a sequence whose current differs from that of the sequence before.

        After opening, after a restart, and after a sequence that was too late, the current is zero.
        """
        while True:
            self.step += 1
            level = (level_ua + 20 * (self.step % 10)) * (self.step > 1)
            sequence = one_each(
                self.limits, level, 50, float(level > 0), self.step * 10**9, cathodic=False,
                sites=[1, 2, 3], discharge_us=150, period_us=20_000,
            )  # fmt: skip
            try:
                self.board.send(sequence, times)
            except BoardRestartedError as error:
                self.step = 0
                # A watchdog sets its board to zero if this computer pauses the program.
                if not isinstance(error, SequenceLateError) and "was paused" not in str(error):
                    raise
            else:
                break
        self.board.drain()

    def state(self):
        return fresh_state(self.folder)

    def assert_zero(self):
        state = self.state()
        assert (state["state"], state["unsafe"], state["violations"]) == ("shorted", 0, 0)
        assert self.state()["slots"] == state["slots"]


@pytest.fixture
def hosted(request, start_emulator, start_firmware, start_cortex_m3, tmp_path, monkeypatch):
    starters = start_emulator, start_firmware, start_cortex_m3
    hosted = Hosted(request.param, *starters, tmp_path, monkeypatch)
    yield hosted
    hosted.line.close()
