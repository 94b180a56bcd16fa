"""Constant stimuli, staircases, QUEST+ and mixtures: what is shown, and what is found."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.experiments.procedures import (
    RATIOS,
    constant_stimuli,
    interleave,
    quest_plus,
    ratio_pairs,
    weighted_staircase,
)

from .simulated import PROCEDURES, TASKS, answer_all, ask_all, recover


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


@settings(deadline=None)
@given(st.sets(st.integers(1, 24)), st.sets(st.integers(25, 40)))
def test_unanswered_trials_come_again_once(missed, missed_again):
    procedure = constant_stimuli(ratio_pairs([30.0], RATIOS[:4]), 6, seed=3)
    count = iter(range(1, 1000))
    shown = ask_all(procedure, lambda _: None if next(count) in missed | missed_again else False)
    assert len(shown) == 24 + len(missed)
    assert shown[24:] == [shown[n - 1] for n in sorted(missed)]


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
    answers = answer_all(quest_plus(1.0, 2.0, most_trials=80), lambda _: 0.75, seed=1)
    first = answers.interval == 1
    assert all(first[start : start + 8].sum() == 4 for start in range(0, 80, 8))
    assert set(answers.interval) == {1, 2}


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("name", PROCEDURES)
def test_thresholds_come_back(task, name):
    found = recover(task, name, subjects=24)
    assert found.without <= 8
    # Weber fractions are from 8 to 40 %: what is found has to be told apart from any other.
    assert abs(found.fitted.mean()) < 0.06
    assert found.fitted.std() < 0.16
    assert 20 <= found.trials <= 100
    assert found.covered >= 0.75
