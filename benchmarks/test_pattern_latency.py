"""Latency of patterns in a session: the time until their first pulse on the emulated board.

One test shows each pattern for half a second, and measures from the call of `show_async`. The other
test receives UDP packets from another process, passes their patterns to `Session.put`, and measures
from the arrival of a packet. The board's clock tells when a pulse begins.
"""

import asyncio
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

import smarttouch as st

RING = np.zeros(64, np.float32)
RING[[18, 19, 20, 26, 28, 34, 35, 36]] = 1
SECONDS = 0.5


@pytest.mark.timeout(0)
def test_from_the_call_to_the_first_pulse(row, quick):
    found = []
    with st.open_display("emulator:").session(mode="RA", intensity=0.6) as touch:
        touch.rise()
        for _ in range(3 if quick else 100):
            called_ns = time.monotonic_ns()
            found.append((called_ns, asyncio.run(touch.show_async(RING, SECONDS))))
    late_ms = np.array([(shown.clock_ns - called_ns) / 1e6 for called_ns, shown in found])
    whole = sum((each.sequences, each.intensity) == (25, 0.6) for _, each in found)
    assert whole == len(found)
    row(
        "Time from the call of `show_async` to the first pulse on `emulator:`, 50 Hz, ms",
        {
            "patterns with 25 sequences at full level": f"{whole} of {len(found)}",
            "p50": f"{np.median(late_ms):.1f}",
            "p95": f"{np.percentile(late_ms, 95):.1f}",
            "max": f"{late_ms.max():.1f}",
        },
    )


SENDER = """
import socket, sys, time
port, rate_hz, count = int(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])
line, begin = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), time.monotonic()
for number in range(count):
    time.sleep(max(0, begin + number / rate_hz - time.monotonic()))
    line.sendto(number.to_bytes(4, "big"), ("127.0.0.1", port))
"""


class FirstPulses(st.Listener):
    """Listener that records the start of the first pulse of each pattern (`time.monotonic_ns`)."""

    def __init__(self):
        super().__init__()
        self.began_ns, self._waits = {}, {}

    def start(self, run):
        self._board = run.board

    def step(self, result):
        number = result.input.number
        if result.sequence.slots and number not in self._waits and number not in self.began_ns:
            self._waits[number] = result.number
        for each, sent in [*self._waits.items()]:
            start = self._board.start_of(sent)
            if start is not None:
                since_ns = self._board.clock.now_ns() - start[0]
                self.began_ns[each] = time.monotonic_ns() - since_ns
                del self._waits[each]


@pytest.mark.timeout(0)
@pytest.mark.parametrize("rate_hz", [60, 90])
def test_a_feed(row, quick, rate_hz):
    count = rate_hz * (2 if quick else 60)
    patterns = np.eye(64, dtype=np.float32)
    pulses, came_ns = FirstPulses(), []
    line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    line.bind(("127.0.0.1", 0))
    line.settimeout(10)
    display = st.open_display("emulator:")
    with line, display.session(mode="RA", intensity=0.6, listeners=[pulses]) as touch:
        touch.rise()
        first = touch._count + 1
        command = [sys.executable, "-c", SENDER, str(line.getsockname()[1]), str(rate_hz)]
        with subprocess.Popen([*command, str(count)]):
            for _ in range(count):
                number = int.from_bytes(line.recv(4), "big")
                came_ns.append(time.monotonic_ns())
                touch.put(patterns[number % 64])
        time.sleep(0.3)
    late_ms = [
        (pulses.began_ns[first + number] - at_ns) / 1e6
        for number, at_ns in enumerate(came_ns)
        if first + number in pulses.began_ns
    ]
    row(
        "Time from the arrival of a packet to its first pulse on `emulator:`, ms",
        {
            "packets per second": rate_hz,
            "packets": count,
            "delivered": f"{len(late_ms) / count:.0%}",
            "p50": f"{np.median(late_ms):.1f}",
            "p95": f"{np.percentile(late_ms, 95):.1f}",
            "p99": f"{np.percentile(late_ms, 99):.1f}",
        },
    )
    assert quick or len(late_ms) >= 0.95 * count
