"""A session that is interrupted, whenever and however, has the trials of one that is not."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.base.errors import ExperimentError
from smarttouch.experiments.answers import read_rows
from smarttouch.experiments.experiment_session import open_experiment
from smarttouch.experiments.trials import Answer, Setup
from smarttouch.profile import load_profile

from ..support.checks import raises
from ..support.full import WHOLE
from .sitting import Perfect, sit

SHORT = {"repetitions": 1, "standards": "30", "train_s": 0.15}
MOUSE = load_profile("electric-mouse")
SHOWN = "standard", "comparison", "comparison_interval", "thisN", "success"


def shown(rows):
    return [[row[each] for each in SHOWN] for row in rows]


def respond(path, answers, most=1000, name="frequency", **options):
    """Answer trials, as many as there are answers for; return whether it is over."""
    setup = Setup(MOUSE, **{"standards": "30,60", "repetitions": 1, "trials": 8} | options)
    with open_experiment(name, setup, path, "p", "s") as sitting:
        trials = sitting.source()._trials
        answer = None
        for _ in range(most + 1):
            try:
                trial = next(trials) if answer is None else trials.send(answer)
            except StopIteration:
                break
            response = answers[len(sitting.file.rows) % len(answers)]
            answer = Answer(response, response == trial.success if response else None, 0.3)
        return sitting.over


@settings(max_examples=8, deadline=None)
@given(
    st.sampled_from(("constant", "staircase", "questplus")),
    st.lists(st.sampled_from(["1", "2", ""]), min_size=1, max_size=7),
    st.lists(st.integers(0, 12), max_size=3),
    st.integers(0, 60),
)
def test_stopped_and_killed_sessions_have_each_trial_once(
    tmp_path_factory, procedure, answers, stops, cut
):
    folder = tmp_path_factory.mktemp("rows")
    whole, parts = folder / "whole.csv", folder / "parts.csv"
    assert respond(whole, answers, procedure=procedure)
    for stop in stops:
        respond(parts, answers, stop, procedure=procedure)
        # Killed while a line was written: what is cut is lost, and its trial comes again.
        lines = parts.read_bytes()
        if lines.count(b"\n") > 1:
            last = lines.rindex(b"\n", 0, -1) + 1
            parts.write_bytes(lines[: last + min(cut, len(lines) - last - 1)])
    assert respond(parts, answers, procedure=procedure)
    assert shown(read_rows(parts)) == shown(read_rows(whole))


@pytest.mark.parametrize("stop_after", [0, 4, 9] if WHOLE else [4])
def test_a_run_that_is_stopped_in_the_middle_of_a_trial_goes_on(
    profile, bank, tmp_path, stop_after
):
    def begin(name, **options):
        setup = Setup(profile, **SHORT)
        return sit("frequency", setup, bank, tmp_path / name, Perfect(), **options)

    whole, first = begin("whole.csv"), begin("parts.csv", stop_after=stop_after)
    assert len(first.rows) == stop_after
    assert not first.over
    parts = tmp_path / "parts.csv"
    parts.write_bytes(parts.read_bytes()[:-3] if stop_after else parts.read_bytes())
    second = begin("parts.csv")
    assert second.resumed == max(0, stop_after - 1)
    assert second.over
    assert shown(read_rows(parts)) == shown(whole.rows)
    assert second.told[0][1].startswith(f"trial {second.resumed + 1}: ")


def test_rows_hold_what_was_shown_and_answered(profile, bank, tmp_path):
    path = tmp_path / "rows.csv"
    sat = sit("frequency", Setup(profile, **SHORT), bank, path, Perfect())
    rows = read_rows(path)
    assert rows == sat.rows
    assert [row["thisN"] for row in rows] == list(range(10))
    for row in rows:
        assert row["response"] == row["target"]
        assert row["success"] == (row["comparison"] > row["standard"])
        about = row["experiment"], row["participant"], row["session"], row["procedure"]
        assert about == ("frequency-RA", "p1", "s1", "constant")
        assert (row["unit"], row["level"], row["rt"]) == ("Hz", 1.0, 0.0)
    row = rows[0]
    where = {1: "first", 2: "second"}[row["comparison_interval"]]
    (asked,), (answered,) = sat.events("trial 1:"), sat.events("response 1:")
    assert all(each in asked for each in ("30 Hz", f"{row['comparison']:g} Hz", where))
    assert all(each in answered for each in (row["response"], "0.00 s"))


@pytest.mark.parametrize("other", [{"standards": "45"}, {"standards": "30", "trials": 4}])
def test_another_experiment_s_answers_are_not_gone_on_with(tmp_path, other):
    """Trials of another standard, or more answers than there are trials."""
    path = tmp_path / "rows.csv"
    own = {"standards": "30"} if "trials" in other else {}
    respond(path, ["1", "2"], procedure="questplus", **own)
    before = path.read_bytes()
    with raises(ExperimentError, names="trial", value=5 if own else 1):
        respond(path, ["1"], procedure="questplus", **other)
    assert path.read_bytes() == before


def test_an_experiment_that_cannot_be_leaves_no_file(tmp_path):
    with raises(ExperimentError, names="site", value=0):
        respond(tmp_path / "rows.csv", ["1"], name="localization", site=0)
    assert not list(tmp_path.iterdir())


def test_a_level_that_rose_is_kept_as_it_was_reached(tmp_path):
    path = tmp_path / "rows.csv"
    for expected in (1, 2):
        setup = Setup(MOUSE, repetitions=2)
        with open_experiment("discomfort", setup, path, "p", "s") as sitting:
            assert len(sitting.file.rows) == expected - 1
            trials = sitting.source()._trials
            assert np.isnan(next(trials).condition.comparison)
            with contextlib.suppress(StopIteration):
                trials.send(Answer("y", True, reached=1.5 + expected))
            after = list(sitting.after())
    found = [(row["comparison"], row["success"]) for row in read_rows(path)]
    assert found == [(2.5, True), (3.5, True)]
    assert after[0] == "2 of 2 trials (1 in earlier runs)"
    assert after[1].startswith("enough at 3.000 mA")
