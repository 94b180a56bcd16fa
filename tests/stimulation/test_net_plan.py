"""Periods are planned so that no second has too much net charge."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.stimulation.scheduler import NetPlan
from smarttouch.stimulation.sequence_limits import NET_PC

SECOND_US = 1_000_000


def newest_pc(sent, time_us):
    """Return the largest net charge of any newest passes of the second before a time."""
    kept = [net_pc for end_us, net_pc in reversed(sent) if end_us > time_us - SECOND_US]
    return np.abs(np.cumsum(kept, axis=0)).max() if kept else 0.0


@given(st.integers(0, 2**32 - 1))
def test_no_second_has_more_than_its_net_charge(seed):
    rng, plan, sent, time_us = np.random.default_rng(seed), NetPlan(3), [], 0
    for _ in range(200):
        most_pc, period_us = rng.choice([2e4, 1e6, 9e6]), int(rng.choice([2000, 20_000, 200_000]))
        net_pc = np.rint(rng.uniform(-0.2, 1, 3) * most_pc)
        next_us = plan.next_period_us(net_pc, time_us, period_us, period_us // 2)
        if next_us is not None:
            sent.append((time_us + period_us // 2, net_pc))
        assert newest_pc(sent, time_us) <= NET_PC
        time_us += math.ceil(next_us or period_us)


BUSY_US = 300


def planned(rate_hz, net_pc, wanted, seconds=6.0):
    """Return the times of passes, the periods planned, and how many passes were left out, µs."""
    plan, time_us, period_us = NetPlan(1), 0.0, round(1e6 / rate_hz)
    each_pc = np.array([float(net_pc)])
    times, periods, left_out = [], [], 0
    while time_us < 1e6 * seconds:
        next_us = period_us
        if wanted(time_us):
            needed_us = plan.next_period_us(each_pc, time_us, period_us, BUSY_US)
            left_out += needed_us is None
            if needed_us is not None:
                next_us = math.ceil(needed_us)
                times.append(time_us)
                periods.append(next_us)
        time_us += next_us
    return np.array(times), np.array(periods), left_out


def always(_time_us):
    return True


@pytest.mark.parametrize("rate_hz", [50, 100, 200])
@pytest.mark.parametrize("net_pc", [480_000, 1_200_000])
def test_no_second_has_more_and_pauses_are_short(rate_hz, net_pc):
    times, periods, left_out = planned(rate_hz, net_pc, always)
    ends = times + BUSY_US
    most = max(np.count_nonzero(ends[: index + 1] > time - 1e6) for index, time in enumerate(times))
    assert most * net_pc <= NET_PC
    assert left_out == 0
    # Spread, not given at once and then withheld.
    assert periods.max() < 60_000
    steady = times[-1] - times[times > 3e6][0]
    shortest_us = 1e6 / rate_hz
    allowed_us = max(shortest_us, 1e6 * net_pc / NET_PC)
    assert allowed_us <= steady / (np.count_nonzero(times > 3e6) - 1) + 1e-6 <= 1.2 * allowed_us


@pytest.mark.parametrize(("net_pc", "wanted"), [
    # Every fifth frame, as ridges pass under a finger; trains that are over in time.
    (1_200_000, lambda time_us: int(time_us // 10_000) % 5 == 0),
    (480_000, lambda time_us: time_us % 1_000_000 < 400_000),
])  # fmt: skip
def test_what_pauses_by_itself_keeps_its_rate(net_pc, wanted):
    _, periods, left_out = planned(100, net_pc, wanted)
    assert set(periods) == {10_000}
    assert left_out == 0
