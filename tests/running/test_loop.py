"""The loop ends in order, whatever happens in it."""

import threading
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from smarttouch.base.afferent import Mode
from smarttouch.base.errors import (
    BoardError,
    BoardRestartedError,
    BoardStoppedError,
    LineLostError,
    SafetyError,
)
from smarttouch.base.events import BoardRestarted
from smarttouch.base.posix import priority_advice
from smarttouch.base.stopping import StopRequest
from smarttouch.boards.open import MemoryDriver, make_board
from smarttouch.running.config import RunConfig
from smarttouch.running.inputs import Controls, ControlState
from smarttouch.running.loop import Loop
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.run_statistics import RunStatistics
from smarttouch.running.step import OnEvent, OnStep, as_listeners
from smarttouch.sources.force import ForceSource
from smarttouch.sources.source_contract import Frame, OpticalSource, Pose
from smarttouch.stimulation.safety_gate import SafetyLimits

from ..played import played
from ..raising import raises


class FakeClock:
    """Time that passes only when someone waits, and as much as is asked."""

    def __init__(self, lateness_ns=()):
        self.time_ns = 5_000
        self.lateness_ns = list(lateness_ns)
        self.deadlines = []

    def now_ns(self):
        return self.time_ns

    def wait_until(self, deadline_ns, stop):
        self.deadlines.append(deadline_ns - 5_000)
        late = self.lateness_ns.pop(0) if self.lateness_ns else 0
        self.time_ns = max(self.time_ns, deadline_ns) + late


class BrokenStageError(Exception):
    pass


class Bars(OpticalSource):
    """A sensor over a short black bar that moves: net current is no limit of its rate."""

    def __init__(self, most=100, fails_at=None, speed=8, **frame):
        super().__init__("bars")
        self.speed = speed
        self.times, self.most, self.fails_at = [], most, fails_at
        self.frame = {"force_n": 1.0, **frame}

    def read(self, time_ns):
        if self.fails_at == len(self.times):
            raise BrokenStageError
        if len(self.times) == self.most:
            return None
        self.times.append(time_ns)
        self.frames += 1
        image = np.full((64, 64), 220, np.uint8)
        since = (20 + self.speed * (time_ns // 20_000_000)) % 56
        image[24:40, since : since + 10] = 20
        now = {
            key: value(time_ns) if callable(value) else value for key, value in self.frame.items()
        }
        return Frame(image, time_ns, Pose(0, 0), **{"number": self.frames - 1, **now})


class Watched(MemoryDriver):
    """A driver in memory that notes what it is asked to do."""

    def __init__(self, *given):
        super().__init__(*given)
        self.calls = []

    def open(self, line, limits):
        self.calls.append("open")
        return super().open(line, limits)

    def zero(self):
        self.calls.append("zero")

    def close(self):
        self.calls.append("close")

    def is_busy(self):
        self.calls.append("drain")
        return False


def loop(source, pipeline, board, **options):
    """Run on a clock that the test sets, with its own stop and statistics if none are given."""
    usual = {"stop": StopRequest(), "statistics": RunStatistics(), "clock": FakeClock()}
    Loop(source, pipeline, board, **(usual | options)).run()


@pytest.fixture
def board(profile):
    # However busy the machine is, nothing is late but what a test makes late.
    return played(profile, Watched, clock=FakeClock())


@pytest.fixture
def pipeline(profile, bank):
    return Pipeline(profile, bank, RunConfig(scan="points"))


def test_frames_are_asked_for_at_absolute_deadlines(pipeline, board):
    sensor, clock, tally = Bars(50), FakeClock(), RunStatistics()
    with board:
        loop(sensor, pipeline, board, statistics=tally, clock=clock)
    assert clock.deadlines == [i * 20_000_000 for i in range(51)]
    assert sensor.times == clock.deadlines[:50]
    assert len(board.driver.sequences) == tally.frames == 50
    assert board.driver.calls == ["open", "drain", "zero", "close"]


def test_a_late_loop_moves_its_schedule_and_never_hurries(pipeline, board):
    clock, tally, steps = FakeClock([0, 0, 65_000_000]), RunStatistics(), []
    with board:
        loop(
            Bars(5), pipeline, board, statistics=tally, clock=clock,
            listeners=[OnStep(steps.append)],
        )  # fmt: skip
    assert tally.late == 1
    ahead_ns = [each.clock_ns - each.input.time_ns for each in steps]
    assert ahead_ns == [0, 0, 65_000_000, 65_000_000, 65_000_000]
    assert np.diff(clock.deadlines).min() == 20_000_000
    assert clock.deadlines[3] - clock.deadlines[2] == 85_000_000


def test_a_board_whose_clock_is_behind_is_followed(pipeline, board, monkeypatch):
    clock, tally, send = FakeClock(), RunStatistics(), board.driver.write

    def held_up(proved):
        # Its scans begin 7 ms after their time: who asks earlier has to wait.
        phase = (clock.time_ns - 5_000 - 7_000_000) % 20_000_000
        clock.time_ns += (20_000_000 - phase) if phase > 10_000_000 else 0
        return send(proved)

    monkeypatch.setattr(board.driver, "write", held_up)
    # Real processor time means nothing beside this clock.
    monkeypatch.setattr("time.thread_time_ns", lambda: 0)
    with board:
        loop(Bars(20), pipeline, board, statistics=tally, clock=clock)
    # It waits once, and from then on takes its frames 7 ms later.
    assert np.diff(clock.deadlines).tolist() == [27_000_000] + [20_000_000] * 19
    assert tally.latency.total_us == tally.latency.largest_us > 0


def test_own_work_in_a_send_is_no_wait_for_the_board(pipeline, board, monkeypatch):
    clock, send = FakeClock(), board.driver.write

    def worked(proved):
        clock.time_ns += 5_000_000
        return send(proved)

    monkeypatch.setattr(board.driver, "write", worked)
    monkeypatch.setattr("time.thread_time_ns", lambda: clock.time_ns)
    with board:
        loop(Bars(20), pipeline, board, clock=clock)
    assert np.diff(clock.deadlines).tolist() == [20_000_000] * 20


def test_seconds_end_it(pipeline, board):
    stop, tally = StopRequest(), RunStatistics()
    with board:
        loop(Bars(), pipeline, board, stop=stop, statistics=tally, seconds=0.5)
    assert tally.frames == 25
    assert "0.5 s" in stop.reason


def test_a_stop_request_ends_it_before_the_next_frame(pipeline, board):
    stop, tally = StopRequest(), RunStatistics()

    def after_ten(_):
        if tally.frames == 10:
            stop.ask("enough")
            stop.ask("too late to be the reason")

    with board:
        loop(
            Bars(), pipeline, board, stop=stop, statistics=tally,
            listeners=as_listeners([after_ten]),
        )  # fmt: skip
    assert tally.frames == 10
    assert stop.reason == "enough"


@pytest.mark.parametrize("stage", ["sensor", "pipeline", "board", "observer"])
def test_an_exception_in_any_stage_ends_at_zero(monkeypatch, pipeline, board, stage):
    def broken(*_):
        raise BrokenStageError

    sensor = Bars(fails_at=3 if stage == "sensor" else None)
    if stage == "board":
        monkeypatch.setattr(board.driver, "write", broken)
    if stage == "pipeline":
        monkeypatch.setattr(pipeline, "process", broken)
    observers = [broken] if stage == "observer" else []
    with pytest.raises(BrokenStageError), board:
        loop(sensor, pipeline, board, listeners=as_listeners(observers))
    assert board.driver.calls == ["open", "zero", "close"]


def intensities(board):
    return [sequence.intensity for sequence in board.driver.sequences]


def test_a_board_that_was_lost_and_is_back_begins_at_zero(monkeypatch, pipeline, board):
    tally, send = RunStatistics(), board.driver.write
    lost = LineLostError("the board at x has vanished")

    def loses_the_fortieth(proved):
        if len(board.driver.sequences) == 40:
            monkeypatch.setattr(board.driver, "write", send)
            raise lost
        return send(proved)

    monkeypatch.setattr(board.driver, "write", loses_the_fortieth)
    with board:
        loop(Bars(60), pipeline, board, statistics=tally)
    assert (tally.restarts, tally.frames) == (1, 59)
    assert intensities(board)[39:42] == [1, 0, pytest.approx(0.04)]
    (note,) = board.notes
    assert str(lost) in note


def test_after_a_loss_nothing_but_zero_is_let_through(monkeypatch, profile, pipeline, board):
    def lost(*_):
        raise LineLostError("the board at x has vanished")

    with board:
        loop(Bars(40), pipeline, board)
        last = board.driver.sequences[-1]
        assert last.intensity == 1
        with monkeypatch.context() as patch:
            patch.setattr(board.driver, "write", lost)
            with pytest.raises(BoardRestartedError):
                board.send(replace(last, time_ns=last.time_ns + 10**9))
        with raises(SafetyError, limit="ramp_s", value=1, allowed=0):
            board.send(replace(last, time_ns=last.time_ns + 2 * 10**9))


def test_a_board_that_stays_lost_ends_the_run(monkeypatch, pipeline, board):
    def broken(*_):
        raise LineLostError("the board at x has vanished")

    with raises(LineLostError, names="board", value="x"), board:
        monkeypatch.setattr(board.driver, "write", broken)
        monkeypatch.setattr(board.driver, "open", broken)
        loop(Bars(60), pipeline, board)
    assert board.driver.calls[-2:] == ["zero", "close"]


def test_a_lifted_finger_stops_the_current_and_its_return_begins_at_zero(pipeline, board):
    tally = RunStatistics()

    def lift(sent):
        # As a board would tell: all of what it was sent met an open circuit.
        if 40 <= tally.frames < 60 and sent.step.sequence.slots:
            board.lifted = True

    with board:
        loop(Bars(100), pipeline, board, statistics=tally, listeners=as_listeners([lift]))
    found = intensities(board)
    assert found[39] == 1
    assert found[40:55] == [0] * 15
    # 0.3 s later it tries once more, with next to nothing, and waits again.
    assert 0 < max(found[55:60]) <= 0.05
    assert tally.lifts == 2
    assert max(np.diff(found)) <= 0.0401
    assert found[-1] > 0.5


@pytest.mark.usefixtures("patient_boards")
def test_a_finger_lifted_from_the_emulated_skin(profile, pipeline):
    """By the voltages and the force that the board reports; it comes back from zero."""
    sent = []
    board = make_board(
        "emulator:", SafetyLimits.of(profile), profile.output, events=["0.9 lift", "1.5 touch"]
    )
    with board:
        Loop(
            Bars(140), pipeline, board, stop=StopRequest(), statistics=RunStatistics(),
            listeners=as_listeners([lambda each: sent.append(each.step.sequence)]),
        ).run()  # fmt: skip
    found = np.array([each.intensity for each in sent])
    time_s = np.array([each.time_ns / 1e9 for each in sent])
    driven = np.flatnonzero(found)
    away = int(np.argmax(np.diff(time_s[driven])))
    # It is lifted for 0.6 s, and told of a little later than put back.
    assert np.diff(time_s[driven])[away] > 0.3
    assert np.all(np.diff(found) <= np.diff(time_s) / profile.limits.ramp_s + 0.01)
    assert max(found[: driven[away]]) == 1
    assert max(found[driven[away + 1] :]) > 0.5


class Pressing(ForceSource):
    """A force source that a test writes."""

    def __init__(self, force_n):
        super().__init__("a test")
        self.force_n = force_n

    def read(self, time_ns):
        return self.force_n(time_ns)


def play(board, pipeline, sensor, listeners=(), **options):
    tally, told = RunStatistics(), []
    note = OnEvent(lambda event: told.append((event.time_ns, str(event))))
    options |= {"statistics": tally, "listeners": [*as_listeners(listeners), note]}
    with board:
        loop(sensor, pipeline, board, **options)
    return tally, told


@pytest.mark.parametrize("unknown", ["stale", "force"])
def test_what_is_not_known_has_no_current(pipeline, board, unknown):
    """From 0.8 to 1.2 s: then it rises from zero again."""

    def gone(time_ns):
        return 800_000_000 <= time_ns < 1_200_000_000

    frame = (
        {"stale": gone}
        if unknown == "stale"
        else {"force_n": lambda time_ns: float("nan") if gone(time_ns) else 1.0}
    )
    tally, told = play(board, pipeline, Bars(90, **frame))
    intensity = intensities(board)
    assert intensity[39] == 1
    assert not any(intensity[40:60])
    assert intensity[60] <= 0.041
    assert intensity[89] == 1
    assert tally.blind == 20
    words = [words for time_ns, words in told if time_ns in (800_000_000, 1_200_000_000)]
    assert [unknown in each for each in words] == [True, unknown == "force"]


@pytest.mark.parametrize(("frame_n", "source_n", "board_n", "counts_n"), [
    (1.0, 0.5, None, 0.5),  # a source of force comes before the frame
    (1.0, 1.0, 0.5, 0.5),  # the board may lower what it says
    (1.0, float("nan"), 1.0, None),  # and does not stand in for one that fails
    (float("nan"), None, 0.5, 0.5),
    (1.0, None, 0.05, 0.05),
])  # fmt: skip
def test_which_force_counts(pipeline, board, frame_n, source_n, board_n, counts_n):
    board.force_n = board_n
    force = None if source_n is None else Pressing(lambda _: source_n)
    tally, _ = play(board, pipeline, Bars(40, force_n=frame_n), force=force)
    expected = 0 if counts_n is None else max(0, (counts_n - 0.15) / 0.75)
    assert max(intensities(board)) == pytest.approx(expected, abs=1e-6)
    assert tally.blind == (40 if counts_n is None else 0)


class Scripted(Controls):
    """A user whose wishes come at set times."""

    def __init__(self, *wishes):
        self.wishes = list(wishes)

    def state(self, time_ns):
        return [wish for since, wish in self.wishes if since <= time_ns][-1]


def test_the_user_s_request_is_followed_and_reported(pipeline, board):
    controls = Scripted(
        (0, ControlState(Mode.RA, 0.5)),
        (800_000_000, ControlState(Mode.RA, 0.5, paused=True)),
        (1_000_000_000, ControlState(Mode.RA, 0.25)),
        (1_600_000_000, ControlState(Mode.SAI, 0.25)),
    )
    _, told = play(board, pipeline, Bars(120), controls=controls)
    intensity = intensities(board)
    assert intensity[39] == 0.5
    assert not any(intensity[40:50])
    assert intensity[50] <= 0.041
    assert intensity[79] == 0.25
    assert intensity[80] == 0
    assert intensity[119] == 0.25
    # Kernels of the other class: its center is cathodic.
    current_ua = [
        sequence.current_ua[0, sequence.site[0]]
        for sequence in (board.driver.sequences[i] for i in (79, 119))
    ]
    assert current_ua[0] < 0 < current_ua[1]
    end_ns, _ = told.pop()
    assert end_ns == 2_400_000_000
    assert told == [
        (0, "intensity 0.50"),
        (0, "mode RA"),
        (800_000_000, "paused"),
        (1_000_000_000, "intensity 0.25"),
        (1_000_000_000, "goes on"),
        (1_600_000_000, "mode SAI"),
    ]


def test_the_same_image_again_is_felt_once(pipeline, board):
    tally, _ = play(board, pipeline, Bars(40, number=lambda time_ns: time_ns // 50_000_000))
    assert (tally.frames, tally.seen, tally.delivered) == (40, 16, 16)


def test_every_step_is_observed_also_one_that_was_lost(pipeline, board, monkeypatch):
    send, seen = board.driver.write, []
    lost = LineLostError("the line is lost")

    def lose(proved):
        if proved.sequence.time_ns == 400_000_000:
            raise lost
        return send(proved)

    monkeypatch.setattr(board.driver, "write", lose)
    tally, told = play(board, pipeline, Bars(30), listeners=[seen.append])
    assert [sent.number is None for sent in seen] == [i == 20 for i in range(30)]
    assert (tally.seen, tally.delivered) == (30, 29)
    assert [sent.step.restarted for sent in seen] == [i in (0, 21) for i in range(30)]
    assert [time_ns for time_ns, words in told if str(lost) in words] == [400_000_000]


def test_the_time_that_a_board_was_lost_is_no_error_of_the_period(pipeline, board, monkeypatch):
    send, clock, tally = board.driver.write, FakeClock(), RunStatistics()

    def lose(proved):
        if proved.sequence.time_ns == 400_000_000:
            clock.time_ns += 2_000_000_000
            raise LineLostError("the line is lost")
        return send(proved)

    monkeypatch.setattr(board.driver, "write", lose)
    with board:
        loop(Bars(40), pipeline, board, statistics=tally, clock=clock)
    assert tally.period_error.count == 37
    assert tally.period_error.largest_us == 0


def test_the_age_of_an_image_counts(pipeline, board):
    tally, _ = play(board, pipeline, Bars(10, age_ns=7_000_000))
    assert tally.motion_to_bytes.largest_us == tally.latency.largest_us + 7000
    assert tally.period_error.largest_us == 0
    assert 0 < tally.work_share < 1


@pytest.mark.parametrize(("stalls", "before"), [((40,), 1), ((10, 20, 30), 0.36)])
def test_what_was_computed_before_a_pause_is_not_sent(
    monkeypatch, profile, pipeline, stalls, before
):
    """The computer stands still between the making of a sequence and its sending; what happens
    again and again is reported once."""
    clock, tally, words = FakeClock(), RunStatistics(), []
    # One without a time of its own is never late.
    board = played(profile, Watched, clock=clock, claimed_time=False)
    process = pipeline.process

    def stand_still(*given):
        step = process(*given)
        if (
            board.dropped_late < len(stalls)
            and len(board.driver.sequences) == stalls[board.dropped_late]
        ):
            clock.time_ns += 300_000_000
        return step

    monkeypatch.setattr(pipeline, "process", stand_still)
    with board:
        loop(
            Bars(60), pipeline, board, statistics=tally, clock=clock,
            listeners=[OnEvent(words.append)],
        )  # fmt: skip
    last = stalls[-1]
    assert intensities(board)[last - 1 : last + 2] == [
        pytest.approx(before),
        0,
        pytest.approx(0.04),
    ]
    assert (board.dropped_late, tally.restarts) == (len(stalls), 0)
    assert tally.frames == 60 - len(stalls)
    assert sum(isinstance(event, BoardRestarted) for event in words) == 1


def test_a_pause_before_a_frame_is_taken_drops_nothing(profile, pipeline):
    clock = FakeClock([0] * 40 + [300_000_000])
    board = played(profile, Watched, clock=clock)
    with board:
        loop(Bars(60), pipeline, board, clock=clock)
    assert intensities(board)[39:42] == [1, 0, pytest.approx(0.04)]
    assert board.dropped_late == 0


def test_a_stop_halts_the_board_in_the_middle_of_a_step(monkeypatch, pipeline, board):
    stop, tally = StopRequest(), RunStatistics()
    process = pipeline.process

    def stopped_meanwhile(*given):
        if len(board.driver.sequences) == 10:
            thread = threading.Thread(target=stop.ask, args=("key q",))
            thread.start()
            thread.join()
        return process(*given)

    monkeypatch.setattr(pipeline, "process", stopped_meanwhile)
    with board, stop.on_stop(board.halt):
        loop(Bars(60), pipeline, board, stop=stop, statistics=tally)
    assert (len(board.driver.sequences), tally.frames, stop.reason) == (10, 10, "key q")


def test_a_board_stopped_by_nobody_who_may_is_a_fault(pipeline, board):
    def stops(_sent):
        board.stop()

    with board, raises(BoardStoppedError, names="board"):
        loop(Bars(60), pipeline, board, listeners=as_listeners([stops]))


def test_on_a_finger_an_intensity_must_be_given(profile, pipeline):
    board = played(profile, Watched, clock=FakeClock(), on_a_finger=True)
    with board:
        with raises(BoardError, names="controls"):
            loop(Bars(5), pipeline, board)
        assert board.driver.sequences == []
        controls = Controls(ControlState(Mode.RA, 0.0))
        loop(Bars(5), pipeline, board, controls=controls)
    assert intensities(board) == [0] * 5


@pytest.mark.parametrize(("on_a_finger", "simulated_time"), [(0, 0), (1, 0), (0, 1)])
def test_priority_is_for_boards_whose_time_passes(
    profile, pipeline, monkeypatch, on_a_finger, simulated_time
):
    kind = type("Own", (Watched,), {"simulated_time": bool(simulated_time)})
    board = played(profile, kind, clock=FakeClock(), on_a_finger=bool(on_a_finger))
    taken = []

    @contextmanager
    def prioritized():
        taken.append("taken")
        yield False
        taken.append("given back")

    monkeypatch.setattr("smarttouch.running.loop.prioritized", prioritized)
    told, tally = [], RunStatistics()
    with board:
        loop(
            Bars(3), pipeline, board, statistics=tally,
            controls=Controls(ControlState(pipeline.mode)),
            listeners=[OnEvent(lambda event: told.append(str(event)))],
        )  # fmt: skip
    assert taken == ([] if simulated_time else ["taken", "given back"])
    assert not tally.real_time
    assert (priority_advice() in told) is bool(on_a_finger)
