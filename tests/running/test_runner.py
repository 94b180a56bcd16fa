"""The runner: one run put together, and its end at zero whatever happens."""

import threading

import numpy as np
import pytest
from PIL import Image

import smarttouch
from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import (
    BoardClosedError,
    BoardError,
    BoardStoppedError,
    ProfileError,
    SmartTouchError,
)
from smarttouch.base.events import Advice, IntensityChanged, ModeChanged, RunEnded
from smarttouch.kernels.bank import load_bank
from smarttouch.running.config import RunConfig
from smarttouch.running.display import open_display
from smarttouch.running.runner import Runner
from smarttouch.running.step import Listener
from smarttouch.sources import open_source
from smarttouch.sources.force import open_force
from smarttouch.sources.source_contract import Stimulus, StimulusSource
from smarttouch.views.outputs import DeliveredPicture

from ..raising import raises


@pytest.fixture
def display(profile):
    with open_display("simulated:", profile) as display:
        yield display


@pytest.fixture
def source(profile):
    return open_source("text:on", profile, speed_mm_s=400)


class Noting(Listener):
    """Notes in which order it is called, and what it is given."""

    def __init__(self):
        super().__init__()
        self.calls, self.events, self.results, self.context = [], [], [], None

    def prepare(self, run):
        self.calls.append("prepare")
        self.context = run
        assert "closed" in repr(run.board)

    def start(self, run):
        self.calls.append("start")
        assert "open" in repr(run.board)

    def step(self, result):
        self.calls += ["step"] if "step" not in self.calls else []
        self.results.append(result)

    def event(self, event):
        self.events.append(event)

    def finish(self, run):
        self.calls.append("finish")
        assert "closed" in repr(run.board)

    def close(self):
        self.calls.append("close")


def test_a_run_from_its_source_to_its_statistics(source, display, bank):
    noting = Noting()
    statistics = Runner(
        source, display, RunConfig(seed=3), listeners=[noting], load_kernels=lambda _: bank
    ).run()
    assert noting.calls == ["prepare", "start", "step", "finish", "close"]
    assert statistics.frames == len(noting.results) > 10
    assert statistics.ended == source.ended
    assert statistics.figures["emulator_violations"] == 0
    assert statistics.figures["frames_in"] == statistics.seen
    assert statistics.figures["slots"] == sum(each.sequence.slots for each in noting.results) > 0
    assert noting.context.settings["seed"] == 3
    assert noting.context.settings["sensor"] == source.url == "text:on"
    assert noting.context.bank is bank
    kinds = [type(event) for event in noting.events]
    assert kinds[:2] == [IntensityChanged, ModeChanged]
    assert RunEnded in kinds


def test_a_stimulus_source_chooses_the_classes(profile, display):
    class Taps(StimulusSource):
        knows_force = True

        def read(self, time_ns):
            if time_ns > 0.3e9:
                return None
            activation = np.zeros((3, 64), np.float32)
            activation[Afferent.RA, 27] = 1
            return Stimulus(activation, time_ns, profile.force.full_n, 25_000, 0.5)

    noting = Noting()
    Runner(Taps("taps"), display, RunConfig(), listeners=[noting]).run()
    controls = noting.context.controls
    controls.next_mode()
    assert controls.state(0).mode is Mode.RA
    assert {each.sequence.period_us for each in noting.results} == {25_000}
    assert noting.results[-1].input is noting.results[-1].tactile


@pytest.mark.parametrize("stage", ["prepare", "start", "step", "event", "finish", "close"])
def test_an_exception_in_a_listener_ends_at_zero(source, display, stage, monkeypatch):
    class BrokenError(Exception):
        pass

    def broken(*_):
        raise BrokenError

    noting, other = Noting(), Noting()
    monkeypatch.setattr(noting, stage, broken)
    with pytest.raises(BrokenError):
        Runner(source, display, RunConfig(), listeners=[noting, other]).run()
    assert other.calls[-1] == "close"
    with raises(BoardClosedError, names="board"):
        display.board.send(None)


def test_a_stop_from_another_thread_ends_it_at_zero(profile):
    source, stopped = open_source("text:a long line of words", profile), []
    with open_display("simulated:", profile) as display:

        def stop(result):
            if result.number == 20:
                thread = threading.Thread(target=display.stop)
                thread.start()
                thread.join()
                stopped.append(result.number)

        statistics = Runner(source, display, RunConfig(), listeners=[stop]).run()
        assert stopped == [20]
        assert statistics.frames == 20
        with pytest.raises(BoardStoppedError):
            display.board.open()


def test_on_a_finger_an_intensity_is_required(profile, source):
    display = open_display("link:/dev/nowhere", profile)
    with raises(SmartTouchError, names="intensity"):
        Runner(source, display, RunConfig()).run()
    # Then it is the port that is missing.
    with raises(BoardError, names="port"):
        Runner(source, display, RunConfig(intensity=0.3)).run()


def test_a_simulated_calibration_is_no_finger_s(profile, source, monkeypatch):
    from smarttouch.profile.device import Calibrated

    note = Calibrated.model_construct(found="simulated: yes or no")
    monkeypatch.setitem(profile.calibrated, "thresholds", note)
    notes = []
    for on_a_finger in (False, True):
        with open_display("simulated:", profile) as display:
            monkeypatch.setattr(type(display), "on_a_finger", on_a_finger)
            noting = Noting()
            Runner(
                open_source("text:a", profile, speed_mm_s=400), display, RunConfig(intensity=0.5),
                force=open_force("fixed:0.9", profile), listeners=[noting],
            ).run()  # fmt: skip
            notes.append([each for each in noting.events if isinstance(each, Advice)])
    assert not any("thresholds" in str(each) for each in notes[0])
    assert any("thresholds" in str(each) for each in notes[1])


@pytest.mark.parametrize(("seconds", "inked", "advised", "noted"), [
    (1, False, 0, 1), (6, False, 1, 0), (6, True, 0, 0),
])  # fmt: skip
def test_no_ink_is_said_once(display, seconds, inked, advised, noted):
    images = np.full((400, 64, 64), 230, np.uint8)
    images[0, 10:50, 30:34] = 20 if inked else 230
    noting = Noting()
    statistics = smarttouch.run(images, display, seconds=seconds, listeners=[noting])
    advice = [str(each) for each in noting.events if isinstance(each, Advice)]
    assert sum("no ink" in words for words in advice) == advised
    assert sum("no ink" in words for words in statistics.notes) == noted


def test_each_run_on_a_display_has_its_own_notes(profile, bank, display):
    told = []
    for words in ("first", "second"):
        display.board.notes.append(words)
        source, noting = open_source("text:a", profile, speed_mm_s=400), Noting()
        run = Runner(source, display, RunConfig(), listeners=[noting], load_kernels=lambda _: bank)
        told.append(run.run().notes)
        assert str(noting.events).count(words) == 1
    assert [told[0].count("first"), told[0].count("second")] == [1, 0]
    assert [told[1].count("first"), told[1].count("second")] == [0, 1]


def test_a_picture_of_what_was_felt_needs_every_pulse(profile, source, tmp_path):
    display = open_display("memory:", profile)
    with raises(SmartTouchError):
        Runner(source, display, RunConfig(), listeners=[DeliveredPicture(tmp_path / "a.png")]).run()


def test_where_no_finger_can_be_made_what_was_delivered_is_drawn(profile, tmp_path, changed):
    # No driving function was fitted to so short a pulse.
    short, shapes = changed(profile, {"pulse.width_us": 40}), []
    for each in (profile, short):
        display = open_display("simulated:", profile)
        picture = DeliveredPicture(tmp_path / "a.png", anatomy="paper")
        display.profile = each
        source = open_source("text:a", profile)
        statistics = Runner(
            source, display, RunConfig(seconds=0.2), listeners=[picture],
            load_kernels=lambda _: load_bank(profile),
        ).run()  # fmt: skip
        with Image.open(tmp_path / "a.png") as drawn:
            shapes.append(len(drawn.getbands()))
        assert len(picture.notes) == (each is short)
        assert picture.notes == statistics.notes[len(statistics.notes) - len(picture.notes) :]
    assert shapes == [3, 1]


@pytest.mark.parametrize(("name", "anatomy", "wrong"), [
    ("a.png", "none", raises(ProfileError, key="anatomy", value="none")),
    ("a.gif", "paper", raises(SmartTouchError, value="a.gif")),
])  # fmt: skip
def test_an_impossible_picture_is_refused_before_the_board(
    profile, source, tmp_path, name, anatomy, wrong
):
    display = open_display("simulated:", profile)
    picture = DeliveredPicture(tmp_path / name, 1, anatomy)
    with wrong:
        Runner(source, display, RunConfig(), listeners=[picture]).run()
    assert not picture.path.exists()
