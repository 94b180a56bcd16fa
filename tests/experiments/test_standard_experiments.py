"""Trials have the stimuli that their conditions state; free stimulation obeys the keys."""

import math
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import ExperimentError
from smarttouch.base.events import Marked, Note
from smarttouch.emulator.drivers import SimulatedDriver
from smarttouch.experiments.free_stimulation import (
    FreeSource,
    raise_to_device_limits,
)
from smarttouch.experiments.standard_experiments import CATALOG, trials_of
from smarttouch.experiments.trials import Answer, Setup
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.running.config import RunConfig
from smarttouch.running.loop import Controls, ControlState
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.step_records import Listener

from ..support.checks import raises
from ..support.runs import loop_through
from ..support.scans import board_without_finger
from .simulated import ask_all, sit

EXAMPLE = Path(__file__).parents[2] / "examples/own_experiment.py"
MOUSE = load_profile("electric-mouse")


def begun(name, profile=MOUSE, afferent=Afferent.RA, **options):
    """Return the setup of an experiment and all its trials, each answered correctly."""
    setup, trials = trials_of(name, Setup(profile, afferent, **options))
    return setup, ask_all(trials, lambda trial: Answer(trial.success, True))


def sites(train, afferent=Afferent.RA):
    return np.flatnonzero(train.activation[afferent]).tolist()


def test_the_paper_s_frequencies():
    setup, trials = begun("frequency")
    assert len(trials) == setup.total == 500
    assert {each.condition.standard for each in trials} == {15, 30, 45, 60, 75}
    ratios = {round(each.condition.comparison / each.condition.standard, 2) for each in trials}
    assert (min(ratios), max(ratios)) == (0.5, 2.0)
    assert setup.notes == []
    for trial in trials[:40]:
        condition, comparison = (
            trial.condition,
            trial.intervals[trial.condition.comparison_interval - 1],
        )
        assert comparison.rate_hz == pytest.approx(condition.comparison, rel=1e-4)
        assert comparison.pulses == round(condition.comparison)
        faster = 1 + int(np.argmax([each.rate_hz for each in trial.intervals]))
        assert trial.target == str(faster)
        assert trial.success == str(condition.comparison_interval)
        assert {tuple(sites(each)) for each in trial.intervals} == {(27,)}
        assert f"standard {condition.standard:g} Hz, comparison" in trial.words


def test_comparisons_above_the_limit_are_left_out_with_a_note(changed):
    setup, trials = begun("frequency", afferent=Afferent.PC)
    standards = {each.condition.standard for each in trials}
    assert standards == {15, 30, 45, 60, 75, 90, 100}
    assert max(each.condition.comparison for each in trials) <= 200
    assert sites(trials[0].intervals[0], Afferent.PC) == [27]
    assert "PC kernel" in setup.notes[0]
    slow = changed(MOUSE, {"limits.rate_hz": 100.0})
    setup, trials = begun("frequency", slow, repetitions=1, standards="75")
    (note,) = setup.notes
    assert "3 " in note
    assert "100 Hz" in note
    assert max(each.condition.comparison for each in trials) <= 100


@pytest.mark.parametrize("procedure", ["staircase", "questplus"])
def test_adaptive_frequencies_are_above_their_standards_and_mixed(procedure):
    _, trials = begun("frequency", procedure=procedure, standards="30,75", trials=8)
    shown = [each.condition for each in trials]
    assert Counter(each.standard for each in shown) == {30: 8, 75: 8}
    assert all(1 < each.comparison / each.standard <= 2 for each in shown)
    order = [each.standard for each in shown]
    assert order != sorted(order)


def test_detection_has_blanks_and_counts_in_milliamperes():
    _, trials = begun("detection", site=9, train_s=0.5)
    assert sum(each.condition.comparison == 0 for each in trials) == 10
    for trial in trials:
        (train,), current_ma = trial.intervals, trial.condition.comparison
        assert (sites(train), trial.success, trial.exact) == ([9], "y", True)
        assert train.is_blank == (current_ma == 0)
        assert trial.target == ("y" if current_ma else "n")
        if current_ma:
            assert train.level * MOUSE.full_ma[9] == pytest.approx(current_ma)


@pytest.mark.parametrize("procedure", ["constant", "staircase", "questplus"])
def test_no_level_is_above_the_strongest(changed, procedure):
    tight = changed(MOUSE, {"perception.comfort_ratio": 1.05})
    for trial in begun("detection", tight, procedure=procedure, trials=20)[1]:
        assert trial.condition.comparison <= tight.full_ma.max() + 1e-6
        assert all(train.level <= 1 for train in trial.intervals)


def test_discomfort_rises_evenly_to_the_profile_s_own_ceiling_and_begins_again():
    _, (trial, *others) = begun("discomfort", repetitions=3)
    assert len(others) == 2
    assert math.isnan(trial.condition.comparison)
    course = trial.course
    steps = [next(course), course.send(False), course.send(None)]
    assert steps == pytest.approx([MOUSE.full_ma[27] * each / 200 for each in (1, 2, 1)])
    steps += [course.send(False) for _ in range(199)]
    assert steps[-1] == pytest.approx(MOUSE.full_ma[27])
    with pytest.raises(StopIteration) as end:
        course.send(False)
    assert end.value.value == "n"
    next(others[0].course)
    with pytest.raises(StopIteration) as end:
        others[0].course.send(True)
    assert end.value.value == "y"


def test_the_second_point_is_as_far_right_as_stated():
    _, trials = begun("localization")
    assert {each.condition.comparison for each in trials} == {-6, -4, -2, 2, 4, 6}
    for trial in trials:
        right_mm = trial.condition.comparison
        (first,), (second,) = map(sites, trial.intervals)
        moved_mm = MOUSE.electrodes.position_mm[second] - MOUSE.electrodes.position_mm[first]
        assert moved_mm == pytest.approx((right_mm, 0))
        assert (trial.target, trial.success) == ("r" if right_mm > 0 else "l", "r")


@pytest.mark.parametrize(("name", "options", "value", "allowed"), [
    ("hearing", {}, "hearing", tuple(CATALOG)),
    ("gap.py", {}, "gap.py", None),
    ("localization", {"procedure": "staircase"}, "staircase", ("constant",)),
    ("frequency", {"site": 64}, 64, None),
    ("frequency", {"standards": "300"}, None, 200),
    ("frequency", {"standards": "30,x"}, "30,x", None),
    ("frequency", {"standards": "200", "procedure": "staircase"}, 200, 200),
    ("frequency", {"train_s": 0.0}, 0, (0, 60)),
    ("frequency", {"train_s": math.nan}, None, (0, 60)),
    ("frequency", {"train_s": 0.05}, 1, 2),
    ("frequency", {"repetitions": 0}, 0, 1),
    ("frequency", {"gap_s": -1.0}, -1, (0, 60)),
    ("frequency", {"answer_s": 1e9}, 1e9, 3600),
    ("detection", {"rate_hz": 201.0}, 201, (0, 200)),
    ("localization", {"site": 0}, 0, None),
    ("discomfort", {"train_s": 0.9}, 0.9, 1),
])  # fmt: skip
def test_what_cannot_be_asked_for(name, options, value, allowed):
    with raises(ExperimentError, value=value, allowed=allowed):
        begun(name, **options)


def test_sites_are_whole_numbers_and_activations_are_not(changed):
    setup = Setup(MOUSE)
    on = np.zeros(64, bool)
    on[[3, 5]] = True
    for where in ([3, 5], np.array([3, 5]), on, on.astype(np.float32)):
        assert sites(setup.train(where, 50)) == [3, 5]
    with raises(ExperimentError, value="(6,)"):
        setup.train(np.zeros(6), 50)
    assert np.hypot(*MOUSE.electrodes.position_mm[setup.place]) < 1.5
    without = Setup(changed(MOUSE, {"output.masked": (setup.place,)}))
    assert np.hypot(*MOUSE.electrodes.position_mm[without.place]) < 1.5
    assert without.place != setup.place


class Counts:
    """Observer that names the interval with fewer pulses, because a gap removes pulses."""

    def respond(self, task, intervals, alternatives):
        return alternatives[int(np.argmin([len(each.time_s) for each in intervals]))]


def test_a_file_is_an_experiment(tmp_path, bank):
    setup = Setup(MOUSE, repetitions=1, seed=4)
    sat = sit(str(EXAMPLE), setup, bank, tmp_path / "rows.csv", Counts())
    rows = [(row["unit"], row["comparison"], row["success"]) for row in sat.rows]
    assert sorted(rows) == [("mm", gap_mm, True) for gap_mm in (2, 6, 10)]
    assert sat.figures["emulator_violations"] == 0


FILE = """
from smarttouch.lab import Experiment, Trial
def mine(setup):
    {trials}
{experiment}
"""
GOOD = {"trials": "yield None", "experiment": "mine = Experiment('what is it', mine)"}


@pytest.mark.parametrize(("changes", "words"), [
    ({"experiment": ""}, ["no Experiment"]),
    ({"experiment": "a, b = (Experiment('what', mine) for _ in 'ab')"}, ["2 Experiments"]),
    ({"experiment": "1 / 0"}, ["line 5", "ZeroDivisionError"]),
    ({"experiment": "1 +"}, ["line 5", "SyntaxError"]),
    ({"trials": "return [1]"}, ["list", "generator"]),
    ({"trials": "1 / 0; yield"}, ["line 4", "ZeroDivisionError"]),
    ({"trials": "yield from setup.constant([])"}, ["0 conditions"]),
    ({}, ["NoneType", "Trial"]),
    ({"trials": "yield setup.gap"}, ["line 4", "AttributeError", "gap"]),
])  # fmt: skip
def test_what_is_wrong_in_it_is_one_sentence(tmp_path, changes, words):
    path = tmp_path / "mine.py"
    path.write_text(FILE.format(**GOOD | changes), encoding="utf-8")
    with pytest.raises(ExperimentError) as error:
        begun(str(path))
    assert all(each in str(error.value) for each in words)
    assert "\n" not in str(error.value)


@pytest.fixture(scope="module")
def line():
    return raise_to_device_limits(load_profile("line-8"))


@pytest.fixture
def play(line):
    """Return a function that runs free stimulation. ``does`` maps times, s, to keys or levels."""

    def run_it(seconds, does):
        steps, events, waiting = [], [], sorted(does.items())
        source = FreeSource(line, list(Afferent), 3, 50.0, 1.0)
        controls = Controls(ControlState(Mode.COLOR, 0.0))

        class Hand(Listener):
            def step(self, sent):
                steps.append(sent.step)
                while waiting and sent.step.input.time_ns >= waiting[0][0] * 1e9:
                    _, act = waiting.pop(0)
                    if isinstance(act, str):
                        source.keys[act]()
                    else:
                        controls.change_level(act)

            def event(self, event):
                if isinstance(event, Note | Marked):
                    events.append(str(event))

        with board_without_finger(line, SimulatedDriver) as board:
            pipeline = Pipeline(line, load_bank(line), RunConfig(mode=Mode.COLOR, scan="points"))
            loop_through(source, pipeline, board, Hand(), seconds=seconds, controls=controls)
            return steps, events, board.report()

    return run_it


def test_the_strongest_current_is_the_limit_of_the_device(line, profile, changed):
    assert line.full_ma == pytest.approx(2.0)
    assert line.threshold_ma == pytest.approx(0.4)
    tight = changed(profile, {"limits.charge_uc": 0.49})
    assert raise_to_device_limits(tight).full_ma == pytest.approx(2.45 - 0.032)
    single = changed(profile, {"limits.electrode_ma": (2.4,) * 63 + (2.45,)})
    assert raise_to_device_limits(single).full_ma[[0, -1]] == pytest.approx([2.4, 2.45])


def test_the_amplitude_follows_the_hand_in_milliamperes(play):
    steps, events, report = play(4, {1: 0.5, 2: 0.5})
    strongest = {
        time_s: max(
            np.abs(step.sequence.current_ua).max(initial=0) / 1000
            for step in steps if time_s - 0.1 < step.input.time_ns / 1e9 <= time_s
        )
        for time_s in (0.9, 1.9, 3.9)
    }  # fmt: skip
    assert strongest == pytest.approx({0.9: 0.0, 1.9: 1.0, 3.9: 2.0}, abs=0.005)
    assert events == ["RA, site 3, 50 Hz, 1.000 mA", "RA, site 3, 50 Hz, 2.000 mA"]
    assert report.violations == 0
    assert report.max_current_ma <= 2.0


def test_a_class_begins_at_zero(play):
    steps, events, report = play(4, {1: 0.5, 2: "m"})
    classes = [np.flatnonzero(step.input.activation.any(axis=1)).item() for step in steps]
    turn = classes.index(int(Afferent.SAI))
    assert steps[turn].sequence.slots == 0
    assert steps[turn].sequence.intensity == 0
    assert steps[turn + 1].sequence.intensity <= 0.05
    assert steps[-1].sequence.intensity == 0.5
    kernels = load_bank(load_profile("line-8")).kernels(Afferent.SAI)
    assert steps[-1].sequence.current_ua[0] == pytest.approx(1000 * kernels[3], abs=5)
    assert events[-1] == "SAI, site 3, 50 Hz, 1.000 mA"
    assert report.violations == 0


def test_keys_turn_rate_and_site_and_mark(play):
    steps, events, _ = play(3, {0.5: 0.5, 1: "right", 1.5: "left", 1.6: "left", 2: "]", 2.5: "7"})
    assert steps[-1].sequence.period_us == 22_222
    assert steps[-1].sequence.site.tolist() == [4]
    assert "mark: 7" in events
    assert events[-1] == "RA, site 4, 45 Hz, 1.000 mA"


def test_rates_stay_within_the_paper_s_range(line):
    source = FreeSource(line, list(Afferent), 3, 195.0, 1.0)
    for _ in range(3):
        source.keys["right"]()
    assert source.read(0).period_us == 5000
    for _ in range(60):
        source.keys["left"]()
    assert source.read(1).period_us == 100_000


@pytest.mark.parametrize(("site", "rate_hz", "value"), [(3, 5.0, (5, 10, 200)), (8, 50.0, 8)])
def test_impossible_rates_and_sites_are_refused(line, site, rate_hz, value):
    with raises(ExperimentError, value=value):
        FreeSource(line, list(Afferent), site, rate_hz, 1.0)
