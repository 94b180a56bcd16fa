"""Trials reach the skin as they are asked for, or are presented again."""

import re
import threading
import time

import numpy as np
import pytest

from smarttouch.base.afferent import Mode
from smarttouch.base.errors import ExperimentError
from smarttouch.experiments.psychophysics.catalog import ExperimentOptions, new_experiment
from smarttouch.experiments.psychophysics.experiment_source import AGAIN, ExperimentSource
from smarttouch.experiments.psychophysics.observers import BlindObserver
from smarttouch.experiments.psychophysics.trial_rows import read_rows
from smarttouch.experiments.psychophysics.trials import TrialTiming
from smarttouch.kernels.bank import load_bank
from smarttouch.running.config import RunConfig
from smarttouch.running.display import Display
from smarttouch.running.inputs import Controls, ControlState
from smarttouch.running.runner import Runner

from ...raising import raises
from .sitting import Perfect, sit

FEW = ExperimentOptions(repetitions=1, standards=(30.0,), train_s=0.15)
DETECTION = ExperimentOptions(repetitions=1, train_s=0.1)


@pytest.fixture
def take(profile, bank, tmp_path):
    """Return a runner of an experiment, to what came of it and its rows."""

    def run_it(observer, wanted=FEW, name="frequency", **how):
        path = tmp_path / "rows.csv"
        sat = sit(new_experiment(name, profile, wanted), profile, bank, path, observer, **how)
        return sat, read_rows(path)

    return run_it


def test_trains_have_the_asked_frequency_to_the_microsecond(profile, take):
    """Ten comparisons with a standard; times and pulses by the board's account."""
    observer = Perfect()
    wanted = ExperimentOptions(repetitions=1, standards=(60.0,), train_s=0.27)
    sat, rows = take(observer, wanted)
    assert len(rows) == len(observer.felt) == 10
    for row, (_, intervals) in zip(rows, observer.felt, strict=True):
        order = (row.comparison, row.standard)
        for hz, felt in zip(order if row.comparison_interval == 1 else order[::-1], intervals,
                            strict=True):  # fmt: skip
            assert len(felt.time_s) == round(0.27 * hz)
            assert np.diff(felt.time_s) * 1e6 == pytest.approx(round(1e6 / hz), abs=1e-3)
            # The kernel of the middle, at full strength in every pulse.
            strongest = np.abs(felt.current_ua).max(axis=1) / 1000
            assert strongest == pytest.approx(profile.full_ma[27], abs=0.005)
            assert felt.width_us == pytest.approx(200)
            assert felt.time_s[0] == 0
    assert sat.figures["emulator_violations"] == 0
    assert sat.source.notes == []
    assert sat.source.spoiled == 0


def test_between_the_intervals_there_is_silence_as_long_as_asked(take):
    steps = []
    take(
        Perfect(),
        course=TrialTiming(gap_s=0.333),
        watch=lambda sent, source, _: steps.append((source.playing, sent.step.sequence)),
    )
    at = {}
    for playing, sequence in steps:
        if playing is not None:
            at.setdefault(playing, []).append(sequence)
        else:
            # The level is opened once, by pulses of threshold.
            assert sequence.slots == 0 or not at
    for presentation in range(1, 11):
        first, second = at[presentation, 0], at[presentation, 1]
        over_ns = first[-1].time_ns + 1000 * first[-1].period_us
        assert (second[0].time_ns - over_ns) / 1e9 == pytest.approx(0.333, abs=1e-6)


def test_before_a_trial_intensity_is_there(profile, take):
    """The level is opened by pulses of threshold; those of trials come at full intensity."""
    steps, of_trials = [], []
    take(
        Perfect(),
        watch=lambda sent, source, _: (
            steps.append(sent.step.sequence),
            of_trials.append(source.playing is not None),
        ),
    )
    assert steps[0].intensity == 0
    felt = [each for each, playing in zip(steps, of_trials, strict=True) if playing and each.slots]
    assert felt[0].time_ns >= 1e9
    assert {each.intensity for each in felt} == {1.0}
    opening = [each for each, playing in zip(steps, of_trials, strict=True) if not playing]
    strongest_ma = max(np.abs(each.current_ua).max(initial=0) for each in opening) / 1000
    assert 0 < strongest_ma <= 1.02 * profile.threshold_ma[27]


@pytest.mark.parametrize("how", ["pause", "silence"])
def test_a_trial_whose_current_was_lost_is_presented_again(take, how):
    done = []

    def watch(sent, source, controls):
        if source.playing == (3, 1) and not done:
            done.append(sent)
            controls.toggle_pause() if how == "pause" else controls.silence()
        elif done and source.playing is None and controls.state(0).current_level == 0:
            controls.toggle_pause() if how == "pause" else controls.change_level(1)

    observer = Perfect()
    sat, rows = take(observer, watch=watch, controls=Controls(ControlState(Mode.RA)))
    assert sat.source.spoiled == 1
    assert len(rows) == len(observer.felt) == 10
    assert all(row.response == row.target for row in rows)
    presented = [words for _, words in sat.told if words.startswith("trial ")]
    assert [words.split()[1].rstrip(":") for words in presented] == [
        "1", "2", "3", "3", *map(str, range(4, 11))
    ]  # fmt: skip


def test_the_user_sets_the_amplitude_and_rows_have_it(profile, take):
    def watch(_, source, controls):
        if source.playing == (5, 0):
            controls.change_level(-0.01)

    observer = Perfect()
    _, rows = take(observer, watch=watch, controls=Controls(ControlState(Mode.RA)))
    levels = [row.level for row in rows]
    assert levels[:4] == [1.0] * 4
    assert levels[4] == levels[-1] < 1
    last = np.abs(observer.felt[-1][1][0].current_ua).max() / 1000
    assert last == pytest.approx(levels[-1] * profile.full_ma[27], abs=0.005)


def test_currents_that_count_wait_for_full_intensity(profile, take):
    """Detection at half the user's own level would be another current."""
    titles = []

    def watch(sent, source, controls):
        titles.append(source.title)
        if sent.step.sequence.time_ns > 2e9 and controls.state(0).level < 1:
            assert not any(before)
            controls.change_level(0.5)
        before.append(source.playing is not None)

    before = []
    observer = Perfect()
    controls = Controls(ControlState(Mode.RA, 0.5))
    _, rows = take(observer, DETECTION, "detection", watch=watch, controls=controls)
    # The key that raises intensity is shown as long as it is missing.
    assert any("+" in title for title in titles)
    assert "+" not in titles[-1]
    for row, (_, (felt,)) in zip(rows, observer.felt, strict=True):
        strongest_ma = np.abs(felt.current_ua).max(initial=0) / 1000
        # Whole microamperes of 64 electrodes are balanced by the strongest.
        assert strongest_ma == pytest.approx(row.comparison, abs=0.02)
        assert row.success == (row.comparison > 0)


def test_where_currents_count_no_key_changes_one_unnoticed(take):
    def watch(_, source, controls):
        if source.playing == (4, 0):
            controls.change_level(-0.05)
        elif source.playing is None and source.spoiled:
            controls.change_level(1)

    controls = Controls(ControlState(Mode.RA))
    sat, rows = take(Perfect(), DETECTION, "detection", watch=watch, controls=controls)
    assert sat.source.spoiled == 1
    assert {row.level for row in rows} == {1.0}


def test_a_trial_that_cannot_begin_is_not_waited_for_where_nobody_is(take):
    with raises(ExperimentError, names="trial", value=3):
        take(
            Perfect(),
            controls=Controls(ControlState(Mode.RA, 0.0)),
            course=TrialTiming(patience_s=3),
        )


def test_nobody_answers(take):
    """Every trial comes again once, at the end."""
    sat, rows = take(BlindObserver("silent"), course=TrialTiming(answer_s=0.2))
    assert len(rows) == 20
    assert {(row.response, row.success, row.rt) for row in rows} == {("", None, None)}
    assert [words for _, words in sat.told if words.startswith("response 2:")] == [
        "response 2: none"
    ]


class OneTrial:
    """A frequency trial, and its answers; on a run without board and loop."""

    title, done, total = "try", 0, 1

    def __init__(self, profile, name="frequency", train_s=0.1):
        made = new_experiment(name, profile, ExperimentOptions(train_s=train_s))
        self.trial = made.task.trial(next(made.procedure))
        self.answers = []

    def next(self):
        return None if self.answers else self.trial

    def record(self, trial, answer):
        self.answers.append(answer)


@pytest.fixture
def present(profile, bank):
    """Return a function that runs one trial, whose keys another presses at each step."""

    def run_it(press, name="frequency", train_s=0.1, url="simulated:", **timing):
        trials, results = OneTrial(profile, name, train_s), []
        source = ExperimentSource(trials, profile, TrialTiming(**timing))

        def step(result):
            results.append(result)
            assert len(results) < 5000
            press(source, result.input.time_ns)

        Runner(
            source, Display(url, profile), RunConfig(scan="points"), listeners=[step],
            load_kernels=lambda _profile: bank,
        ).run()  # fmt: skip
        (answer,) = trials.answers
        return answer, source, results

    return run_it


def test_keys_before_the_question_do_not_count(present):
    early, began_ns = [], []

    def press(source, time_ns):
        if source.playing == (1, 1) and not early:
            early.append(source.keys["1"]())
        if source.asking:
            assert f"{source.asking.question}, {AGAIN} " in source.title
            began_ns.append(time_ns)
            source.keys["y"]()
            if time_ns >= began_ns[0] + 10**9:
                source.keys["right"]()

    answer, _, _ = present(press, answer_s=5.0)
    assert answer.response == "2"
    assert answer.rt_s == pytest.approx(1.0, abs=0.05)


def test_a_trial_is_felt_again_on_request(present):
    def press(source, _):
        if source.asking:
            source.keys["r" if source.repeats == 0 else "1"]()

    answer, source, results = present(press, answer_s=5.0)
    assert (source.repeats, answer.response) == (1, "1")
    numbers = [each.input.number for each in results if each.tactile.activation.max() == 1]
    # Two intervals twice, each pattern with a number of its own and as many pulses.
    counts = [numbers.count(each) for each in dict.fromkeys(numbers)]
    assert len(counts) == 4
    assert counts[:2] == counts[2:]
    assert numbers == sorted(numbers)
    assert {each.input.image for each in results} == {None}


def test_an_experiment_may_forbid_repeating_a_trial(present):
    asked = []

    def press(source, _):
        if source.asking:
            assert source.title.endswith(source.asking.question)
            asked.append(source.asking)
            source.keys["r" if len(asked) < 20 else "1"]()

    answer, source, _ = present(press, again=False)
    assert (source.repeats, answer.response) == (0, "1")
    assert len(set(map(id, asked))) == 1


def test_reaction_times_are_of_the_key_and_not_of_the_next_frame(present):
    asked_s, pressed_s = [], []

    def key(source):
        pressed_s.append(time.monotonic())
        source.press("1")

    def press(source, _):
        if source.asking and not asked_s:
            asked_s.append(time.monotonic())
            threading.Timer(0.107, key, [source]).start()

    answer, _, _ = present(press, url="memory:", answer_s=5.0)
    assert answer.rt_s == pytest.approx(pressed_s[0] - asked_s[0], abs=0.05)
    # Frames are 20 ms apart.
    assert answer.rt_s % 0.02 > 1e-6


def test_a_rising_current_ends_with_the_key_and_is_measured_there(profile, present):
    levels = []

    def press(source, _):
        if source.playing:
            levels.append(source.playing)
            if len(levels) == 20:
                source.keys["\n"]()

    answer, _, results = present(press, "discomfort", 2.0)
    level = max(each.tactile.level for each in results if each.tactile.activation.max() == 1)
    assert 0 < level < 1
    assert (answer.response, answer.rt_s, answer.level) == ("y", None, 1.0)
    assert answer.time_s == pytest.approx(results[-1].input.time_ns / 1e9, abs=0.1)
    assert answer.reached == pytest.approx(level * profile.full_ma[27], abs=0.02)


def test_a_current_that_is_never_enough_stops_at_the_ceiling(profile, take):
    wanted = ExperimentOptions(repetitions=2, train_s=1.0)
    sat, rows = take(BlindObserver("silent"), wanted, "discomfort", experiment="d")
    full_ma = profile.full_ma[27]
    assert [row.response for row in rows] == ["n", "n"]
    assert [row.comparison for row in rows] == pytest.approx([full_ma] * 2, abs=0.005)
    assert sat.figures["max_current_ma"] == pytest.approx(full_ma, abs=0.01)


@pytest.mark.parametrize(
    "arguments", [{"gap_s": -1}, {"gap_s": float("nan")}, {"answer_s": 0}, {"answer_s": 1e9}]
)
def test_courses_that_cannot_be(arguments):
    ((name, value),) = arguments.items()
    value = pytest.approx(value, nan_ok=True)
    with raises(ExperimentError, names=name, value=value):
        TrialTiming(**arguments)


def test_a_board_that_cannot_keep_a_frequency_is_noted(profile, changed, tmp_path):
    """A profile whose slots take longer than the period asked for."""
    slow = changed(profile, {"pulse.discharge_us": 5000})
    made = new_experiment(
        "localization", slow, ExperimentOptions(repetitions=1, train_s=0.1, rate_hz=200)
    )
    sat = sit(made, slow, load_bank(slow), tmp_path / "rows.csv", Perfect(), experiment="l",
              course=TrialTiming(answer_s=0.1))  # fmt: skip
    (note,) = sat.source.notes
    asked_hz, sent_hz = map(float, re.findall(r"([\d.]+) Hz", note))
    assert asked_hz == 200
    assert sent_hz < 200
