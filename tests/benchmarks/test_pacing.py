"""Evenness of packets for a board whose clock is the host.

Run with::

    pytest tests/benchmarks/test_pacing.py --benchmark-only -n0

The loop and a driver of kajimoto61, as in a run: the times between two writes are compared with
the period. At each rate and load, with and without real-time priority, and with priority but
without spinning, in turn, five times over; the spread is that of the five.
"""

import os
import time

import numpy as np
import pytest

from smarttouch.base import posix
from smarttouch.base.clock import MonotonicClock
from smarttouch.base.stopping import StopRequest
from smarttouch.boards.board import Board
from smarttouch.boards.kits.kajimoto61 import Kajimoto61Driver
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.running.config import RunConfig
from smarttouch.running.inputs import Controls, ControlState
from smarttouch.running.loop import Loop, steady_environment
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.run_statistics import RunStatistics
from smarttouch.sources.source_contract import Frame, OpticalSource, Pose
from smarttouch.stimulation.safety_gate import SafetyLimits

RATES_HZ = (50, 100, 200)
LOADS = {"quiet": 0, "one core busy": 1, "all cores busy": os.cpu_count() or 1}
WAITS = {"usual": (False, None), "real-time": (True, None), "real-time, no spin": (True, 0)}
RUNS = 5


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


class Dot(OpticalSource):
    """A black dot under the middle of the array."""

    def __init__(self):
        super().__init__("a dot")
        self._image = np.full((64, 64), 220, np.uint8)
        self._image[28:36, 28:36] = 20

    def read(self, time_ns):
        self.frames += 1
        return Frame(self._image, time_ns, Pose(0, 0), 1.0, number=self.frames - 1)


@pytest.fixture(scope="module")
def kajimoto():
    profile = load_profile("kajimoto-61")
    return profile, load_bank(profile)


def errors_us(kajimoto, rate_hz, seconds, spin_ns, monkeypatch):
    """Return how far from a period the times between packets were, µs."""
    profile, bank = kajimoto
    port = NotingPort()
    monkeypatch.setattr("smarttouch.boards.line.open_port", lambda *_: port)
    monkeypatch.setattr("smarttouch.boards.kits.current_scale.BOOT_S", 0.0)
    pipeline = Pipeline(profile, bank, RunConfig(rate_hz=rate_hz, scan="points"))
    limits = SafetyLimits.of(profile)
    driver = Kajimoto61Driver("x", limits, profile.output)
    board = Board(driver, limits, profile.output, clock=MonotonicClock(spin_ns))
    controls, tally = Controls(ControlState(pipeline.mode)), RunStatistics()
    with steady_environment(pipeline), board:
        Loop(
            Dot(), pipeline, board, stop=StopRequest(), statistics=tally, seconds=seconds,
            controls=controls,
        ).run()  # fmt: skip
    assert tally.lowest_rate_hz == rate_hz
    # Without the zeros at both ends.
    return np.abs(np.diff(np.array(port.times_ns[1:-1], np.float64)) - 1e9 / rate_hz) / 1000


@pytest.mark.timeout(0)
@pytest.mark.parametrize("load", LOADS)
def test_period_errors(load, row, quick, hog, kajimoto, monkeypatch):
    seconds = 1.0 if quick else float(os.environ.get("SMARTTOUCH_PACING_SECONDS", "5"))
    for rate_hz in RATES_HZ[: 1 if quick else None]:
        found, times = {name: [] for name in WAITS}, 1 if quick else RUNS
        for _ in range(times):
            for name, (prioritized, spin_ns) in WAITS.items():
                with monkeypatch.context() as patch, hog(LOADS[load]):
                    if not prioritized:
                        patch.setattr(posix, "_FIFO", None)
                    off_us = errors_us(kajimoto, rate_hz, seconds, spin_ns, patch)
                found[name].append([len(off_us), *np.percentile(off_us, (50, 99, 100))])
        for name, runs in found.items():
            packets, p50, p99, most = np.transpose(runs)
            assert packets.min() > 0.5 * rate_hz * seconds
            row(
                f"Time between packets off its period, {times} runs of {seconds:g} s in turn, µs",
                {
                    "rate, Hz": rate_hz,
                    "machine": load,
                    "priority": name,
                    "p50": _middle(p50),
                    "p99": _middle(p99),
                    "max": _middle(most),
                    "packets": f"{packets.sum():.0f}",
                },
            )


def _middle(values):
    """Median of the runs, and from least to most."""
    return f"{np.median(values):.0f} ({values.min():.0f}–{values.max():.0f})"
