"""Staircases step by step by hand, QUEST+, and procedures that are mixed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.base.errors import ExperimentError
from smarttouch.experiments.fitting.answers import usual_model
from smarttouch.experiments.fitting.findings import judge_answers
from smarttouch.experiments.psychophysics.procedures import (
    interleave,
    quest_plus,
    weighted_staircase,
)

from ...raising import raises
from .simulated import answer_all, ask_all


def test_steps_by_hand():
    """Down 4, up 64 until the second reversal; then down 2, up 8."""
    procedure = weighted_staircase(16.0, 1.0, 256.0, 1.0)
    answers = [True, True, False, True, True, False, True]
    shown = [next(procedure), *map(procedure.send, answers)]
    assert [each.comparison for each in shown] == pytest.approx([16, 4, 1, 64, 32, 16, 128, 64])


@settings(deadline=None)
@given(st.lists(st.sampled_from([True, False, None]), min_size=60, max_size=60), st.booleans())
def test_stays_in_range_and_is_repeatable(answers, quest):
    def shown():
        answer = iter(answers)
        made = quest_plus(1.0, 2.0) if quest else weighted_staircase(1.5, 1.0, 2.0, 0.1, seed=5)
        return ask_all(made, lambda _: next(answer, True))

    found = shown()
    assert all(1.0 - 1e-12 <= each.comparison <= 2.0 + 1e-12 for each in found)
    assert [each.repetition for each in found] == list(range(len(found)))
    assert found == shown()


def test_no_answer_is_the_same_again_but_not_for_ever():
    shown = ask_all(weighted_staircase(1.5, 1.0, 2.0, 0.1, most_trials=5), lambda _: None)
    assert len(shown) == 5
    assert len({(each.comparison, each.comparison_interval) for each in shown}) == 1
    shown = ask_all(quest_plus(5.0, 80.0, most_trials=3), lambda _: None)
    assert len(shown) == 3
    assert len({each.comparison for each in shown}) == 1


@pytest.mark.parametrize("answer", [True, False])
def test_ends_where_the_range_does(answer):
    assert len(ask_all(weighted_staircase(1.5, 1.0, 2.0, 0.1), lambda _: answer)) < 12


@pytest.mark.parametrize(("make", "arguments", "value"), [
    (weighted_staircase, (3.0, 1.0, 2.0, 0.1), 3.0),
    (weighted_staircase, (1.0, 1.0, 1.0, 0.1), 1.0),
    (weighted_staircase, (0.5, 0.0, 2.0, 0.1), 0.0),
    (weighted_staircase, (1.5, 1.0, 2.0, 0.0), 0.0),
    (weighted_staircase, (1.5, 1.0, 2.0, 0.1, 1.0, 1.0), 1.0),
    (quest_plus, (2.0, 1.0), 2.0),
    (quest_plus, (0.0, 1.0), 0.0),
])  # fmt: skip
def test_errors(make, arguments, value):
    with raises(ExperimentError, value=value):
        make(*arguments)


def test_quest_plus_comes_to_a_known_threshold():
    answers = answer_all(
        quest_plus(5.0, 80.0, 0.0, two_intervals=False), lambda ma: float(ma > 21.0)
    )
    found = judge_answers(answers, usual_model([answers])).threshold
    assert found.value == pytest.approx(21.0, rel=0.08)
    assert found.high / found.low < 1.4
    assert not answers.interval.any()


def test_interleaved_mixes_them_all():
    count = iter(range(1000))
    shown = ask_all(
        interleave(
            [
                weighted_staircase(1.6 * hz, hz, 2 * hz, 0.05, hz, most_trials=30, seed=3)
                for hz in (15.0, 30.0, 45.0)
            ],
            3,
        ),
        lambda _: next(count) % 4 != 3,
    )
    assert all(each.standard == (15.0, 30.0, 45.0)[each.index] for each in shown)
    order = [each.index for each in shown]
    assert set(order) == {0, 1, 2}
    # Not one after the other.
    assert sum(np.diff(order) != 0) > 20


def test_intervals_are_balanced():
    procedure = weighted_staircase(1.5, 1.0, 2.0, 0.01, most_trials=80, reversals=1000)
    answers = answer_all(procedure, lambda _: 0.75, seed=1)
    first = answers.interval == 1
    assert all(first[start : start + 8].sum() == 4 for start in range(0, 80, 8))
    assert set(answers.interval) == {1, 2}
