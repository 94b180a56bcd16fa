"""A sequence more than 100 ms late never reaches a board, and the next begins at zero."""

import threading

import numpy as np
import pytest

from smarttouch.base.clock import LATE_NS
from smarttouch.base.errors import SafetyError, SequenceLateError
from smarttouch.boards.kits.kajimoto61 import Kajimoto61Board
from smarttouch.boards.open import MemoryBoard
from smarttouch.boards.probe_scans import one_each
from smarttouch.emulator.emulated_boards import EmulatorBoard
from smarttouch.stimulation.safety_gate import Rise, SafetyLimits

from .fresh import deliver
from .manual_kit import ManualKit

HOUR_NS = 3600 * 10**9


class ManualClock:
    """Time that passes when it is set; waits are over at once."""

    def __init__(self, time_ns=10**12):
        self.time_ns = time_ns
        self.waited = threading.Event()

    def now_ns(self):
        return self.time_ns

    def wait_until(self, deadline_ns, stop):
        self.time_ns = max(self.time_ns, deadline_ns)
        self.waited.set()


class Felt(MemoryBoard):
    """As if a finger were on it: where none is, and time is what is claimed, nothing is late."""

    on_a_finger = True
    # Counts as one of ours: drivers of others keep the machine's clock.
    __module__ = MemoryBoard.__module__


def limits(electrodes):
    return SafetyLimits(electrodes, 5.0, 200, 0.5, 200, 0.8, 0.5, 4.0)


def pulses(electrodes, step, level_ua=1000):
    """One anodic slot; the first of a run is silent, and each is a second after the last."""
    return one_each(
        limits(electrodes), level_ua * (step > 0), 50, float(step > 0), step * 10**9,
        cathodic=False, sites=[1], discharge_us=150, period_us=20_000,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "late_ns", "sent"),
    [
        (Felt, 0, 2), (Felt, LATE_NS, 2), (Felt, LATE_NS + 1, 1),
        # Same seed, same sequences: also where the computer stood still in between.
        (MemoryBoard, HOUR_NS, 2),
    ],
)  # fmt: skip
def test_a_tenth_of_a_second_is_the_limit(kind, late_ns, sent):
    board = kind("", limits(8))
    board._clock = ManualClock()
    with board:
        board.send(pulses(8, 0))
        due_ns = board.clock.time_ns
        board.clock.time_ns += late_ns
        if sent == 2:
            board.send(pulses(8, 1), due_ns=due_ns)
        else:
            with pytest.raises(SequenceLateError):
                board.send(pulses(8, 1), due_ns=due_ns)
    assert (len(board.sequences), board.dropped_late) == (sent, 2 - sent)


@pytest.mark.parametrize("pause_ns", [3 * LATE_NS, HOUR_NS])
def test_after_a_pause_it_begins_at_zero(pause_ns):
    """Also after an hour of sleep: the clock runs on while the machine is suspended."""
    board = Felt("", limits(8))
    board._clock = ManualClock()
    with board:
        board.send(pulses(8, 0))
        board.send(pulses(8, 1))
        due_ns = board.clock.time_ns
        board.clock.time_ns += pause_ns
        with pytest.raises(SequenceLateError):
            board.send(pulses(8, 2), due_ns=due_ns)
        with pytest.raises(SafetyError):
            board.send(pulses(8, 3))
        board.send(one_each(limits(8), 0, 50, 0.0, 4 * 10**9, cathodic=False))
        board.send(pulses(8, 5))
    assert [sequence.intensity for sequence in board.sequences] == [0, 1, 0, 1]
    assert board.dropped_late == 1


KAJIMOTO_ZERO = bytes([0xFF]) + bytes(61)
KAJIMOTO_OPEN = [(bytes(61), b""), (KAJIMOTO_ZERO, b"")]


class PausesBeforeTheSecondPacket(ManualClock):
    """The computer stands still while the sender waits for the second packet's time."""

    waits = 0

    def wait_until(self, deadline_ns, stop):
        super().wait_until(deadline_ns, stop)
        self.waits += 1
        if self.waits == 2:
            self.time_ns += 3 * LATE_NS


@pytest.mark.parametrize("times", [1, 5])
def test_a_packet_whose_time_has_passed_is_not_written(script, times):
    # Two silent packets, and not one of the pulses between them.
    script(*KAJIMOTO_OPEN, (KAJIMOTO_ZERO, b""), (KAJIMOTO_ZERO, b""), *KAJIMOTO_OPEN)
    board = Kajimoto61Board("x", limits(61))
    board._clock = PausesBeforeTheSecondPacket()
    with board:
        deliver(board, pulses(61, 0))
        deliver(board, pulses(61, 1), times=times)
        assert (board.acknowledged, board.dropped_late) == (1, 1)
        with pytest.raises(SequenceLateError):
            board.send(pulses(61, 2))
        with pytest.raises(SafetyError):
            board.send(pulses(61, 3))
        deliver(board, one_each(limits(61), 0, 50, 0.0, 4 * 10**9, cathodic=False))
        assert board.acknowledged == 2
    assert board.report().pulses == 0


def test_a_job_that_waited_through_a_pause_is_not_sent(script):
    """The pause comes before the sender has even looked at it."""
    script(*KAJIMOTO_OPEN, *KAJIMOTO_OPEN)
    clock = ManualClock()
    board = Kajimoto61Board("x", limits(61))
    board._clock = clock
    with board:
        with board._news:
            board._waiting = None
            board.send(pulses(61, 0))
            clock.time_ns += LATE_NS + 1
        board.drain()
        assert (board.acknowledged, board.dropped_late) == (0, 1)


LATE_RISE = [(20, True), (60, True), (100, True), (180, False)]
"""Milliseconds of the ramp that a sequence is ahead of what was written, and whether it goes."""


def rising(electrodes, part, step):
    """One anodic slot at a part of full intensity, after the silent first."""
    return one_each(
        limits(electrodes), round(4000 * part), 50, part, step * 10**9,
        cathodic=False, sites=[1], discharge_us=150, period_us=20_000,
    )  # fmt: skip


@pytest.fixture
def rise_of_the_line(monkeypatch):
    """Return a setter of a board's ramp by the clock of its line, as outside these tests."""

    def set_rise(board, ramp_ns):
        monkeypatch.setattr("smarttouch.stimulation.safety_gate.LATE_NS", LATE_NS)
        board._rise = Rise(ramp_ns)

    return set_rise


@pytest.mark.parametrize(("ahead_ms", "sent"), LATE_RISE)
def test_the_rise_is_counted_from_what_was_written(script, rise_of_the_line, ahead_ms, sent):
    """Though both were proved, and neither is late: the first one's delay adds nothing."""
    part = ahead_ms / 1000 / limits(61).ramp_s
    board = Kajimoto61Board("x", limits(61))
    board._clock = ManualClock()
    rise_of_the_line(board, limits(61).ramp_ns)
    packets = [(board._encode(rising(61, part, 1)), b"")] * sent
    script(*KAJIMOTO_OPEN, (KAJIMOTO_ZERO, b""), *packets, *KAJIMOTO_OPEN)
    with board:
        deliver(board, pulses(61, 0), rising(61, part, 1))
        assert (board.acknowledged, board.dropped_late) == (1 + sent, 1 - sent)


@pytest.mark.parametrize(("ahead_ms", "sent"), LATE_RISE)
def test_a_link_board_rises_from_what_was_written(rise_of_the_line, ahead_ms, sent):
    with EmulatorBoard("", limits(8)) as board:
        board._clock = ManualClock()
        rise_of_the_line(board, limits(8).ramp_ns)
        deliver(board, pulses(8, 0))
        # Nor does it matter how late the first went.
        fast = rising(8, ahead_ms / 1000 / limits(8).ramp_s, 1)
        if sent:
            deliver(board, fast)
        else:
            with pytest.raises(SequenceLateError):
                board.send(fast)
        assert board.dropped_late == 1 - sent


@pytest.mark.parametrize(("late_ns", "scans"), [(0, 5), (LATE_NS, 5), (LATE_NS + 1, 0)])
def test_a_pattern_whose_time_has_passed_is_not_let_through(monkeypatch, late_ns, scans):
    kit = ManualKit(monkeypatch, limits(4))
    kit.late_ns = late_ns
    # A pause before each: what waits for its turn behind another is not late.
    begin_ns = kit.clock.time_ns
    jobs = [(begin_ns + (step + 1) * 10**9, pulses(4, 1, 999), 1) for step in range(5)]
    kit.run(jobs)
    assert len(kit.scans()) == scans
    assert kit.driver.dropped_late == 5 * (scans == 0)


class PausesAfter(ManualClock):
    """The computer stands still after so many looks at the clock."""

    def __init__(self, looks):
        super().__init__()
        self.looks = looks

    def now_ns(self):
        self.looks -= 1
        if self.looks == 0:
            self.time_ns += 3 * LATE_NS
        return self.time_ns


@pytest.mark.parametrize("looks", [1, 2, 3])
def test_a_link_board_gets_no_byte_of_what_is_late(looks):
    """Whenever the pause comes: the last look is directly before the bytes."""
    with EmulatorBoard("", limits(8)) as board:
        deliver(board, pulses(8, 0))
        due_ns = board.clock.now_ns()
        board._clock = PausesAfter(looks)
        board.clock.time_ns = due_ns
        with pytest.raises(SequenceLateError):
            board.send(pulses(8, 1), due_ns=due_ns)
        assert board.dropped_late == 1
        board._clock = ManualClock()
        deliver(board, one_each(limits(8), 0, 50, 0.0, 4 * 10**9, cathodic=False))
        report = board.report()
    assert (report.sequences, report.pulses) == (2, 0)
    assert np.isfinite(report.max_charge_uc)


def test_what_got_lost_is_sent_again_only_while_there_is_time():
    with EmulatorBoard("", limits(8)) as board:
        board._clock = ManualClock()
        written = []

        def send(_kind, number, payload, *, latest_ns, now_ns):
            return now_ns() <= latest_ns and not written.append((number, payload))

        board._line.send = send
        board._in_flight[7], board._in_flight_due_ns = (b"packet", 0), board.clock.time_ns
        board._send_again()
        assert written == [(7, b"packet")]
        board.clock.time_ns += LATE_NS + 1
        board._again_s = 0.0
        board._send_again()
        assert written == [(7, b"packet")]
        board._in_flight.clear()
        del board._line.send
