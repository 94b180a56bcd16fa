"""The subject's own hand on amplitude, rate, class and site."""

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import ExperimentError
from smarttouch.base.events import Marked, Note
from smarttouch.emulator.emulated_boards import SimulatedDriver
from smarttouch.experiments.free_stimulation import (
    FreeSource,
    raise_to_device_limits,
)
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.running.config import RunConfig
from smarttouch.running.inputs import Controls, ControlState
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.step import Listener

from ..support.checks import raises
from ..support.runs import loop_through
from ..support.scans import board_without_finger


@pytest.fixture(scope="module")
def line():
    return raise_to_device_limits(load_profile("line-8"))


@pytest.fixture
def play(line):
    """Return a runner: keys and levels by the second, to steps, events and the board's report."""

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
    does = {0.5: 0.5, 1: "right", 1.5: "left", 1.6: "left", 2: "]", 2.5: "7"}
    steps, events, _ = play(3, does)
    assert steps[-1].sequence.period_us == 22_222
    assert steps[-1].sequence.site.tolist() == [4]
    assert events[1:] == [
        "RA, site 3, 55 Hz, 1.000 mA", "RA, site 3, 50 Hz, 1.000 mA",
        "RA, site 3, 45 Hz, 1.000 mA", "RA, site 4, 45 Hz, 1.000 mA",
        "mark: 7", "RA, site 4, 45 Hz, 1.000 mA",
    ]  # fmt: skip


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
