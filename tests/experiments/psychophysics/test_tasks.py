"""Every experiment of the catalog shows what its conditions name, and has the right answer."""

import math

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ExperimentError
from smarttouch.experiments.psychophysics.catalog import CATALOG, ExperimentOptions, new_experiment
from smarttouch.experiments.psychophysics.procedures import Condition

from ...raising import raises
from .simulated import ask_all


def conditions(made):
    """Walk through an experiment, all answered right."""
    return ask_all(made.procedure)


def sites(train, afferent=Afferent.RA):
    return np.flatnonzero(train.activation[afferent]).tolist()


def test_the_paper_s_frequencies(profile):
    made = new_experiment("frequency", profile, ExperimentOptions())
    shown = conditions(made)
    assert len(shown) == 500
    assert {each.standard for each in shown} == {15, 30, 45, 60, 75}
    ratios = {round(each.comparison / each.standard, 2) for each in shown}
    assert (min(ratios), max(ratios)) == (0.5, 2.0)
    assert made.notes == []


def test_comparisons_above_the_limit_are_left_out_with_a_note(profile, changed):
    made = new_experiment("frequency", profile, ExperimentOptions(Afferent.PC, repetitions=1))
    assert max(each.comparison for each in conditions(made)) <= 200
    made = new_experiment("frequency", profile, ExperimentOptions(Afferent.PC))
    assert {each.standard for each in conditions(made)} == {15, 30, 45, 60, 75, 90, 100}
    slow = changed(profile, {"limits.rate_hz": 100.0})
    made = new_experiment("frequency", slow, ExperimentOptions(repetitions=1, standards=(75.0,)))
    (note,) = made.notes
    assert "3 " in note
    assert "100 Hz" in note
    assert max(each.comparison for each in conditions(made)) <= 100


@pytest.mark.parametrize("method", ["staircase", "questplus"])
def test_adaptive_frequencies_are_above_their_standards_and_mixed(profile, method):
    wanted = ExperimentOptions(procedure=method, standards=(30.0, 75.0), trials=8)
    shown = conditions(new_experiment("frequency", profile, wanted))
    assert {each.standard for each in shown} == {30, 75}
    assert all(1 < each.comparison / each.standard <= 2 for each in shown)
    order = [each.standard for each in shown]
    assert order != sorted(order)


def test_a_frequency_trial(profile):
    task = new_experiment("frequency", profile, ExperimentOptions()).task
    for at, target in ((1, "1"), (2, "2")):
        trial = task.trial(Condition(30.0, 45.0, at, 0, 0))
        assert (trial.target, trial.success) == (target, target)
        assert trial.intervals[at - 1].period_us == 22_222
        assert trial.intervals[2 - at].period_us == 33_333
    slower = task.trial(Condition(30.0, 20.0, 1, 0, 0))
    assert (slower.target, slower.success) == ("2", "1")
    assert "30 Hz" in slower.words
    assert "20 Hz" in slower.words
    assert task.trial(Condition(30.0, 30.0, 1, 0, 0)).target == ""


def test_detection_counts_in_milliamperes(profile):
    made = new_experiment("detection", profile, ExperimentOptions(site=9))
    shown = conditions(made)
    assert len(shown) == 80
    assert sum(each.comparison == 0 for each in shown) == 10
    trial = made.task.trial(Condition(0.0, 1.2, 0, 0, 0))
    (train,) = trial.intervals
    assert train.level * profile.full_ma[9] == pytest.approx(1.2)
    assert (sites(train), trial.target, trial.success, trial.exact) == ([9], "y", "y", True)
    blank = made.task.trial(Condition(0.0, 0.0, 0, 0, 0))
    assert not blank.intervals[0].activation.any()
    assert (blank.target, blank.success) == ("n", "y")


def test_detection_in_two_intervals_has_a_blank_of_the_same_level(profile):
    made = new_experiment("detection", profile, ExperimentOptions(two_intervals=True))
    assert not any(each.comparison == 0 for each in conditions(made))
    first, second = made.task.trial(Condition(0.0, 1.0, 2, 0, 0)).intervals
    assert not first.activation.any()
    assert second.activation.any()
    assert first.level == second.level < 1


def test_no_level_is_above_the_strongest(profile, changed):
    tight = changed(profile, {"perception.comfort_ratio": 1.05})
    for method in ("constant", "staircase", "questplus"):
        made = new_experiment("detection", tight, ExperimentOptions(procedure=method))
        for each in conditions(made)[:20]:
            assert each.comparison <= tight.full_ma.max() + 1e-6
            assert all(train.level <= 1 for train in made.task.trial(each).intervals)


def test_discomfort_rises_to_the_profile_s_own_ceiling(profile):
    made = new_experiment("discomfort", profile, ExperimentOptions(repetitions=3))
    shown = conditions(made)
    assert len(shown) == 3
    assert all(math.isnan(each.comparison) for each in shown)
    (train,) = made.task.trial(shown[0]).intervals
    assert train.rises
    assert train.level == 1.0
    assert train.pulses * train.period_us == 10_000_000


def test_the_second_point_is_as_far_right_as_stated(profile):
    made = new_experiment("localization", profile, ExperimentOptions())
    shown = conditions(made)
    assert {each.comparison for each in shown} == {-6, -4, -2, 2, 4, 6}
    for each in shown[:12]:
        trial = made.task.trial(each)
        (first,), (second,) = map(sites, trial.intervals)
        moved_mm = profile.electrodes.position_mm[second] - profile.electrodes.position_mm[first]
        assert moved_mm == pytest.approx((each.comparison, 0))
        assert (trial.target, trial.success) == ("r" if each.comparison > 0 else "l", "r")


def test_every_experiment_has_a_question_and_answers(profile):
    for name in CATALOG:
        made = new_experiment(name, profile, ExperimentOptions())
        trial = made.task.trial(next(made.procedure))
        assert trial.question
        assert trial.alternatives
        assert trial.words
        assert trial.success in trial.alternatives


@pytest.mark.parametrize(("name", "options", "about", "value", "allowed"), [
    ("hearing", {}, "experiment", "hearing", tuple(CATALOG)),
    ("localization", {"procedure": "staircase"}, "procedure", "staircase", ("constant",)),
    ("frequency", {"site": 64}, "site", 64, None),
    ("frequency", {"standards": (300.0,)}, "standards", None, 200),
    ("frequency", {"standards": (200.0,), "procedure": "staircase"}, "standards", 200, 200),
    ("localization", {"site": 0}, "site", 0, None),
    ("discomfort", {"train_s": 0.9}, "train_s", 0.9, 1),
])  # fmt: skip
def test_what_cannot_be_asked_for(profile, name, options, about, value, allowed):
    with raises(ExperimentError, value=value, allowed=allowed):
        new_experiment(name, profile, ExperimentOptions(**options))


@pytest.mark.parametrize("name", ["detection", "discomfort"])
def test_where_width_carries_intensity_nothing_counts_in_milliamperes(profile, changed, name):
    by_width = changed(profile, {"pulse.carrier": "width"})
    with raises(ExperimentError, names="pulse.carrier", value="width", allowed=("height",)):
        new_experiment(name, by_width, ExperimentOptions())
