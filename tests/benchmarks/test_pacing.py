"""How evenly packets leave for a board whose clock is the host.

Run with::

    pytest tests/benchmarks/test_pacing.py --benchmark-only -n0 -s

One core is kept busy by another process; a feeder hands a sequence over every
10 ms, as the loop does, and the intervals at which the driver writes are compared with
10 ms. `SECONDS` of each way to wait, in turn.
"""

import os
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from smarttouch.boards.kajimoto61 import Kajimoto61Board
from smarttouch.boards.probe import one_each
from smarttouch.clock import SPIN_NS, MonotonicClock
from smarttouch.scan.safety import SafetyLimits

SECONDS = float(os.environ.get("SMARTTOUCH_PACING_SECONDS", "60"))
LIMITS = SafetyLimits(61, 5.0, 200, 0.5, 200, 0.8, 0.5, 4.0)
PERIOD_NS = 10_000_000


class NotingPort:
    """Keeps when each whole packet was written."""

    is_open = True

    def __init__(self):
        self.times_ns = []
        self.timeout = 0.0

    def write(self, data):
        if len(data) == 62:
            self.times_ns.append(time.perf_counter_ns())
        return len(data)

    def read(self, count=1):
        return b""

    def reset_input_buffer(self): ...

    def close(self): ...


def spread_us(spin_ns, monkeypatch):
    """Return how far from 10 ms apart packets were, µs, how many, and how many were overtaken."""
    port = NotingPort()
    monkeypatch.setattr("smarttouch.boards.streamed.open_port", lambda name: port)
    monkeypatch.setattr("smarttouch.boards.streamed.BOOT_S", 0.0)
    clock, feeder = MonotonicClock(spin_ns), MonotonicClock()
    board = Kajimoto61Board("x", LIMITS, clock=clock)
    never = threading.Event()
    with board:
        start = feeder.now_ns()
        for step in range(int(SECONDS * 1e9 / PERIOD_NS)):
            feeder.wait_until(start + step * PERIOD_NS, never)
            part = min(1.0, step / 60)
            board.send(
                one_each(
                    LIMITS, round(1000 * part), 50, part, step * PERIOD_NS,
                    cathodic=False, sites=list(range(20)), discharge_us=150, period_us=10_000,
                )
            )  # fmt: skip
        board.drain()
    # Without the zeros at both ends. After a stall of the machine the grid moves once.
    intervals = np.diff(np.array(port.times_ns[1:-1], np.float64))
    return np.abs(intervals - PERIOD_NS) / 1000, len(intervals) + 1, board.replaced


@pytest.mark.timeout(0)
def test_spread(benchmark, monkeypatch, capsys):
    rows = []
    with subprocess.Popen([sys.executable, "-c", "while True: pass"]) as hog:
        try:
            for name, spin_ns in (("sleep", 0), ("sleep, then spin", SPIN_NS)):
                off, packets, replaced = spread_us(spin_ns, monkeypatch)
                rows.append((name, packets, replaced, *np.percentile(off, (50, 99, 100))))
        finally:
            hog.kill()
    with capsys.disabled():
        print(f"\n{SECONDS:g} s each, one core busy; µs that intervals were off 10 ms")
        print(f"{'':18}{'packets':>8}{'replaced':>9}{'p50':>8}{'p99':>8}{'max':>8}")
        for name, packets, replaced, p50, p99, most in rows:
            print(f"{name:18}{packets:8}{replaced:9}{p50:8.0f}{p99:8.0f}{most:8.0f}")
    benchmark.extra_info["rows"] = [list(map(str, row)) for row in rows]
    benchmark.pedantic(lambda: None, rounds=1)
    assert rows[0][1] == pytest.approx(rows[1][1], rel=0.2)
