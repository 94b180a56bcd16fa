"""A session that is interrupted, whenever and however, has the trials of one that is not."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.base.errors import ExperimentError
from smarttouch.experiments.psychophysics.catalog import ExperimentOptions, new_experiment
from smarttouch.experiments.psychophysics.experiment_session import TrialSession
from smarttouch.experiments.psychophysics.trial_rows import About, RowFile, read_rows
from smarttouch.experiments.psychophysics.trials import Answer
from smarttouch.profile import load_profile

from ...raising import raises
from ...whole import WHOLE
from .sitting import DATE, Perfect, sit

SHORT = ExperimentOptions(repetitions=1, standards=(30.0,), train_s=0.15)
MOUSE = load_profile("electric-mouse")
METHODS = ("constant", "staircase", "questplus")


def shown(rows):
    return [(row.standard, row.comparison, row.comparison_interval, row.number) for row in rows]


def respond(path, answers, method="constant", most=1000, seed=0):
    """Answer trials, as many as there are answers for; return whether it is over."""
    wanted = ExperimentOptions(
        procedure=method, standards=(30.0, 60.0), repetitions=1, trials=8, seed=seed
    )
    made = new_experiment("frequency", MOUSE, wanted)
    with RowFile(path, About("f", made.method, "p", "s", seed)) as file:
        session = TrialSession(made, file, DATE)
        for _ in range(most):
            trial = session.next()
            if trial is None:
                break
            at = session.done
            response = answers[at % len(answers)]
            session.record(trial, Answer(response, 0.3, 1.0 + at, 0.5))
        return session.over


@settings(max_examples=8, deadline=None)
@given(
    st.sampled_from(METHODS),
    st.lists(st.sampled_from(["1", "2", ""]), min_size=1, max_size=7),
    st.lists(st.integers(0, 12), max_size=3),
    st.integers(0, 60),
)
def test_stopped_and_killed_sessions_have_each_trial_once(
    tmp_path_factory, method, answers, stops, cut
):
    folder = tmp_path_factory.mktemp("rows")
    whole, parts = folder / "whole.csv", folder / "parts.csv"
    assert respond(whole, answers, method)
    for stop in stops:
        respond(parts, answers, method, most=stop)
        # Killed while a line was written: what is cut is lost, and its trial comes again.
        lines = parts.read_bytes()
        if lines.count(b"\n") > 1:
            last = lines.rindex(b"\n", 0, -1) + 1
            parts.write_bytes(lines[: last + min(cut, len(lines) - last - 1)])
    assert respond(parts, answers, method)
    assert shown(read_rows(parts)) == shown(read_rows(whole))
    assert parts.read_bytes() == whole.read_bytes()


@pytest.fixture(scope="module")
def whole(profile, bank, tmp_path_factory):
    """Return the rows of a session that was not interrupted."""
    path = tmp_path_factory.mktemp("whole") / "whole.csv"
    return sit(
        new_experiment("frequency", profile, SHORT), profile, bank, path, Perfect()
    ).session.rows


@pytest.mark.parametrize("stop_after", [0, 4, 9] if WHOLE else [4])
def test_a_run_that_is_stopped_in_the_middle_of_a_trial_goes_on(
    profile, bank, tmp_path, whole, stop_after
):
    parts = tmp_path / "parts.csv"

    def design_it():
        return new_experiment("frequency", profile, SHORT)

    first = sit(design_it(), profile, bank, parts, Perfect(), stop_after=stop_after)
    assert first.session.done == stop_after
    assert not first.session.over
    parts.write_bytes(parts.read_bytes()[:-3] if stop_after else parts.read_bytes())
    second = sit(design_it(), profile, bank, parts, Perfect())
    assert second.session.resumed == max(0, stop_after - 1)
    assert second.session.over
    assert shown(read_rows(parts)) == shown(whole)
    assert [row.success for row in read_rows(parts)] == [row.success for row in whole]


def test_rows_hold_what_was_shown_and_answered(profile, bank, tmp_path):
    path = tmp_path / "rows.csv"
    sat = sit(new_experiment("frequency", profile, SHORT), profile, bank, path, Perfect())
    rows = read_rows(path)
    assert [row.number for row in rows] == list(range(10))
    for row in rows:
        assert row.response == row.target
        assert row.success == (row.comparison > row.standard)
        assert (row.experiment, row.participant, row.session) == ("frequency-RA", "p1", "s1")
        assert (row.unit, row.level, row.date, row.rt) == ("Hz", 1.0, DATE, 0.0)
    first = [words for _, words in sat.told if words.startswith(("trial 1:", "response 1:"))]
    row = rows[0]
    where = {1: "first", 2: "second"}[row.comparison_interval]
    asked, answered = first
    assert all(each in asked for each in ("30 Hz", f"{row.comparison:g} Hz", where))
    assert all(each in answered for each in (row.response, "0.00 s"))


@pytest.mark.parametrize("more", [False, True])
def test_another_experiment_s_answers_are_not_gone_on_with(tmp_path, more):
    """Trials of another standard, or more answers than there are trials."""
    path = tmp_path / "rows.csv"
    respond(path, ["1"], seed=3)
    standards = (30.0, 60.0) if more else (45.0,)
    made = new_experiment(
        "frequency", MOUSE, ExperimentOptions(standards=standards, repetitions=1, seed=3)
    )
    if more:
        # All but the last are taken already.
        for _ in range(19):
            next(made.procedure)
    file = RowFile(path, About("f", "constant", "p", "s", 3))
    with file, raises(ExperimentError, names="trial", value=1):
        TrialSession(made, file, DATE)


def test_a_level_that_rose_is_kept_as_it_was_reached(tmp_path, profile):
    made = new_experiment("discomfort", profile, ExperimentOptions(repetitions=2))
    path = tmp_path / "rows.csv"
    for expected in (1, 2):
        made = new_experiment("discomfort", profile, ExperimentOptions(repetitions=2))
        with RowFile(path, About("d", "limits", "p", "s", 0)) as file:
            session = TrialSession(made, file, DATE)
            assert session.done == expected - 1
            session.record(session.next(), Answer("y", None, 4.0, 1.0, reached=1.5 + expected))
    assert [(row.comparison, row.success) for row in read_rows(path)] == [(2.5, True), (3.5, True)]
    rising = new_experiment("discomfort", profile, ExperimentOptions())
    assert np.isnan(made.task.trial(next(rising.procedure)).condition.comparison)
