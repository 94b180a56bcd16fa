"""Level and anatomy by answers: never too many, never a leap, resumed where they were."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.base.errors import CalibrationError, ExperimentError
from smarttouch.experiments.calibration.level_procedure import (
    ANATOMIES,
    LEVELS,
    MOST_ANSWERS,
    SHOWN,
    LevelProcedure,
    LevelTask,
)
from smarttouch.experiments.psychophysics.tasks import middle_discs
from smarttouch.profile import load_profile

from ...raising import raises

PROFILE = load_profile("electric-mouse")


def answered(answers, seed=0):
    """Give answers in turn, again from the first after the last; return all conditions."""
    procedure, shown = LevelProcedure(PROFILE, seed), []
    while not procedure.done:
        shown.append(procedure.next())
        assert procedure.next() == shown[-1]
        procedure.answer(answers[(len(shown) - 1) % len(answers)])
    return procedure, shown


def person(anodic_ma, cathodic_ma, crossing):
    """Return the procedure after the answers of somebody with sharp thresholds."""
    procedure = LevelProcedure(PROFILE)
    while not procedure.done:
        shown = procedure.next()
        limit = (anodic_ma, cathodic_ma)[shown.index] if shown.index < 2 else crossing
        procedure.answer(shown.comparison > limit)
    return procedure.found


@settings(max_examples=20)
@given(st.lists(st.sampled_from([True, True, False, False, None]), min_size=1, max_size=60),
       st.integers(0, 9))  # fmt: skip
def test_any_answers_lead_to_a_level_within_sixty(answers, seed):
    try:
        procedure, shown = answered(answers, seed)
    except CalibrationError:
        # All answers to the discs were alike.
        return
    found = procedure.found
    assert len(shown) <= MOST_ANSWERS
    assert found.level in LEVELS
    assert found.anatomy in ANATOMIES
    assert 0.5 <= found.probability <= 1
    assert 0 <= found.expected_wrong <= 1
    low, high = found.polarity.interval
    assert 0 < low <= found.polarity.ratio <= high
    # Letters begin in the lower half, and no level comes before the one below it.
    places = [int(np.flatnonzero(each.comparison == SHOWN)[0]) for each in shown if each.index > 1]
    highest = np.maximum.accumulate([1, *places])
    assert (np.diff(highest) <= 1).all()
    most_ma = PROFILE.full_ma.max() * (1 + 1e-6)
    assert all(0 < each.comparison <= most_ma for each in shown if each.index < 2)


def test_the_anatomy_shows_and_the_level_follows_the_threshold():
    paper, branched = person(1.5, 1.05, 0.48), person(0.65, 0.9, 0.26)
    assert (paper.anatomy, branched.anatomy) == ANATOMIES
    assert paper.level >= 0.85
    assert 0.4 <= branched.level <= 0.6
    assert person(1.0, 1.4, 0.4).level > branched.level


def test_the_same_answers_lead_to_the_same_conditions():
    answers = [True, False, False, True, True]
    assert answered(answers, 3)[1] == answered(answers, 3)[1]
    assert answered(answers, 3)[1] != answered(answers, 4)[1]


@pytest.mark.parametrize("felt", [True, False])
def test_one_answer_to_all_is_no_test(felt):
    with raises(CalibrationError):
        answered([felt])


def test_trials_are_a_disc_of_either_polarity_or_a_letter(profile):
    task, (_, shown) = LevelTask(profile), answered([True, False, True])
    discs = middle_discs(profile)
    assert len(discs) == len(set(discs)) == 16
    for condition in shown:
        trial = task.trial(condition)
        (train,) = trial.intervals
        rows = train.activation.any(axis=1)
        if condition.index < 2:
            assert rows.tolist() == [False, condition.index == 1, condition.index == 0]
            assert np.flatnonzero(train.activation.any(axis=0)).tolist() == [
                discs[condition.repetition % 16]
            ]
            assert train.level * profile.full_ma[0] == pytest.approx(condition.comparison)
        else:
            letter = LevelProcedure.letter_of(condition)
            assert rows.tolist() == [True, False, False]
            assert (trial.target, train.level) == (letter, condition.comparison)
            assert np.array_equal(train.activation[0], task.drawn[letter])


def test_an_array_that_draws_no_letters_is_refused():
    with raises(ExperimentError, names="profile"):
        LevelTask(load_profile("line-8"))
