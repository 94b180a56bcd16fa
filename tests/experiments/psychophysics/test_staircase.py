"""The weighted staircase, step by step by hand, and what it comes to rest at."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.base.errors import ExperimentError
from smarttouch.experiments.psychophysics.adaptive_procedures import QuestPlus, WeightedStaircase
from smarttouch.experiments.psychophysics.procedures import Interleaved

from ...raising import raises
from .simulated import answer_all


def levels(procedure, answers):
    found = []
    for answer in answers:
        found.append(procedure.next().comparison)
        procedure.answer(answer)
    return found


def test_steps_by_hand():
    """Down 2, up 6 until the second reversal; then down 1, up 3."""
    procedure = WeightedStaircase(20.0, 0.0, 40.0, 1.0, logarithmic=False)
    shown = levels(procedure, [True, True, False, True, True, False, True])
    assert shown == [20, 18, 16, 22, 21, 20, 23]
    assert procedure.turns == [16, 22, 20, 23]
    assert procedure.next().comparison == 22


def test_estimate_by_hand():
    procedure = WeightedStaircase(20.0, 0.0, 40.0, 1.0, logarithmic=False, reversals=7)
    levels(procedure, [True, False, True])
    assert procedure.turns == [18, 24]
    levels(procedure, [False, True, False, True, False])
    assert procedure.done
    # Turns 23, 26, 25, 28, 27: the first is left over; of 26, 25 and 28, 27 the middles.
    assert procedure.turns[2:] == [23, 26, 25, 28, 27]
    found = procedure.estimate()
    assert (found.threshold, found.trials) == (26.5, 8)
    assert found.spread == pytest.approx(np.std([25.5, 27.5], ddof=1) / math.sqrt(2))


@settings(deadline=None)
@given(st.lists(st.sampled_from([True, False, None]), max_size=60), st.booleans())
def test_stays_in_range_and_is_repeatable(answers, logarithmic):
    def shown():
        procedure = WeightedStaircase(1.5, 1.0, 2.0, 0.1, logarithmic=logarithmic, seed=5)
        found = []
        for answer in answers:
            if procedure.done:
                break
            found.append(procedure.next())
            assert procedure.next() == found[-1]
            procedure.answer(answer)
        return found

    found = shown()
    assert all(1.0 <= each.comparison <= 2.0 + 1e-12 for each in found)
    assert [each.repetition for each in found] == list(range(len(found)))
    assert found == shown()


def test_no_answer_is_the_same_again_but_not_for_ever():
    procedure = WeightedStaircase(1.5, 1.0, 2.0, 0.1, most_trials=5)
    first = procedure.next()
    procedure.answer(None)
    again = procedure.next()
    assert (again.comparison, again.comparison_interval) == (
        first.comparison,
        first.comparison_interval,
    )
    for _ in range(4):
        procedure.answer(None)
    assert procedure.done
    assert procedure.estimate() is None


@pytest.mark.parametrize("answer", [True, False])
def test_ends_where_the_range_does(answer):
    procedure = WeightedStaircase(1.5, 1.0, 2.0, 0.1)
    while not procedure.done:
        procedure.answer(answer)
    assert procedure.trials < 12
    assert procedure.estimate() is None
    with raises(ExperimentError, names="trial"):
        procedure.next()


@pytest.mark.parametrize(("arguments", "about", "value"), [
    ((3.0, 1.0, 2.0, 0.1), "start", 3.0),
    ((1.0, 1.0, 1.0, 0.1), "start", 1.0),
    ((0.5, 0.0, 2.0, 0.1), "lowest", 0.0),
    ((1.5, 1.0, 2.0, 0.0), "step", 0.0),
    ((1.5, 1.0, 2.0, 0.1, 1.0, 1.0), "target", 1.0),
])  # fmt: skip
def test_errors(arguments, about, value):
    with raises(ExperimentError, value=value):
        WeightedStaircase(*arguments)


def interleaved(seed=3):
    return Interleaved(
        [
            WeightedStaircase(1.6 * hz, hz, 2 * hz, 0.05, hz, most_trials=30, seed=seed)
            for hz in (15.0, 30.0, 45.0)
        ],
        seed,
    )


def test_interleaved_mixes_them_all():
    procedure = interleaved()
    order = []
    while not procedure.done:
        condition = procedure.next()
        assert procedure.next() == condition
        assert condition.standard == (15.0, 30.0, 45.0)[condition.index]
        order.append(condition.index)
        procedure.answer(len(order) % 4 != 0)
    assert set(order) == {0, 1, 2}
    # Not one after the other.
    assert sum(np.diff(order) != 0) > 20
    assert procedure.estimate() is None
    assert len(procedure.estimates()) == 3
    assert procedure.total is None
    with raises(ExperimentError, names="trial"):
        procedure.next()


def test_interleaved_of_one_and_of_known_length():
    one = Interleaved([QuestPlus(1.0, 2.0, most_trials=3)])
    assert one.total == 3
    answer_all(one, lambda _: 1.0)
    assert one.estimate() == one.estimates()[0]
    with raises(ExperimentError):
        Interleaved([])


def test_intervals_are_balanced():
    procedure = WeightedStaircase(1.5, 1.0, 2.0, 0.01, most_trials=80, reversals=1000)
    answers = answer_all(procedure, lambda _: 0.75, seed=1)
    first = answers.interval == 1
    assert all(first[start : start + 8].sum() == 4 for start in range(0, 80, 8))
    assert set(answers.interval) == {1, 2}
