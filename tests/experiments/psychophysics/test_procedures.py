"""Constant stimuli: each pair so many times, in both orders of intervals alike."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.base.errors import ExperimentError
from smarttouch.experiments.psychophysics.procedures import (
    RATIOS,
    STANDARDS_HZ,
    constant_stimuli,
    ratio_pairs,
)

from ...raising import raises
from .simulated import ask_all


def test_the_papers_experiment():
    pairs = ratio_pairs()
    assert {standard for standard, _ in pairs} == {15, 30, 45, 60, 75}
    ratios = np.array([comparison / standard for standard, comparison in pairs])
    assert (ratios.min(), ratios.max()) == pytest.approx((0.5, 2.0), rel=1e-4)
    # Symmetric, alike in logarithms, and never the standard itself.
    assert np.log(RATIOS) == pytest.approx(-np.log(RATIOS[::-1]))
    assert np.diff(np.log(RATIOS)) == pytest.approx(np.full(9, np.log(4) / 9))
    assert len(ask_all(constant_stimuli(pairs))) == len(STANDARDS_HZ) * 10 * 10


@settings(deadline=None)
@given(st.integers(1, 6), st.integers(1, 7), st.integers(0, 2**31), st.booleans())
def test_balanced(count, repetitions, seed, two_intervals):
    pairs = [(10.0, 10.0 + each) for each in range(count)]
    shown = ask_all(constant_stimuli(pairs, repetitions, two_intervals, seed))
    assert Counter((each.standard, each.comparison) for each in shown) == dict.fromkeys(
        pairs, repetitions
    )
    for start in range(0, len(shown), count):
        block = shown[start : start + count]
        assert sorted(each.index for each in block) == list(range(count))
        assert {each.repetition for each in block} == {start // count}
        assert [each.trial for each in block] == list(range(count))
    for pair in pairs:
        first = sum(each.comparison_interval == 1 for each in shown if each.comparison == pair[1])
        low = repetitions // 2
        assert first in ((low, repetitions - low) if two_intervals else (0,))
    if two_intervals:
        firsts = sum(each.comparison_interval == 1 for each in shown)
        assert abs(2 * firsts - len(shown)) <= 1


def test_order_is_the_seeds():
    def order(seed):
        return ask_all(constant_stimuli(ratio_pairs([30.0]), seed=seed))

    assert order(1) == order(1)
    assert order(1) != order(2)
    orders = [[each.index for each in order(1)[start : start + 10]] for start in (0, 10, 20)]
    assert orders[0] != orders[1] != orders[2]


@settings(deadline=None)
@given(st.sets(st.integers(1, 24)), st.sets(st.integers(25, 40)))
def test_unanswered_trials_come_again_once(missed, missed_again):
    procedure = constant_stimuli(ratio_pairs([30.0], RATIOS[:4]), 6, seed=3)
    count = iter(range(1, 1000))
    shown = ask_all(procedure, lambda _: None if next(count) in missed | missed_again else False)
    assert len(shown) == 24 + len(missed)
    assert shown[24:] == [shown[n - 1] for n in sorted(missed)]


def test_errors():
    with raises(ExperimentError, names="conditions", value=0):
        constant_stimuli([])
