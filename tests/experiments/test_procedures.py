"""Constant stimuli, staircases and QUEST+: order of the conditions, and accuracy of estimates."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.experiments.answer_file import usual_model
from smarttouch.experiments.findings import judge_answers
from smarttouch.experiments.procedures import (
    RATIOS,
    constant_stimuli,
    quest_plus,
    ratio_pairs,
    weighted_staircase,
)

from ..support.full import sample
from .simulated import Subject, answer_all, ask_all


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
    """Success divides the comparison by 4 or, later, by 2. Failure multiplies by 64, later by 8."""
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


def test_intervals_are_balanced():
    answers = answer_all(quest_plus(1.0, 2.0, most_trials=80), lambda _: 0.75, seed=1)
    first = answers.interval == 1
    assert all(first[start : start + 8].sum() == 4 for start in range(0, 80, 8))
    assert set(answers.interval) == {1, 2}


STANDARD = 30.0
LEVELS = 0.5 * 2 ** (np.arange(-4, 5) / 4)
LOW, HIGH = 1.01 * STANDARD, 2 * STANDARD
AS_USED = {
    ("discrimination", "constant"): lambda seed: constant_stimuli(
        ratio_pairs([STANDARD]), seed=seed
    ),
    ("discrimination", "staircase"): lambda seed: weighted_staircase(
        1.6 * STANDARD, LOW, HIGH, 0.03, STANDARD, seed=seed
    ),
    ("discrimination", "questplus"): lambda seed: quest_plus(LOW, HIGH, 0.5, STANDARD, seed=seed),
    ("detection", "constant"): lambda seed: constant_stimuli(
        [(0.0, float(each)) for each in LEVELS], two_intervals=False, seed=seed
    ),
    ("detection", "staircase"): lambda seed: weighted_staircase(
        1.0, 0.1, 2.0, 0.05, target=0.5, two_intervals=False, seed=seed
    ),
    ("detection", "questplus"): lambda seed: quest_plus(
        0.1, 2.0, 0.0, two_intervals=False, seed=seed
    ),
}
"""Procedures with the settings of real sessions, by task and method."""


def draw_subject(task, random):
    """Return a participant with a random lapse rate and a random Weber fraction or threshold."""
    lapse = random.uniform(0, 0.05)
    if task == "discrimination":
        weber = np.exp(random.uniform(np.log(0.08), np.log(0.4)))
        return Subject(STANDARD * (1 + weber), np.log1p(weber) / 0.6745, 0.75, lapse)
    threshold = 0.5 * np.exp(random.normal(0, 0.25))
    return Subject(threshold, random.uniform(0.08, 0.3), 0.5, lapse, guess=0.0)


def recover(task, name, subjects):
    """Return threshold errors, whether intervals contain the true threshold, and trial counts."""
    random, errors, held, trials = np.random.default_rng(0), [], [], []
    for seed in range(subjects):
        subject = draw_subject(task, random)
        answers = answer_all(AS_USED[task, name](seed), subject.probability, [0, seed])
        trials.append(answers.answered)
        found = judge_answers(answers, usual_model([answers]))
        if found.verdict is None:
            errors.append(np.log(found.threshold.value / subject.threshold))
            held.append(found.threshold.low <= subject.threshold <= found.threshold.high)
    return errors, held, trials


@pytest.mark.parametrize(("task", "name"), sample(AS_USED))
def test_thresholds_come_back(task, name):
    errors, held, trials = recover(task, name, 24)
    assert len(errors) >= 16
    # Errors must be small compared with the range of the Weber fractions, 8 to 40 %.
    assert abs(np.mean(errors)) < 0.06
    assert np.std(errors) < 0.16
    assert 20 <= np.mean(trials) <= 100
    assert np.mean(held) >= 0.75
