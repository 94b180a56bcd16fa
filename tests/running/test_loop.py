"""Tests of the loop: it ends at zero after any failure, and stays in phase with the board."""

from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest

from smarttouch.base.afferent import Mode
from smarttouch.base.clock import LATE_NS
from smarttouch.base.errors import BoardStoppedError, LineLostError
from smarttouch.base.events import BoardRestarted
from smarttouch.base.posix import priority_advice
from smarttouch.base.stopping import StopRequest
from smarttouch.boards.open import make_board
from smarttouch.emulator.drivers import MemoryDriver
from smarttouch.running.config import RunConfig
from smarttouch.running.loop import Controls, ControlState, Loop
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.run_statistics import GUARD_NS, PhaseLock, RunStatistics, Sent
from smarttouch.running.step_records import OnEvent, as_listeners
from smarttouch.sources.force import ForceSource
from smarttouch.sources.source_contract import Frame, OpticalSource, Pose
from smarttouch.stimulation.safety_gate import SafetyLimits

from ..support.checks import raises
from ..support.scans import board_without_finger

MS, PERIOD_NS = 1_000_000, 20_000_000


class FakeClock:
    """Clock that advances only in `wait_until`: to the deadline, plus a delay from a list."""

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
    """Sensor that sees a moving bar. The bar is short, so net current does not limit the rate."""

    def __init__(self, most=100, fails_at=None, **frame):
        super().__init__("bars")
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
        since = (20 + 8 * (time_ns // PERIOD_NS)) % 56
        image[24:40, since : since + 10] = 20
        now = {
            key: value(time_ns) if callable(value) else value for key, value in self.frame.items()
        }
        return Frame(image, time_ns, Pose(0, 0), **{"number": self.frames - 1, **now})


class Watched(MemoryDriver):
    """Driver in memory that records the calls of `open`, `zero` and `close`."""

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


@pytest.fixture
def board(profile):
    # With a fake clock, no sequence is late on a busy machine.
    return board_without_finger(profile, Watched, clock=FakeClock())


@pytest.fixture
def pipeline(profile, bank):
    return Pipeline(profile, bank, RunConfig(scan="points"))


@pytest.fixture
def play(pipeline, board):
    """Return a function that runs a loop with a fake clock, and returns statistics and events."""

    def play(sensor, *listeners, board=board, clock=None, **options):
        run = SimpleNamespace(
            statistics=RunStatistics(), clock=clock or FakeClock(), stop=StopRequest(), events=[]
        )
        followers = as_listeners([*listeners, OnEvent(run.events.append)])
        options = {"controls": Controls(ControlState(Mode.RA))} | options
        with board:
            Loop(
                sensor, pipeline, board, stop=run.stop, statistics=run.statistics, clock=run.clock,
                listeners=followers, **options,
            ).run()  # fmt: skip
        run.told = [(event.time_ns, str(event)) for event in run.events]
        run.intensities = intensities(board)
        return run

    return play


def intensities(board):
    return [sequence.intensity for sequence in board.driver.sequences]


def test_frames_are_asked_for_at_absolute_deadlines(play, board):
    sensor = Bars(50)
    run = play(sensor)
    assert run.clock.deadlines == [i * PERIOD_NS for i in range(51)]
    assert sensor.times == run.clock.deadlines[:50]
    assert len(board.driver.sequences) == run.statistics.frames == 50
    assert board.driver.calls == ["open", "zero", "close"]


def test_a_late_loop_moves_its_schedule_and_never_hurries(play):
    steps = []
    run = play(Bars(5), steps.append, clock=FakeClock([0, 0, 65 * MS]))
    assert run.statistics.late == 1
    ahead_ns = [each.clock_ns - each.input.time_ns for each in steps]
    assert ahead_ns == [0, 0, 65 * MS, 65 * MS, 65 * MS]
    assert np.diff(run.clock.deadlines).tolist() == [20 * MS, 20 * MS, 85 * MS, 20 * MS, 20 * MS]


@pytest.mark.parametrize(("own_work", "first_ns"), [(False, 27 * MS), (True, 20 * MS)])
def test_a_board_whose_clock_is_behind_is_followed(play, board, monkeypatch, own_work, first_ns):
    """A wait of 7 ms for the board delays all later deadlines. Processor time delays none."""
    clock, send = FakeClock(), board.driver.write

    def held_up(proved):
        # The board begins each scan 7 ms after the deadline planned at first; earlier writes wait.
        phase = (clock.time_ns - 5_000 - 7 * MS) % PERIOD_NS
        clock.time_ns += 5 * MS if own_work else (PERIOD_NS - phase) * (phase > 10 * MS)
        return send(proved)

    monkeypatch.setattr(board.driver, "write", held_up)
    # With ``own_work``, all time of the fake clock is processor time, otherwise none.
    monkeypatch.setattr("time.thread_time_ns", lambda: clock.time_ns * own_work)
    run = play(Bars(20), clock=clock)
    assert np.diff(clock.deadlines).tolist() == [first_ns] + [PERIOD_NS] * 19
    assert run.statistics.latency.largest_us > 0


def test_seconds_end_it(play):
    run = play(Bars(), seconds=0.5)
    assert run.statistics.frames == 25
    assert "0.5 s" in run.stop.reason


@pytest.mark.parametrize("stage", ["sensor", "pipeline", "board", "observer"])
def test_an_exception_in_any_stage_ends_at_zero(monkeypatch, play, pipeline, board, stage):
    def broken(*_):
        raise BrokenStageError

    if stage in ("board", "pipeline"):
        where = (board.driver, "write") if stage == "board" else (pipeline, "process")
        monkeypatch.setattr(*where, broken)
    with pytest.raises(BrokenStageError):
        play(Bars(fails_at=3 if stage == "sensor" else None), *[broken] * (stage == "observer"))
    assert board.driver.calls == ["open", "zero", "close"]


def test_a_board_that_was_lost_and_is_back_begins_at_zero(monkeypatch, play, board):
    """Listeners also receive the step whose sequence was lost. No period error counts the gap."""
    send, clock, seen, words = board.driver.write, FakeClock(), [], "the board at x has vanished"

    def lose(proved):
        if proved.sequence.time_ns == 40 * PERIOD_NS:
            clock.time_ns += 2_000 * MS
            raise LineLostError(words)
        return send(proved)

    monkeypatch.setattr(board.driver, "write", lose)
    run = play(Bars(60), seen.append, clock=clock)
    tally = run.statistics
    assert (tally.restarts, tally.frames, tally.seen, tally.delivered) == (1, 59, 60, 59)
    assert run.intensities[39:42] == [1, 0, pytest.approx(0.04)]
    assert [sent.number is None for sent in seen] == [i == 40 for i in range(60)]
    assert [sent.step.restarted for sent in seen] == [i in (0, 41) for i in range(60)]
    assert [time_ns for time_ns, told in run.told if words in told] == [40 * PERIOD_NS]
    assert (tally.period_error.count, tally.period_error.largest_us) == (57, 0)
    (note,) = board.notes
    assert words in note


def test_a_board_that_stays_lost_ends_the_run(monkeypatch, play, board):
    def broken(*_):
        raise LineLostError("the board at x has vanished")

    def breaks(_result):
        for name in ("write", "open"):
            monkeypatch.setattr(board.driver, name, broken)

    with raises(LineLostError, names="board", value="x"):
        play(Bars(60), breaks)
    assert board.driver.calls[-2:] == ["zero", "close"]


def test_a_lifted_finger_stops_the_current_and_its_return_begins_at_zero(play, board):
    def lift(sent):
        # Boards report a lifted finger if all pulses meet an open circuit.
        if 40 <= sent.number < 60 and sent.step.sequence.slots:
            board.lifted = True

    run = play(Bars(100), lift)
    found = run.intensities
    assert found[39:55] == [1] + [0] * 15
    # After 0.3 s at zero the loop sends weak pulses. The finger is still lifted, so they stop.
    assert 0 < max(found[55:60]) <= 0.05
    assert run.statistics.lifts == 2
    assert max(np.diff(found)) <= 0.0401
    assert found[-1] > 0.5


@pytest.mark.realtime
def test_a_finger_lifted_from_the_emulated_skin(profile, pipeline):
    """Voltages and force from the board show the lift; intensity then rises from zero again."""
    sent = []
    board = make_board(
        "emulator:", SafetyLimits.of(profile), profile.output, events=["0.9 lift", "1.5 touch"]
    )
    with board:
        Loop(
            Bars(140), pipeline, board, stop=StopRequest(), statistics=RunStatistics(),
            listeners=as_listeners([lambda each: sent.append(each.step.sequence)]),
            controls=Controls(ControlState(Mode.RA)),
        ).run()  # fmt: skip
    found = np.array([each.intensity for each in sent])
    time_s = np.array([each.time_ns / 1e9 for each in sent])
    driven = np.flatnonzero(found)
    away = int(np.argmax(np.diff(time_s[driven])))
    # The finger is lifted for 0.6 s. Pulses must pause for more than half of this time.
    assert np.diff(time_s[driven])[away] > 0.3
    # A late sequence may catch up with the ramp. So intensity may rise by as much as the ramp does
    # in the time between two sequences plus `LATE_NS`.
    rise_s = np.diff(time_s) + LATE_NS / 1e9
    assert np.all(np.diff(found) <= rise_s / profile.limits.ramp_s + 0.01)
    assert max(found[: driven[away]]) == 1
    assert max(found[driven[away + 1] :]) > 0.5


@pytest.mark.parametrize("unknown", ["stale", "force"])
def test_what_is_not_known_has_no_current(play, unknown):
    """Image or force is unknown from 0.8 to 1.2 s; then intensity rises from zero again."""

    def gone(time_ns):
        return 800 * MS <= time_ns < 1_200 * MS

    def force_n(time_ns):
        return float("nan") if gone(time_ns) else 1.0

    run = play(Bars(90, **({"stale": gone} if unknown == "stale" else {"force_n": force_n})))
    intensity = run.intensities
    assert [intensity[39], *intensity[40:60], intensity[89]] == [1, *[0] * 20, 1]
    assert intensity[60] <= 0.041
    assert run.statistics.blind == 20
    words = [words for time_ns, words in run.told if time_ns in (800 * MS, 1_200 * MS)]
    assert [unknown in each for each in words] == [True, unknown == "force"]


@pytest.mark.parametrize(("frame_n", "source_n", "board_n", "counts_n"), [
    (1.0, 0.5, None, 0.5),  # a force source replaces the force of the frame
    (1.0, 1.0, 0.5, 0.5),  # the smaller force counts, here the board's
    (1.0, float("nan"), 1.0, None),  # if the force source fails, the board's force does not count
    (float("nan"), None, 0.5, 0.5),
    (1.0, None, 0.05, 0.05),
])  # fmt: skip
def test_which_force_counts(play, board, frame_n, source_n, board_n, counts_n):
    class Pressing(ForceSource):
        def read(self, time_ns):
            return source_n

    board.force_n = board_n
    force = None if source_n is None else Pressing("a test")
    run = play(Bars(40, force_n=frame_n), force=force)
    expected = 0 if counts_n is None else max(0, (counts_n - 0.15) / 0.75)
    assert max(run.intensities) == pytest.approx(expected, abs=1e-6)
    assert run.statistics.blind == (40 if counts_n is None else 0)


def test_the_user_s_request_is_followed_and_reported(play, board):
    class Scripted(Controls):
        def state(self, time_ns):
            return [wish for since, wish in wishes if since <= time_ns][-1]

    wishes = [
        (0, ControlState(Mode.RA, 0.5)),
        (800 * MS, ControlState(Mode.RA, 0.5, paused=True)),
        (1_000 * MS, ControlState(Mode.RA, 0.25)),
        (1_600 * MS, ControlState(Mode.SAI, 0.25)),
    ]
    run = play(Bars(120), controls=Scripted(wishes[0][1]))
    intensity = run.intensities
    assert [intensity[at] for at in (39, *range(40, 50), 79, 80, 119)] == [
        0.5, *[0] * 10, 0.25, 0, 0.25,
    ]  # fmt: skip
    assert intensity[50] <= 0.041
    # The center electrode of a kernel is anodic for RA and cathodic for SAI.
    was, now = (board.driver.sequences[at] for at in (79, 119))
    assert was.current_ua[0, was.site[0]] < 0 < now.current_ua[0, now.site[0]]
    assert [(time_ns // MS, words) for time_ns, words in run.told[:-1]] == [
        (0, "intensity 0.50"), (0, "mode RA"), (800, "paused"), (1_000, "intensity 0.25"),
        (1_000, "resumed"), (1_600, "mode SAI"),
    ]  # fmt: skip
    assert run.told[-1][0] == 2_400 * MS


def test_the_same_image_again_is_felt_once(play):
    tally = play(Bars(40, number=lambda time_ns: time_ns // (50 * MS))).statistics
    assert (tally.frames, tally.seen, tally.delivered) == (40, 16, 16)


def test_the_age_of_an_image_counts(play):
    tally = play(Bars(10, age_ns=7 * MS)).statistics
    assert tally.motion_to_bytes.largest_us == tally.latency.largest_us + 7000
    assert tally.period_error.largest_us == 0
    assert 0 < tally.work_share < 1


@pytest.mark.parametrize(("stalls", "before"), [((40,), 1), ((10, 20, 30), 0.36)])
def test_what_was_computed_before_a_pause_is_not_sent(
    monkeypatch, profile, play, pipeline, stalls, before
):
    """A sequence is dropped if the computer stalls after computing it. Many drops are one event."""
    clock, process = FakeClock(), pipeline.process
    # With ``claimed_time``, which this helper sets by default, no sequence would be late.
    board = board_without_finger(profile, Watched, clock=clock, claimed_time=False)

    def stand_still(*given):
        step, dropped = process(*given), board.dropped_late
        if dropped < len(stalls) and len(board.driver.sequences) == stalls[dropped]:
            clock.time_ns += 300 * MS
        return step

    monkeypatch.setattr(pipeline, "process", stand_still)
    run, last = play(Bars(60), board=board, clock=clock), stalls[-1]
    assert run.intensities[last - 1 : last + 2] == [
        pytest.approx(before), 0, pytest.approx(0.04),
    ]  # fmt: skip
    assert (board.dropped_late, run.statistics.restarts) == (len(stalls), 0)
    assert run.statistics.frames == 60 - len(stalls)
    assert sum(isinstance(event, BoardRestarted) for event in run.events) == 1


def test_a_pause_before_a_frame_is_taken_drops_nothing(profile, play):
    clock = FakeClock([0] * 40 + [300 * MS])
    board = board_without_finger(profile, Watched, clock=clock)
    run = play(Bars(60), board=board, clock=clock)
    assert run.intensities[39:42] == [1, 0, pytest.approx(0.04)]
    assert board.dropped_late == 0


def test_a_board_stopped_by_nobody_who_may_is_a_fault(play, board):
    with raises(BoardStoppedError, names="board"):
        play(Bars(60), lambda _sent: board.stop())


@pytest.mark.parametrize(("on_a_finger", "simulated_time"), [(0, 0), (1, 0), (0, 1)])
def test_priority_is_for_boards_whose_time_passes(
    profile, play, monkeypatch, on_a_finger, simulated_time
):
    board = board_without_finger(
        profile, Watched, clock=FakeClock(), on_a_finger=bool(on_a_finger),
        simulated_time=bool(simulated_time),
    )  # fmt: skip
    taken = []

    @contextmanager
    def prioritized():
        taken.append("taken")
        yield False
        taken.append("given back")

    monkeypatch.setattr("smarttouch.running.loop.prioritized", prioritized)
    run = play(Bars(3), board=board, controls=Controls(ControlState(Mode.RA)))
    assert taken == ([] if simulated_time else ["taken", "given back"])
    assert not run.statistics.real_time
    assert (priority_advice() in [words for _, words in run.told]) is bool(on_a_finger)


# -- phase lock: images are fresh and the board does not pause, however slow the line is


class Scanning:
    """Board whose clock is 7 ms ahead; each sequence begins at the end of the one before."""

    def __init__(self, line_ns=MS // 5, period_ns=20 * MS, held_up_at=None, is_silent=False):
        self.line_ns, self.period_ns, self.held_up_at = line_ns, period_ns, held_up_at
        self.starts, self.free_ns, self.paused_ns, self.is_silent = {}, 0, 0, is_silent

    def send(self, number, sent_ns):
        """Receive a sequence. Return its start time on the loop's clock."""
        here_ns = sent_ns + self.line_ns + 15 * MS * (number == self.held_up_at)
        begun_ns = max(self.free_ns, here_ns)
        self.paused_ns += begun_ns - self.free_ns
        self.starts[number], self.free_ns = begun_ns, begun_ns + self.period_ns
        return begun_ns

    def start_of(self, number):
        if self.is_silent or self.starts.get(number, self.now_ns + 1) > self.now_ns:
            return None
        time_ns = self.starts[number] + 7 * MS
        return time_ns, time_ns // 1000


def followed(delays_ns, first_ns=0, **kind):
    """Send each sequence at its deadline plus its delay. The `Scanning` board can begin the first
    one at ``first_ns``. Return the times from sending to start, the board, and statistics."""
    board, statistics, zero_ns, waits_ns = Scanning(**kind), RunStatistics(), 0, []
    board.free_ns, phase = first_ns, PhaseLock(board, statistics)
    for number, delay_ns in enumerate(delays_ns):
        deadline_ns = number * 20 * MS + zero_ns
        sent_ns = deadline_ns + int(delay_ns)
        times_ns = deadline_ns - 3 * MS, deadline_ns, number * 20 * MS, 0, sent_ns
        waits_ns.append(board.send(number, sent_ns) - sent_ns)
        board.now_ns = sent_ns
        zero_ns += phase.follow(zero_ns, Sent(number, *times_ns, board.period_ns, 7 * MS))
    return np.array(waits_ns), board, statistics


def jitter(count, most_ns, hiccup_ns=0):
    delays_ns = MS + np.random.default_rng(0).integers(0, most_ns + 1, count)
    delays_ns[60] += hiccup_ns
    return delays_ns


@pytest.mark.parametrize("jitter_ns", [0, MS // 2, 3 * MS])
def test_a_sequence_waits_no_longer_than_jitter_requires(jitter_ns):
    waits_ns, board, statistics = followed(jitter(200, jitter_ns), first_ns=19 * MS)
    settled_ns = waits_ns[5:]
    assert settled_ns.max() <= GUARD_NS + board.line_ns + jitter_ns
    assert np.median(settled_ns) <= GUARD_NS + board.line_ns + 0.6 * jitter_ns
    assert board.paused_ns < 0.002 * 200 * board.period_ns
    # All sequences but the last have begun. Each is sent at least 4 ms after its image was taken.
    assert statistics.waited.count == statistics.first_pulse.count == 199
    assert statistics.first_pulse.largest_us >= statistics.waited.largest_us + 4000


@pytest.mark.parametrize(("hiccup_ns", "held_up_at", "most_ns"), [
    (8 * MS, None, 500_000), (15 * MS, None, 500_000), (0, 60, MS),
])  # fmt: skip
def test_a_hiccup_of_loop_or_board_is_made_up_for_within_ten_periods(
    hiccup_ns, held_up_at, most_ns
):
    waits_ns, *_ = followed(jitter(120, MS // 2, hiccup_ns), held_up_at=held_up_at)
    assert np.median(waits_ns[63:70]) <= GUARD_NS + most_ns
    assert held_up_at is None or waits_ns[60] > 14 * MS


@pytest.mark.parametrize("line_ns", [3 * MS, 12 * MS])
def test_what_a_slow_line_takes_is_no_wait(line_ns):
    _, board, _ = followed(jitter(400, MS // 2), line_ns=line_ns)
    # If transfer time counted as a wait, deadlines would be delayed until the board must pause.
    assert board.paused_ns < 0.01 * 400 * board.period_ns


@pytest.mark.parametrize("slower", [0.999, 1.001])
def test_a_board_with_another_second(slower):
    waits_ns, board, _ = followed(jitter(1000, MS // 2), period_ns=round(20 * MS * slower))
    assert waits_ns[10:].max() <= GUARD_NS + board.line_ns + MS
    assert board.paused_ns <= 1000 * 20 * MS * max(0, 1 - slower) + 2 * MS


def test_a_board_that_never_reports_a_start_has_no_phase():
    waits_ns, _, statistics = followed(jitter(70, 0), is_silent=True, first_ns=19 * MS)
    assert np.ptp(waits_ns) == 0
    assert not statistics.first_pulse.count
