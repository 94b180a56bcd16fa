"""Trials have the requested currents; an interrupted session stores each trial once."""

import contextlib
import math
import re
import threading
from itertools import groupby

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ExperimentError
from smarttouch.experiments.experiment_session import open_experiment
from smarttouch.experiments.observers import SimulatedObserver
from smarttouch.experiments.standard_experiments import trials_of
from smarttouch.experiments.trial_source import TrialSource
from smarttouch.experiments.trials import Answer, Setup
from smarttouch.kernels.bank import load_bank
from smarttouch.physiology.finger import Finger
from smarttouch.profile import load_profile
from smarttouch.running.config import RunConfig
from smarttouch.running.display import Display
from smarttouch.running.loop import Controls, ControlState, Mode
from smarttouch.running.runner import Runner
from smarttouch.sources.force import ForceSource

from ..support.checks import raises
from ..support.full import sample
from .simulated import Perfect, Silent, read_rows, sit

FEW = {"repetitions": 1, "standards": "30", "train_s": 0.15}
DETECTION = {"repetitions": 1, "train_s": 0.1}


@pytest.fixture
def take(profile, bank, tmp_path):
    """Return a function that runs an experiment and returns its result and its file's rows."""

    def run_it(observer, options=FEW, name="frequency", **how):
        path = tmp_path / "rows.csv"
        sat = sit(name, Setup(profile, **options), bank, path, observer, **how)
        return sat, read_rows(path)

    return run_it


def is_playing(source, trial, words):
    return re.fullmatch(rf".*, trial {trial}( of \d+)?: {words}", source.title) is not None


def test_trains_have_the_asked_frequency_to_the_microsecond(profile, take):
    """The pulses that the simulated board reports have the frequencies stored in the file."""
    observer = Perfect()
    sat, rows = take(observer, {"repetitions": 1, "standards": "60", "train_s": 0.27})
    assert rows == sat.rows
    assert [row["thisN"] for row in rows] == list(range(10))
    for row, (_, intervals) in zip(rows, observer.felt, strict=True):
        order = (row["comparison"], row["standard"])
        for hz, felt in zip(order if row["comparison_interval"] == 1 else order[::-1], intervals,
                            strict=True):  # fmt: skip
            assert len(felt.time_s) == round(0.27 * hz)
            assert np.diff(felt.time_s) * 1e6 == pytest.approx(round(1e6 / hz), abs=1e-3)
            # Every pulse is the kernel of the middle site at full intensity.
            strongest = np.abs(felt.current_ua).max(axis=1) / 1000
            assert strongest == pytest.approx(profile.full_ma[27], abs=0.005)
            assert felt.width_us == pytest.approx(200)
            assert felt.time_s[0] == 0
        assert row["response"] == row["target"]
        assert row["success"] == (row["comparison"] > row["standard"])
        about = row["experiment"], row["participant"], row["session"], row["procedure"]
        assert about == ("frequency-RA", "p1", "s1", "constant")
        assert (row["unit"], row["level"], row["rt"]) == ("Hz", 1.0, 0.0)
    assert sat.figures["emulator_violations"] == 0
    assert sat.source.notes == []
    assert not [words for words in sat.events("trial") if "again" in words]
    (asked,), (answered,) = sat.events("trial 1:"), sat.events("response 1:")
    where = {1: "first", 2: "second"}[rows[0]["comparison_interval"]]
    assert all(each in asked for each in ("60 Hz", f"{rows[0]['comparison']:g} Hz", where))
    assert all(each in answered for each in (rows[0]["response"], "0.00 s"))


def test_before_a_trial_intensity_is_there_and_between_intervals_silence(profile, take):
    """Before a trial, pulses near threshold complete the ramp: the trial has full intensity."""
    steps = []
    take(
        Perfect(), FEW | {"gap_s": 0.333},
        watch=lambda sent, source, _: steps.append((source.title, sent.step.sequence)),
    )  # fmt: skip
    assert steps[0][1].intensity == 0
    parts = [(title, [each for _, each in of]) for title, of in groupby(steps, lambda one: one[0])]
    opening_ma, ends_ns = [], {}
    for title, sequences in parts:
        if title.endswith(("first", "second")):
            assert {each.intensity for each in sequences if each.slots} == {1.0}
            assert sequences[0].time_ns >= 1e9
            ends_ns[title] = sequences[-1].time_ns + 1000 * sequences[-1].period_us
        else:
            opening_ma += [np.abs(each.current_ua).max(initial=0) / 1000 for each in sequences]
        if title.endswith("second"):
            first_ns = ends_ns[title.replace("second", "first")]
            # During the pause the title still names the first interval.
            assert (sequences[0].time_ns - first_ns) == pytest.approx(0, abs=1000)
    assert 0 < max(opening_ma) <= 1.02 * profile.threshold_ma[27]


@pytest.mark.parametrize("how", sample(["pause", "silence"]))
def test_a_trial_whose_current_was_lost_is_presented_again(take, how):
    done = []

    def watch(sent, source, controls):
        if is_playing(source, 3, "second") and not done:
            done.append(sent)
            controls.toggle_pause() if how == "pause" else controls.silence()
        elif done and "intensity" in source.title and controls.state(0).current_level == 0:
            controls.toggle_pause() if how == "pause" else controls.change_level(1)

    observer = Perfect()
    sat, rows = take(observer, watch=watch, controls=Controls(ControlState(Mode.RA)))
    assert len(rows) == len(observer.felt) == 10
    assert all(row["response"] == row["target"] for row in rows)
    presented = [words.split()[1].rstrip(":") for words in sat.events("trial ")]
    assert presented == ["1", "2", "3", "3", *map(str, range(4, 11))]
    assert sat.events("trial 3 ") == ["trial 3 again: current was lost"]


def test_the_user_sets_the_amplitude_and_rows_have_it(profile, take):
    def watch(_, source, controls):
        if is_playing(source, 5, "first"):
            controls.change_level(-0.01)

    observer = Perfect()
    _, rows = take(observer, watch=watch, controls=Controls(ControlState(Mode.RA)))
    levels = [row["level"] for row in rows]
    assert levels[:4] == [1.0] * 4
    assert levels[4] == levels[-1] < 1
    last = np.abs(observer.felt[-1][1][0].current_ua).max() / 1000
    assert last == pytest.approx(levels[-1] * profile.full_ma[27], abs=0.005)


def test_currents_that_count_wait_for_full_intensity_and_no_key_changes_one(take):
    """At a lower intensity, a detection trial would have less current than its condition states."""
    titles, lowered = [], []

    def watch(sent, source, controls):
        titles.append(source.title)
        if is_playing(source, 4, "feel") and not lowered:
            lowered.append(controls.change_level(-0.05))
        elif "+" in source.title and sent.step.sequence.time_ns > 2e9:
            controls.change_level(0.5)

    observer = Perfect()
    controls = Controls(ControlState(Mode.RA, 0.5))
    sat, rows = take(observer, DETECTION, "detection", watch=watch, controls=controls)
    # While intensity is too low, the title names the key that raises it.
    assert next("+" in title for title in titles if title.count(":"))
    assert sat.events("trial 4 ") == ["trial 4 again: current was lost"]
    assert {row["level"] for row in rows} == {1.0}
    for row, (_, (felt,)) in zip(rows, observer.felt, strict=True):
        strongest_ma = np.abs(felt.current_ua).max(initial=0) / 1000
        # The strongest electrode balances the rounding errors of all 64 electrodes.
        assert strongest_ma == pytest.approx(row["comparison"], abs=0.02)
        assert row["success"] == (row["comparison"] > 0)


def test_a_trial_that_cannot_begin_is_not_waited_for_where_nobody_is(take):
    with raises(ExperimentError, names="trial", value=10):
        take(Perfect(), controls=Controls(ControlState(Mode.RA, 0.0)))


class Moving(ForceSource):
    """Force of a finger that presses harder and softer once a second."""

    def read(self, time_ns):
        return 0.7 + 0.2 * math.sin(2 * math.pi * time_ns / 1e9)


@pytest.mark.long
def test_softness_is_a_rate_that_does_not_follow_the_moving_finger(profile, bank, tmp_path):
    class Noting(SimulatedObserver):
        def respond(self, task, intervals, alternatives):
            rows.append([float(np.ptp(np.diff(each.time_s))) for each in intervals])
            return super().respond(task, intervals, alternatives)

    rows, observer = [], Noting(Finger(profile, 1, "paper"), lapse=0.0)
    setup = Setup(profile, Afferent.SAI, repetitions=1, train_s=0.5)
    sat = sit("softness", setup, bank, tmp_path / "rows.csv", observer, force=Moving("a finger"))
    for row, changes in zip(sat.rows, rows, strict=True):
        at = row["comparison_interval"] - 1
        assert changes[1 - at] > 0.01
        assert (changes[at] < 1e-4) == (row["comparison"] == 1)
        assert row["success"]
    assert sat.figures["emulator_violations"] == 0
    sat = sit("softness", setup, bank, tmp_path / "still.csv", Noting(observer.finger))
    assert max(max(each) for each in rows[len(sat.rows) :]) < 1e-4
    with raises(ExperimentError, names="--mode SAI"):
        next(trials_of("softness", Setup(profile))[1])


@pytest.fixture
def present(profile, bank):
    """Return a function that runs one trial, and calls ``press`` at each step to press keys."""

    def run_it(press, name="frequency", train_s=0.1, url="simulated:", **timing):
        answers, results = [], []
        _, trials = trials_of(name, Setup(profile, train_s=train_s))

        def one():
            answers.append((yield next(trials)))

        source = TrialSource(one(), profile, "try", total=1, **timing)

        def step(result):
            results.append(result)
            assert len(results) < 5000
            press(source, result.input.time_ns)

        Runner(
            source, Display(url, profile), RunConfig(scan="points"), listeners=[step],
            load_kernels=lambda _profile: bank,
        ).run()  # fmt: skip
        (answer,) = answers
        return answer, results

    return run_it


def is_asking(source):
    return "1 or 2" in source.title


def test_keys_before_the_question_do_not_count_nor_those_that_are_no_answer(present):
    early, began_ns = [], []

    def press(source, time_ns):
        if source.title.endswith("second") and not early:
            early.append(source.keys["1"]())
        if is_asking(source):
            assert source.title.endswith("1 or 2")
            began_ns.append(time_ns)
            source.keys["y"]()
            if time_ns >= began_ns[0] + 10**9:
                source.keys["right"]()

    answer, _ = present(press, answer_s=5.0)
    assert answer.response == "2"
    assert answer.rt_s == pytest.approx(1.0, abs=0.05)


def test_reaction_times_are_of_the_key_and_not_of_the_next_frame(present):
    before_ns, asked_ns, pressed_ns = [], [], []

    def key(source):
        pressed_ns.append(source.time_ns())
        source.press("1")
        pressed_ns.append(source.time_ns())

    def press(source, _):
        if asked_ns:
            return
        if not is_asking(source):
            before_ns.append(source.now_ns)
        else:
            asked_ns.append(source.now_ns)
            threading.Timer(0.107, key, [source]).start()

    answer, _ = present(press, url="memory:", answer_s=30.0)
    # The question appeared between the last frame without it and the first frame with it.
    least_ns, most_ns = pressed_ns[0] - asked_ns[0], pressed_ns[1] - before_ns[-1]
    assert least_ns <= round(1e9 * answer.rt_s) <= most_ns
    # The reaction time is not a multiple of the frame period, 20 ms.
    assert answer.rt_s % 0.02 > 1e-6


def test_a_rising_current_ends_with_the_key_and_is_measured_there(profile, present):
    levels = []

    def press(source, _):
        if source.title.endswith("strong enough"):
            levels.append(source.title)
            if len(levels) == 20:
                source.keys["\n"]()

    answer, results = present(press, "discomfort", 2.0)
    level = max(each.tactile.level for each in results if each.tactile.activation.max() == 1)
    assert 0 < level < 1
    assert (answer.response, answer.rt_s, answer.level) == ("y", None, 1.0)
    assert answer.time_s == pytest.approx(results[-1].input.time_ns / 1e9, abs=0.1)
    assert answer.reached == pytest.approx(level * profile.full_ma[27], abs=0.02)


def test_a_current_that_is_never_enough_stops_at_the_ceiling(profile, present, take):
    answer, results = present(lambda *_: None, "discomfort", 1.0)
    full_ma = profile.full_ma[27]
    assert answer.response == "n"
    assert answer.reached == pytest.approx(full_ma, abs=0.005)
    strongest_ma = max(np.abs(each.sequence.current_ua).max(initial=0) for each in results) / 1000
    assert strongest_ma == pytest.approx(full_ma, abs=0.01)
    with raises(ExperimentError, names="simulated"):
        take(Silent(), {"repetitions": 1, "train_s": 1.0}, "discomfort")


def test_a_board_that_cannot_keep_a_frequency_is_noted(changed, profile, tmp_path):
    """The slots of this profile take longer than a period at 200 Hz."""
    slow = changed(profile, {"pulse.discharge_us": 5000})
    setup = Setup(slow, repetitions=1, train_s=0.1, rate_hz=200)
    sat = sit("detection", setup, load_bank(slow), tmp_path / "rows.csv", Silent())
    (note,) = sat.source.notes
    asked_hz, sent_hz = map(float, re.findall(r"([\d.]+) Hz", note))
    assert asked_hz == 200
    assert sent_hz < 200


MOUSE = load_profile("electric-mouse")
SHOWN = "standard", "comparison", "comparison_interval", "thisN", "success"


def shown(rows):
    return [[row[each] for each in SHOWN] for row in rows]


def respond(path, answers, most=1000, name="frequency", **options):
    """Answer up to ``most`` trials from a repeated list. Return whether the session is over."""
    setup = Setup(MOUSE, **{"standards": "30,60", "repetitions": 1, "trials": 8} | options)
    with open_experiment(name, setup, path, "p", "s") as sitting:
        trials = sitting.source()._trials
        with contextlib.suppress(StopIteration):
            trial = next(trials)
            for _ in range(most):
                response = answers[len(sitting.file.rows) % len(answers)]
                right = response == trial.success if response else None
                trial = trials.send(Answer(response, right, 0.3))
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
        # Simulate a kill during a write: the incomplete row is lost, and its trial is repeated.
        lines = parts.read_bytes()
        if lines.count(b"\n") > 1:
            last = lines.rindex(b"\n", 0, -1) + 1
            parts.write_bytes(lines[: last + min(cut, len(lines) - last - 1)])
    assert respond(parts, answers, procedure=procedure)
    assert shown(read_rows(parts)) == shown(read_rows(whole))


@pytest.mark.parametrize("other", [{"standards": "45"}, {"standards": "30", "trials": 4}])
def test_another_experiment_s_answers_are_not_gone_on_with(tmp_path, other):
    """A file is refused if its standard stimulus differs, or if it has too many answers."""
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
    assert after[1].startswith("strong enough at 3.000 mA")
