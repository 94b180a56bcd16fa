"""Periods by which the net current of an electrode stays below its limit, at other rates."""

import math

import numpy as np
import pytest

from smarttouch.stimulation.net_plan import NetPlan
from smarttouch.stimulation.slot_sums import NET_PC

BUSY_US = 300


def planned(rate_hz, net_pc, wanted, seconds=6.0):
    """Return the times of passes, the periods planned, and how many passes were left out, µs."""
    plan, time_us, period_us = NetPlan(1), 0.0, round(1e6 / rate_hz)
    each_pc = np.array([float(net_pc)])
    times, periods, left_out = [], [], 0
    while time_us < 1e6 * seconds:
        next_us = period_us
        if wanted(time_us):
            if plan.admits(each_pc, time_us):
                next_us = math.ceil(plan.period_us(each_pc, time_us, period_us, BUSY_US))
                times.append(time_us)
                periods.append(next_us)
            else:
                left_out += 1
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
