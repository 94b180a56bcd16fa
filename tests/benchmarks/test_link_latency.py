"""Time that the ``link`` protocol costs: a sequence in hand to acknowledged, beside its bare bytes.

Run with::

    pytest tests/benchmarks/test_link_latency.py --benchmark-only -n0

Both go over pseudo-terminals to a process of its own: once through the driver to the
emulator, once as the same number of bytes written and the ACK's number read back from
a process that only counts. Each in turn, in one run; the ratio is what counts.
"""

import os
import select
import statistics
import subprocess
import sys
import time
import tty

import numpy as np
import pytest

from smarttouch.base.errors import BoardRestartedError
from smarttouch.boards.link import protocol as protocol
from smarttouch.boards.link.protocol import encode
from smarttouch.boards.open import make_board
from smarttouch.profile.device import Output
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence
from tests.boards.payloads import encode_lists
from tests.rising import open_level

RAMP_S = 0.5
COUNTS = (64, 128, 256, 512)
ACK = len(encode(protocol.MessageKind.ACK, 1, 1))
ECHO = """
import os, sys, tty
master, slave = os.openpty()
tty.setraw(slave)
print(os.ttyname(slave), flush=True)
length, answer, have = int(sys.argv[1]), bytes(int(sys.argv[2])), 0
while True:
    have += len(os.read(master, 65536))
    while have >= length:
        have -= length
        os.write(master, answer)
"""


def limits_of(electrodes):
    return SafetyLimits(electrodes, 3.0, 200, 0.5, 200, 0.8, RAMP_S, 2.4)


def make(electrodes, step, slots, period_us, intensity=1.0):
    current = np.full((slots, electrodes), -1, np.int16)
    site = np.arange(slots, dtype=np.uint16) % electrodes
    current[np.arange(slots), site] = electrodes - 1
    column = np.ones(slots, np.uint16)
    return ScanSequence(
        current * (intensity == 1), column * 5, column * 20, site, period_us, intensity,
        step * 10**9,
    )  # fmt: skip


class Waits:
    """A clock that is moved on by waiting: a level opens in the time of the board."""

    _time_ns = 0

    @property
    def time_ns(self):
        return self._time_ns

    @time_ns.setter
    def time_ns(self, time_ns):
        time.sleep((time_ns - self._time_ns) / 1e9)
        self._time_ns = time_ns


def raised(board, electrodes):
    """Open any intensity by the least current; return the next step."""
    like, limits = make(electrodes, 0, 1, 20_000), limits_of(electrodes)
    open_level(board.send, like, limits, clock=Waits())
    board.drain(5.0)
    return 2


class Bare:
    """The same bytes there, as many as an ACK back."""

    def __init__(self, length):
        self.process = subprocess.Popen(
            [sys.executable, "-c", ECHO, str(length), str(ACK)], stdout=subprocess.PIPE, text=True
        )
        self.port = os.open(self.process.stdout.readline().strip(), os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self.port)
        self.data = bytes([7]) * length

    def __call__(self):
        sent = 0
        while sent < len(self.data):
            sent += os.write(self.port, self.data[sent : sent + 4096])
        got = 0
        while got < ACK:
            select.select([self.port], [], [])
            got += len(os.read(self.port, 4096))

    def close(self):
        os.close(self.port)
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()


def acknowledged_s(board, sequence):
    """Send when the board is idle; wait for the ACK, not for the scan."""
    board.drain()
    before = board.acknowledged
    start = time.perf_counter()
    board.send(sequence)
    news = board.driver._packets.news
    with news:
        news.wait_for(lambda: board.acknowledged > before, 1)
    return time.perf_counter() - start


def beside(length, ours, plain):
    """Return cells of how long so many bytes took, in s, by us and bare."""
    return {
        "bytes": length,
        "acknowledged after, µs": f"{1e6 * statistics.median(ours):.0f}",
        "bare, µs": f"{1e6 * statistics.median(plain):.0f}",
        "ratio": f"{statistics.median(a / b for a, b in zip(ours, plain, strict=True)):.1f}",
    }


def test_latency(row, quick):
    for electrodes in COUNTS[:2] if quick else COUNTS:
        output = Output(kind="weighted")
        length = len(packet(make(electrodes, 1, electrodes, 20_000)))
        bare, ours, plain = Bare(length), [], []
        with make_board("emulator:", limits_of(electrodes), output) as board:
            first = raised(board, electrodes)
            for step in range(first, first + (3 if quick else 60)):
                sequence = make(electrodes, step, electrodes, 40 * electrodes + 6000)
                ours.append(acknowledged_s(board, sequence))
                start = time.perf_counter()
                bare()
                plain.append(time.perf_counter() - start)
        bare.close()
        title = "A sequence in hand to acknowledged, beside its bare bytes"
        row(title, {"electrodes": electrodes} | beside(length, ours, plain))


def packet(sequence):
    payload = encode_lists(sequence, 1, True, False, None, 1 << 24)
    return encode(protocol.MessageKind.SEQUENCE, 1, 1, payload=payload)


@pytest.mark.parametrize("electrodes", COUNTS)
def test_throughput(row, quick, electrodes):
    """Sequences a second with one slot each: the wire and both ends, not the scan."""
    if quick and electrodes not in COUNTS[:2]:
        pytest.skip("smaller ones are every path")
    count, spent, restarts = 5 if quick else 100, [], 0
    with make_board("emulator:", limits_of(electrodes), Output(kind="weighted")) as board:
        step = raised(board, electrodes)
        while len(spent) < (1 if quick else 6):
            start = time.perf_counter()
            try:
                for _ in range(count):
                    board.send(make(electrodes, step, electrodes, 5000 + 26 * electrodes))
                    step += 1
                board.drain()
            except BoardRestartedError:
                # A busy machine left it without a word for 100 ms: once more, and said.
                restarts, step = restarts + 1, raised(board, electrodes)
                continue
            spent.append(time.perf_counter() - start)
        before = board.acknowledged
    assert before
    cells = {"electrodes": electrodes, "a second": f"{count / statistics.median(spent[-5:]):.0f}"}
    cells |= {"that fit": f"{1e6 / (5000 + 26 * electrodes):.0f}", "restarts": restarts}
    row("Sequences through the link", cells)
