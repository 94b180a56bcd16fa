"""A run's figures are true, however long it lasts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.running.statistics import LatencyHistogram, RunStatistics
from smarttouch.sources.frame import Frame, Pose
from smarttouch.stimulation.sequence import SelectivityReport


@given(st.lists(st.floats(1, 1e7), min_size=1, max_size=300), st.floats(0.01, 1))
def test_quantiles_are_true_to_a_percent(values, share):
    spread = LatencyHistogram()
    for value in values:
        spread.add(value)
    true = np.quantile(values, share, method="inverted_cdf")
    assert spread.quantile(share) == pytest.approx(true, rel=0.011)
    assert spread.largest_us == max(values)
    assert spread.total_us == pytest.approx(sum(values))


def test_extremes_have_a_place():
    spread = LatencyHistogram()
    for value in (0.0, 0.3, 1e12):
        spread.add(value)
    assert spread.quantile(0.5) <= 1.01
    assert spread.figures()["max"] == 1e12
    assert LatencyHistogram().figures() == {"p50": 0.0, "p99": 0.0, "max": 0.0}


def test_memory_does_not_grow():
    spread = LatencyHistogram()
    size = spread._bins.nbytes
    for value in range(10_000):
        spread.add(value)
    assert spread._bins.nbytes == size
    assert vars(spread).keys() == vars(LatencyHistogram()).keys()


@given(st.lists(st.tuples(st.integers(0, 2), st.booleans()), max_size=60))
def test_frames_are_counted_once(moments):
    tally, number, seen, felt = RunStatistics(), 0, set(), set()
    for step, sent in moments:
        number += step
        frame = Frame(np.zeros((1, 1), np.uint8), 0, Pose(0, 0), 0.0, number)
        tally.see(frame)
        seen.add(number)
        if sent:
            tally.feel(frame)
            felt.add(number)
    assert (tally.seen, tally.felt) == (len(seen), len(felt))


def test_the_worst_of_shared_slots_is_kept():
    tally, points = RunStatistics(), np.array([3, 1], np.uint16)
    for other, spill in ((0.1, 0.2), (0.2, 0.1)):
        ratio = np.array([other, 0.9], np.float32), np.array([spill, 0.9], np.float32)
        tally.weigh(SelectivityReport(points, *ratio))
    tally.weigh(None)
    tally.weigh(SelectivityReport(np.ones(2, np.uint16), *ratio))
    assert (tally.off_target, tally.spill) == pytest.approx((0.2, 0.2))
