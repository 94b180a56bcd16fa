"""The loop's phase against a board: fresh images, no pauses, whatever the line takes."""

import numpy as np
import pytest

from smarttouch.boards.reports import SequenceStart
from smarttouch.running.loop import GUARD_NS, PhaseLock, Sent
from smarttouch.running.run_statistics import RunStatistics

MS = 1_000_000


class Board:
    """A board with a clock that runs ahead, which begins a sequence once the one before is over."""

    simulated_time = False
    reports_starts = True

    def __init__(self, line_ns, ahead_ns, period_ns):
        self.line_ns, self.ahead_ns, self.period_ns = line_ns, ahead_ns, period_ns
        self.starts, self.free_ns, self.paused_ns = {}, None, 0
        self.driver = self

    def send(self, number, sent_ns):
        """Take a sequence, and return when it begins; by the loop's clock."""
        here_ns = sent_ns + self.line_ns
        begun_ns = here_ns if self.free_ns is None else max(self.free_ns, here_ns)
        self.paused_ns += 0 if self.free_ns is None else begun_ns - self.free_ns
        self.starts[number] = begun_ns
        self.free_ns = begun_ns + self.period_ns
        return begun_ns

    def start_of(self, number):
        if number not in self.starts or self.starts[number] > self.now_ns:
            return None
        time_ns = self.starts[number] + self.ahead_ns
        return SequenceStart(number, time_ns, time_ns // 1000)


class Silent(Board):
    def start_of(self, number):
        return None


def play(delays_ns, line_ns=MS // 5, kind=Board, period_ns=20 * MS, ahead_ns=7 * MS, first_ns=0):
    """Return what each sequence waited for, after so many delays from deadline to last byte."""
    board = kind(line_ns, ahead_ns, period_ns)
    board.free_ns = first_ns
    statistics = RunStatistics()
    phase, shift_ns, waits_ns = PhaseLock(board, statistics), 0, []
    for number, delay_ns in enumerate(delays_ns):
        deadline_ns = number * 20 * MS + shift_ns
        sent_ns = deadline_ns + int(delay_ns)
        times_ns = deadline_ns - 3 * MS, deadline_ns, number * 20 * MS, 0, sent_ns
        sent = Sent(number, *times_ns, period_ns, ahead_ns)
        waits_ns.append(board.send(number, sent_ns) - sent_ns)
        board.now_ns = sent_ns
        shift_ns += phase.follow(shift_ns, sent)
    return np.array(waits_ns), board, statistics


def jitter(count, most_ns, seed=0):
    return MS + np.random.default_rng(seed).integers(0, most_ns + 1, count)


@pytest.mark.parametrize("jitter_ns", [0, MS // 2, 3 * MS])
def test_a_sequence_waits_no_longer_than_jitter_requires(jitter_ns):
    waits_ns, board, statistics = play(jitter(200, jitter_ns), first_ns=19 * MS)
    settled_ns = waits_ns[5:]
    assert settled_ns.max() <= GUARD_NS + board.line_ns + jitter_ns
    assert np.median(settled_ns) <= GUARD_NS + board.line_ns + 0.6 * jitter_ns
    assert board.paused_ns < 0.002 * 200 * board.period_ns
    # All but the newest, by the board's clock as the loop's.
    assert statistics.waited.count == statistics.first_pulse.count == 199
    assert statistics.first_pulse.largest_us >= statistics.waited.largest_us + 4000


@pytest.mark.parametrize("hiccup_ns", [8 * MS, 15 * MS])
def test_a_hiccup_is_made_up_for_within_ten_periods(hiccup_ns):
    delays_ns = jitter(120, MS // 2)
    delays_ns[60] += hiccup_ns
    waits_ns, *_ = play(delays_ns)
    assert np.median(waits_ns[63:70]) <= GUARD_NS + 3 * MS // 10 + MS // 5


@pytest.mark.parametrize("line_ns", [3 * MS, 12 * MS])
def test_what_a_slow_line_takes_is_no_wait(line_ns):
    _, board, _ = play(jitter(400, MS // 2), line_ns=line_ns)
    # Else the rate would fall to where nothing ever waits.
    assert board.paused_ns < 0.01 * 400 * board.period_ns


def test_a_board_that_is_held_up_once():
    class HeldUp(Board):
        def send(self, number, sent_ns):
            return super().send(number, sent_ns + 15 * MS * (number == 60))

    waits_ns, *_ = play(jitter(120, MS // 2), kind=HeldUp)
    assert waits_ns[60] > 14 * MS
    assert np.median(waits_ns[63:70]) <= GUARD_NS + MS


@pytest.mark.parametrize("slower", [0.999, 1.001])
def test_a_board_with_another_second(slower):
    waits_ns, board, _ = play(jitter(1000, MS // 2), period_ns=round(20 * MS * slower))
    assert waits_ns[10:].max() <= GUARD_NS + board.line_ns + MS
    assert board.paused_ns <= 1000 * 20 * MS * max(0, 1 - slower) + 2 * MS


def test_a_board_that_never_reports_a_start_has_no_phase():
    waits_ns, _, statistics = play(jitter(50, 0), kind=Silent, first_ns=19 * MS)
    assert np.ptp(waits_ns) == 0
    assert not statistics.first_pulse.count
