"""Patterns of a session: from the call of `Session.show` to the first pulse of the emulated board.

Run with::

    pytest tests/benchmarks/test_session.py --benchmark-only -n0

After one rise, patterns of half a second, one after another; the board's clock says when a pulse
began. Drift is how much later the last tenth of the calls got its pulses than the first, by the
median. Of two displays, how far apart their first pulses were.
"""

import asyncio
import time

import numpy as np
import pytest

import smarttouch as st

RING = np.zeros(64, np.float32)
RING[[18, 19, 20, 26, 28, 34, 35, 36]] = 1
SECONDS = 0.5


def session():
    return st.open_display("emulator:").session(mode="RA", intensity=0.6)


def by_threads(touch, count):
    for _ in range(count):
        called_ns = time.monotonic_ns()
        yield called_ns, touch.show(RING, SECONDS)


def by_tasks(touch, count):
    async def show():
        called_ns = time.monotonic_ns()
        return called_ns, await touch.show_async(RING, SECONDS)

    for _ in range(count):
        yield asyncio.run(show())


@pytest.mark.timeout(0)
@pytest.mark.parametrize(("way", "count"), [(by_threads, 500), (by_tasks, 100)])
def test_from_the_call_to_the_first_pulse(row, quick, way, count):
    with session() as touch:
        touch.rise()
        found = list(way(touch, 3 if quick else count))
    late_ms = np.array([(shown.clock_ns - called_ns) / 1e6 for called_ns, shown in found])
    whole = sum((each.sequences, each.intensity) == (25, 0.6) for _, each in found)
    assert whole == len(found)
    tenth = -(-len(found) // 10)
    row(
        "From the call of `show` to the first pulse on `emulator:`, 50 sequences a second, ms",
        {
            "called": "from a thread" if way is by_threads else "by `await`",
            "patterns, all 25 sequences at their level": f"{whole} of {len(found)}",
            "p50": f"{np.median(late_ms):.1f}",
            "p95": f"{np.percentile(late_ms, 95):.1f}",
            "max": f"{late_ms.max():.1f}",
            "drift": f"{np.median(late_ms[-tenth:]) - np.median(late_ms[:tenth]):+.1f}",
        },
    )


@pytest.mark.timeout(0)
def test_two_displays(row, quick):
    with session() as one, session() as other:
        apart_ms = []
        for _ in range(3 if quick else 100):
            shown = st.show_together({one: RING, other: RING}, 0.2)
            apart_ms.append(abs(shown[one].clock_ns - shown[other].clock_ns) / 1e6)
    row(
        "First pulses of two displays, from each other, ms",
        {
            "patterns": len(apart_ms),
            "p50": f"{np.median(apart_ms):.2f}",
            "p95": f"{np.percentile(apart_ms, 95):.2f}",
            "max": f"{max(apart_ms):.2f}",
        },
    )
