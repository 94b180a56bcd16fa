"""Periods are planned so that no second has too much net charge."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.stimulation.net_plan import NetPlan
from smarttouch.stimulation.slot_sums import NET_PC

SECOND_US = 1_000_000


def newest_pc(sent, time_us):
    """Return the largest net charge of any newest passes of the second before a time."""
    kept = [net_pc for end_us, net_pc in reversed(sent) if end_us > time_us - SECOND_US]
    return np.abs(np.cumsum(kept, axis=0)).max() if kept else 0.0


@given(st.integers(0, 2**32 - 1), st.booleans())
def test_no_second_has_more_than_its_net_charge(seed, looks):
    """Whether each pass is looked at, or only those that may matter."""
    rng, plan, sent, time_us = np.random.default_rng(seed), NetPlan(3), [], 0
    for _ in range(200):
        most_pc, period_us = rng.choice([2e4, 1e6, 9e6]), int(rng.choice([2000, 20_000, 200_000]))
        net_pc = np.rint(rng.uniform(-0.2, 1, 3) * most_pc)
        busy_us, next_us = period_us // 2, period_us
        if not looks and plan.spares(most_pc, time_us, period_us):
            sent.append((time_us + busy_us, net_pc))
        elif plan.admits(net_pc, time_us):
            next_us = math.ceil(plan.period_us(net_pc, time_us, period_us, busy_us))
            sent.append((time_us + busy_us, net_pc))
        assert newest_pc(sent, time_us) <= NET_PC
        time_us += next_us


def test_what_is_spared_would_not_have_been_slowed():
    spared, looked = NetPlan(1), NetPlan(1)
    net_pc = np.array([0.8e6])
    for time_us in range(0, 3 * SECOND_US, 20_000):
        assert spared.spares(net_pc[0], time_us, 20_000)
        assert looked.admits(net_pc, time_us)
        assert looked.period_us(net_pc, time_us, 20_000, 1000) == 20_000
    # Twice that may come near the limit.
    assert not spared.spares(2 * net_pc[0], 3 * SECOND_US, 20_000)
    assert spared.admits(2 * net_pc, 3 * SECOND_US)
