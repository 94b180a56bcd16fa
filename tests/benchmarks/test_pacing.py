"""How evenly packets leave for a board whose clock is the host.

Run with::

    pytest tests/benchmarks/test_pacing.py --benchmark-only -n0

One core is kept busy by another process; a feeder hands a sequence over every
10 ms, as the loop does, and the intervals at which the driver writes are compared with
10 ms. `seconds` of each way to wait, in turn.
"""

import os
import threading
import time

import numpy as np
import pytest

from smarttouch.boards.kajimoto61 import Kajimoto61Board
from smarttouch.boards.probe import one_each
from smarttouch.clock import SPIN_NS, MonotonicClock
from smarttouch.scan.safety import SafetyLimits

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


def spread_us(spin_ns, seconds, monkeypatch):
    """Return how far from 10 ms apart packets were, µs, how many, and how many were overtaken."""
    port = NotingPort()
    monkeypatch.setattr("smarttouch.boards.streamed.open_port", lambda name: port)
    monkeypatch.setattr("smarttouch.boards.streamed.BOOT_S", 0.0)
    clock, feeder = MonotonicClock(spin_ns), MonotonicClock()
    monkeypatch.setattr("smarttouch.boards.timely.MonotonicClock", lambda: clock)
    board = Kajimoto61Board("x", LIMITS)
    never = threading.Event()
    with board:
        start = feeder.now_ns()
        for step in range(int(seconds * 1e9 / PERIOD_NS)):
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
def test_spread(row, quick, hog, monkeypatch):
    seconds = 1.5 if quick else float(os.environ.get("SMARTTOUCH_PACING_SECONDS", "60"))
    written = []
    with hog():
        for name, spin_ns in (("sleep", 0), ("sleep, then spin", SPIN_NS)):
            off_us, packets, replaced = spread_us(spin_ns, seconds, monkeypatch)
            p50, p99, most = np.percentile(off_us, (50, 99, 100))
            row(
                f"Off 10 ms between packets, {seconds:g} s each, one core busy",
                {
                    "wait": name,
                    "packets": packets,
                    "replaced": replaced,
                    "p50, µs": f"{p50:.0f}",
                    "p99, µs": f"{p99:.0f}",
                    "max, µs": f"{most:.0f}",
                },
            )
            written.append(packets)
    assert min(written) > 0
    if not quick:
        assert written[0] == pytest.approx(written[1], rel=0.2)
