"""Tests of complete runs: listeners, end at zero after any failure, and paced simulated time."""

import signal
import threading
import time

import numpy as np
import pytest
from PIL import Image

import smarttouch as st
from smarttouch.base.errors import BoardClosedError, BoardError, BoardStoppedError
from smarttouch.base.events import Advice, IntensityChanged, ModeChanged, RunEnded
from smarttouch.base.stopping import StopRequest
from smarttouch.emulator.link_board import LinkFirmware
from smarttouch.kernels.bank import load_bank
from smarttouch.plugins import ForceSource
from smarttouch.profile.profile_tables import Calibrated
from smarttouch.running.config import RunConfig
from smarttouch.running.replay_check import check_recording
from smarttouch.running.runner import Runner
from smarttouch.sources.force import open_force
from smarttouch.types import Mode
from smarttouch.views.delivered_drawing import DeliveredPicture

from ..support.checks import raises


@pytest.fixture
def display(profile):
    with st.open_display("simulated:", profile) as display:
        yield display


@pytest.fixture
def source(profile):
    return st.open_source("text:on", profile, speed_mm_s=400)


class Noting(st.Listener):
    """Listener that stores the order and the arguments of its calls."""

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


def test_a_listener_that_plays_no_vibration_leaves_pc_to_the_electrodes(source, display):
    noting = Noting()
    st.run(source, display, mode="PC", listeners=[noting])
    assert sum(result.step.sequence.slots for result in noting.results) > 0


def test_a_stimulus_source_chooses_the_classes(profile, display):
    class Taps(st.StimulusSource):
        knows_force = True

        def read(self, time_ns):
            if time_ns > 0.3e9:
                return None
            activation = np.zeros((3, 64), np.float32)
            activation[st.Afferent.RA, 27] = 1
            return st.Stimulus(activation, time_ns, profile.force.full_n, 25_000, 0.5)

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


def test_an_interrupted_run_ends_at_once_and_its_program_goes_on():
    """Ctrl-C and the stop button of a notebook send SIGINT."""
    results, main = [], threading.main_thread().ident

    def interrupt(result):
        results.append(result)
        if len(results) == 20:
            threading.Thread(target=signal.pthread_kill, args=(main, signal.SIGINT)).start()

    with pytest.raises(KeyboardInterrupt):
        st.run("text:a long line of text", "memory:", seconds=60, listeners=[interrupt])
    assert 20 <= len(results) < 500
    assert st.run("text:a", "memory:", seconds=0.1).frames == 5


@pytest.mark.parametrize("answers", [True, False])
def test_without_a_report_after_the_stop_its_counts_are_unknown(monkeypatch, answers):
    report = LinkFirmware._report

    def until_the_stop(board):
        return report(board) if answers or board.books.reason != "stop" else b""

    monkeypatch.setattr(LinkFirmware, "_report", until_the_stop)
    listener = Noting()
    statistics = st.run("text:a", "simulated:", seconds=0.1, listeners=[listener])
    assert "0.1 s" in statistics.ended
    assert (statistics.figures["pulses"] is not None) == answers
    assert any("unknown" in str(event) for event in listener.events) != answers


@pytest.mark.parametrize("stop", [st.Display.stop, lambda display: display.stopping.ask("a key")])
@pytest.mark.parametrize(
    "url", ["simulated:", "memory:", "link:/dev/null", "etactilekit:/dev/null"]
)
def test_a_display_that_was_stopped_stays_at_zero(url, stop):
    """After a stop, by another thread or by the program, the display cannot be opened again."""
    display, stopped = st.open_display(url), []
    source = st.open_source("text:a long line of words", display.profile)

    def stops(result):
        if result.number == 20:
            thread = threading.Thread(target=stop, args=(display,))
            thread.start()
            thread.join()
            stopped.append(result.number)

    if url == "simulated:":
        statistics = Runner(source, display, RunConfig(), listeners=[stops]).run()
        assert (stopped, statistics.frames) == ([20], 20)
    elif url == "memory:":
        steps = st.steps(source, display.profile, intensity=0.05)
        with display.board as board:
            board.send(next(steps).sequence)
            stop(display)
            with pytest.raises(BoardStoppedError):
                board.send(next(steps).sequence)
    stop(display)
    for _ in range(2):
        with pytest.raises(BoardStoppedError):
            display.board.open()
    with pytest.raises((BoardStoppedError, st.SmartTouchError)):
        st.run("text:a", display, seconds=0.1)


def test_on_a_finger_an_intensity_is_required(profile, source):
    display = st.open_display("link:/dev/nowhere", profile)
    with raises(st.SmartTouchError, names="intensity"):
        Runner(source, display, RunConfig()).run()
    # If an intensity is given, the error is about the missing port.
    with raises(BoardError, names="port"):
        Runner(source, display, RunConfig(intensity=0.3)).run()


def test_a_simulated_calibration_is_no_finger_s(profile, monkeypatch):
    note = Calibrated.model_construct(found="simulated: yes or no")
    monkeypatch.setitem(profile.calibrated, "thresholds", note)
    notes = []
    for on_a_finger in (False, True):
        with st.open_display("simulated:", profile) as display:
            monkeypatch.setattr(type(display), "on_a_finger", on_a_finger)
            noting, source = Noting(), st.open_source("text:a", profile, speed_mm_s=400)
            force = open_force("fixed:0.9", profile)
            st.run(source, display, intensity=0.5, force=force, listeners=[noting])
            notes.append([each for each in noting.events if isinstance(each, Advice)])
    assert not any("thresholds" in str(each) for each in notes[0])
    assert any("thresholds" in str(each) for each in notes[1])


@pytest.mark.parametrize(("seconds", "inked", "advised"), [
    (1, False, 0), (6, False, 1), (6, True, 0),
])  # fmt: skip
def test_no_ink_is_said_once(display, seconds, inked, advised):
    images = np.full((400, 64, 64), 230, np.uint8)
    images[0, 10:50, 30:34] = 20 if inked else 230
    noting = Noting()
    st.run(images, display, seconds=seconds, listeners=[noting])
    advice = [str(each) for each in noting.events if isinstance(each, Advice)]
    assert sum("no ink" in words for words in advice) == advised


def test_each_run_on_a_display_has_its_own_notes(profile, bank, display):
    told = []
    for words in ("first", "second"):
        display.board.notes.append(words)
        source, noting = st.open_source("text:a", profile, speed_mm_s=400), Noting()
        run = Runner(source, display, RunConfig(), listeners=[noting], load_kernels=lambda _: bank)
        told.append(run.run().notes)
        assert str(noting.events).count(words) == 1
    assert [told[0].count("first"), told[0].count("second")] == [1, 0]
    assert [told[1].count("first"), told[1].count("second")] == [0, 1]


def test_where_no_finger_can_be_made_what_was_delivered_is_drawn(profile, tmp_path, changed):
    # No driving function was fitted to pulses of 40 µs, so a finger cannot be simulated.
    short, shapes = changed(profile, {"pulse.width_us": 40}), []
    for each in (profile, short):
        display = st.open_display("simulated:", profile)
        picture = DeliveredPicture(tmp_path / "a.png", anatomy="paper")
        display.profile = each
        source = st.open_source("text:a", profile)
        statistics = Runner(
            source, display, RunConfig(seconds=0.2), listeners=[picture],
            load_kernels=lambda _: load_bank(profile),
        ).run()  # fmt: skip
        with Image.open(tmp_path / "a.png") as drawn:
            shapes.append(len(drawn.getbands()))
        assert len(picture.notes) == (each is short)
        assert picture.notes == statistics.notes[len(statistics.notes) - len(picture.notes) :]
    assert shapes == [3, 1]


@pytest.mark.parametrize(("url", "name", "anatomy", "wrong"), [
    ("simulated:", "a.png", "none", raises(st.ProfileError, key="anatomy", value="none")),
    ("simulated:", "a.gif", "paper", raises(st.SmartTouchError, value="a.gif")),
    ("memory:", "a.png", "paper", raises(st.SmartTouchError, names="every pulse")),
])  # fmt: skip
def test_an_impossible_picture_is_refused_before_the_board(
    profile, source, tmp_path, url, name, anatomy, wrong
):
    display = st.open_display(url, profile)
    picture = DeliveredPicture(tmp_path / name, 1, anatomy)
    with wrong:
        Runner(source, display, RunConfig(), listeners=[picture]).run()
    assert not picture.path.exists()


# -- mistakes in a program's own classes: the error names the class


class Follower(st.Listener):
    def __init__(self):
        self.most = 0


class Camera(st.OpticalSource):
    knows_force = True

    def __init__(self, returned):
        super().__init__("my camera")
        self.returned = returned

    def read(self, time_ns):
        return self.returned


def short(source="text:a", display="memory:", **settings):
    st.run(source, st.open_display(display), seconds=0.1, **settings)


@pytest.mark.parametrize(
    ("kind", "name", "act"),
    [
        (st.SmartTouchError, "Follower", lambda: short(listeners=[Follower])),
        (st.SmartTouchError, "str", lambda: short(listeners=["screen"])),
        (st.SourceError, "Camera", lambda: short(Camera(np.zeros((9, 9), np.uint8)))),
        (st.SourceError, "Camera", lambda: short(Camera(st.Frame(np.zeros((9, 9)), 0)))),
        (st.ProfileError, "4", lambda: st.open_source("text:a", 4)),
    ],
)
def test_the_sentence_names_the_class(kind, name, act):
    with raises(kind, names=name):
        act()


def test_a_profile_may_be_named_wherever_one_is_taken():
    step = next(st.steps(st.open_source("text:a", "line-7"), "line-7"))
    assert st.Finger("line-7").profile == st.load_profile(st.load_profile("line-7"))
    assert step.tactile.activation.shape == (3, 7)


def test_numbers_of_numpy_are_numbers():
    class Scale(ForceSource):
        def read(self, time_ns):
            return np.float32(0.5)

    short(force=Scale("my scale"))


# -- runs in simulated time: as fast as possible, or paced by real time


def timed(paced, *, url="text:touch what a sensor sees", stop=None, listeners=(), **settings):
    """Run on a simulated board; return the sequences, the statistics and the duration in s."""
    sequences = []
    profile = st.load_profile("smarttouch-4x4")
    runner = Runner(
        st.open_source(url, profile), st.open_display("simulated:", profile),
        st.RunConfig(paced=paced, **settings), stop=stop,
        listeners=[lambda result: sequences.append(result.sequence), *listeners],
    )  # fmt: skip
    begun_s = time.monotonic()
    statistics = runner.run()
    return sequences, statistics, time.monotonic() - begun_s


def test_a_paced_run_delivers_the_same_and_takes_its_time(tmp_path):
    fast, fast_statistics, _ = timed(False, seconds=1)
    path = tmp_path / "run.mcap"
    paced, statistics, took_s = timed(True, seconds=1, listeners=[st.Recorder(path)])
    assert took_s > 0.9
    assert "paced" not in st.load_recording(path).settings
    assert check_recording(path).exact
    # A slow computer sends fewer sequences within the time limit.
    assert 10 < len(paced) <= len(fast) + 1
    for one, other in zip(fast, paced, strict=False):
        assert one.time_ns == other.time_ns
        assert np.array_equal(one.current_ua, other.current_ua)
    for each in (fast_statistics, statistics):
        assert each.restarts == 0
        assert each.figures["dropped_late"] == each.figures["refused"] == 0
        assert each.figures["emulator_violations"] == 0
        # The time of a simulated pulse says nothing about the latency of a real board.
        assert each.figures["motion_to_pulse_us"] is None


def test_a_computer_that_stalls_makes_nothing_late_on_the_board():
    def stall(result):
        if result.number == 10:
            time.sleep(0.25)

    sequences, statistics, _ = timed(True, seconds=1.5, listeners=[stall])
    assert statistics.late >= 1
    assert statistics.restarts == statistics.figures["dropped_late"] == 0
    # The ramp does not restart at zero, so intensity never falls.
    levels = [each.intensity for each in sequences]
    assert levels == sorted(levels)
    assert levels[10] > levels[5] > 0


@pytest.mark.parametrize("at_once", [True, False])
def test_a_stop_ends_a_paced_run_within_a_moment(at_once):
    stop, asked_s = StopRequest(), []

    def ask(result):
        if result.number == 5:
            asked_s.append(time.monotonic())
            stop.ask("the test", at_once=at_once)

    sequences, statistics, _ = timed(True, stop=stop, listeners=[ask])
    assert statistics.ended == "the test"
    assert time.monotonic() - asked_s[0] < 2
    assert len(sequences) == 5


def test_a_paced_session_keeps_real_time():
    dot = np.eye(64, dtype=np.float32)[27]
    with st.open_display("simulated:").session(mode="RA", intensity=0.6, paced=True) as touch:
        touch.rise()
        begun_s = time.monotonic()
        shown = touch.show(dot, 0.3)
        touch.wait(0.2)
        assert time.monotonic() - begun_s > 0.45
        assert (shown.sequences, shown.intensity) == (15, 0.6)
        touch.put(dot, stale_s=0.2)
        time.sleep(0.5)
    assert touch.statistics.seconds > 0.5
    assert touch.statistics.figures["emulator_violations"] == 0
