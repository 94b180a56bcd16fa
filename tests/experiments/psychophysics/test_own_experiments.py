"""Experiments of a file or another package: run as ours, and one sentence where they are wrong."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smarttouch.base.errors import ExperimentError
from smarttouch.experiments.psychophysics.catalog import (
    ExperimentOptions,
    find_experiment,
    new_experiment,
)
from smarttouch.lab import Stimuli, constant_stimuli
from smarttouch.profile import load_profile

from ...installed import install
from ...raising import raises
from .sitting import sit

EXAMPLE = Path(__file__).parents[3] / "examples/own_experiment.py"
MOUSE = load_profile("electric-mouse")
WANTED = ExperimentOptions(repetitions=3, seed=4)
FILE = """
from smarttouch.lab import Design, Experiment, constant_stimuli, in_two_intervals
class Mine:
    def trial(self, condition):
        return {trial}
def make(stimuli, options, method):
    return {design}
{experiment}
"""
GOOD = {
    "trial": "None",
    "design": "Design(Mine(), constant_stimuli([(0, 1)], 1), method)",
    "experiment": "mine = Experiment('what is it', make)",
}


class Counts:
    """Answers that the interval with fewer pulses had the gap."""

    def respond(self, task, intervals, alternatives):
        return alternatives[int(np.argmin([len(each.time_s) for each in intervals]))]


def test_a_file_is_an_experiment(tmp_path, bank):
    made = new_experiment(str(EXAMPLE), MOUSE, replace(WANTED, repetitions=1))
    sat = sit(made, MOUSE, bank, tmp_path / "rows.csv", Counts(), experiment="gap-RA")
    rows = [(row.unit, row.comparison, row.success) for row in sat.session.rows]
    assert sorted(rows) == [("mm", gap_mm, True) for gap_mm in (2, 6, 10)]
    assert sat.figures["emulator_violations"] == 0
    trial = made.task.trial(next(constant_stimuli([(0, 2)])))
    gap, whole = sorted(trial.intervals, key=lambda each: each.activation.sum())
    assert (whole.activation - gap.activation).sum() == 2
    assert trial.intervals[int(trial.target) - 1] is gap


def test_another_package_has_one(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    points = {"smarttouch.experiments": {"gap": "their_gap:experiment", "other": "their_gap:make"}}
    install(tmp_path, "theirs", points, {"their_gap": EXAMPLE.read_text("utf-8")})
    assert find_experiment("gap").about == "which had a gap: width, mm"
    assert len(list(new_experiment("gap", MOUSE, WANTED).procedure)) == 9 + 9
    with raises(ExperimentError, value="Experiment", names="other"):
        find_experiment("other")
    install(tmp_path, "more", points, {})
    with raises(ExperimentError, value="more and theirs", names="experiment"):
        find_experiment("gap")


@pytest.mark.parametrize(("changed", "words"), [
    ({"experiment": ""}, ["no Experiment"]),
    ({"experiment": "a, b = (Experiment('what', make) for _ in 'ab')"}, ["2 Experiments"]),
    ({"experiment": "1 / 0"}, ["line 8", "ZeroDivisionError"]),
    ({"experiment": "1 +"}, ["line 8", "SyntaxError"]),
    ({"design": "None"}, ["make", "NoneType", "Design"]),
    ({"design": "1 / 0"}, ["line 7", "ZeroDivisionError"]),
    ({"design": "Design(Mine(), constant_stimuli([], 1), method)"}, ["0 conditions"]),
    ({"design": "Design(Mine(), [(0, 1)], method)"}, ["procedure", "list", "generator"]),
    ({}, ["trial", "NoneType", "Trial"]),
    ({"trial": "condition.gap"}, ["line 5", "AttributeError", "gap"]),
])  # fmt: skip
def test_what_is_wrong_in_it_is_one_sentence(tmp_path, changed, words):
    path = tmp_path / "mine.py"
    path.write_text(FILE.format(**GOOD | changed), encoding="utf-8")
    with pytest.raises(ExperimentError) as error:
        new_experiment(str(path), MOUSE, WANTED).task.trial(next(constant_stimuli([(0, 1)])))
    assert all(each in str(error.value) for each in words)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["gap", "gap.py", "."])
def test_one_that_is_not_there(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with raises(ExperimentError, value=name):
        new_experiment(name, MOUSE, WANTED)


def test_sites_are_whole_numbers_and_activations_are_not():
    stimuli = Stimuli(MOUSE, WANTED.afferent, 0.5)
    on = np.zeros(64, bool)
    on[[3, 5]] = True
    for where in ([3, 5], np.array([3, 5]), on, on.astype(np.float32)):
        train = stimuli.train(where, 50)
        assert np.flatnonzero(train.activation[WANTED.afferent]).tolist() == [3, 5]
    with raises(ExperimentError, value="(6,)"):
        stimuli.train(np.zeros(6), 50)
