"""Tests of run statistics: quantiles of durations, and the worst selectivity."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.tactile_image import TactileImage
from smarttouch.running.run_statistics import LatencyHistogram, RunStatistics
from smarttouch.running.step_records import Step, StepResult
from smarttouch.sources.source_contract import Frame, Pose
from smarttouch.stimulation.scan_sequence import ScanSequence, SelectivityReport


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


def sent(number=0, proof=None):
    """Return the result of a step from frame ``number``, with one slot on one electrode."""
    frame = Frame(np.zeros((1, 1), np.uint8), 0, Pose(0, 0), 0.0, number)
    tactile = TactileImage(np.zeros((3, 1), np.float32), 0, 0.0)
    one = np.ones(1, np.uint16)
    sequence = ScanSequence(one[:, None], one, one, one, 20_000, 1.0, 0, proof=proof)
    return StepResult(Step(frame, tactile, sequence, Mode.RA), 1, 300.0)


def test_the_worst_of_shared_slots_is_kept():
    tally, points = RunStatistics(), np.array([3, 1], np.uint16)
    for other, spill in ((0.1, 0.2), (0.2, 0.1)):
        ratio = np.array([other, 0.9], np.float32), np.array([spill, 0.9], np.float32)
        tally.enter(sent(proof=SelectivityReport(points, *ratio)), None)
    tally.enter(sent(), None)
    tally.enter(sent(proof=SelectivityReport(np.ones(2, np.uint16), *ratio)), None)
    assert (tally.off_target, tally.spill) == pytest.approx((0.2, 0.2))


def test_the_worst_kernels_of_all_modes_count(bank):
    tally = RunStatistics(kernels=bank, modes={Mode.RA})
    assert tally.selectivity == (bank.off_target[Afferent.RA].max(), bank.spill[Afferent.RA].max())
    tally.modes.add(Mode.SAI)
    both = [Afferent.RA, Afferent.SAI]
    worst = [max(values[kind].max() for kind in both) for values in (bank.off_target, bank.spill)]
    assert list(tally.selectivity) == worst
