"""A sequence that is over 100 ms late never reaches a board; the next must have zero intensity."""

import threading
from dataclasses import replace

import pytest

from smarttouch.base.clock import LATE_NS
from smarttouch.base.errors import BoardRestartedError, SafetyError, SequenceLateError
from smarttouch.boards.board import Board
from smarttouch.boards.kits.kajimoto61 import Kajimoto61Driver
from smarttouch.boards.link import MessageKind
from smarttouch.boards.open import make_board
from smarttouch.emulator.drivers import MemoryDriver
from smarttouch.stimulation.safety_gate import SafetyLimits

from ..support.scans import one_each
from .emulator_waits import deliver, until
from .simulated_time_kit import ManualClock

HOUR_NS = 3600 * 10**9
ZERO = bytes([0xFF]) + bytes(61)
"""Packet without current for a 61-electrode kit."""


def limits(electrodes):
    return SafetyLimits(electrodes, 5.0, 200, 0.5, 200, 0.8, 0.5, 4.0)


def pulses(electrodes, step, level_ua=1000):
    """Return one anodic slot; step 0 has zero intensity, and steps are one second apart."""
    return one_each(
        limits(electrodes), level_ua * (step > 0), 50, float(step > 0), step * 10**9,
        cathodic=False, sites=[1], discharge_us=150, period_us=20_000,
    )  # fmt: skip


def board_of(kind, electrodes, rest="x", **options):
    """Return a board, by default on a finger. A simulated clock decides which sequence is late."""
    driver = kind(rest, limits(electrodes))
    usual = {"clock": ManualClock(late_us=0), "claimed_time": True}
    return Board(driver, limits(electrodes), **(usual | options))


@pytest.mark.parametrize(
    ("on_a_finger", "late_ns", "sent"),
    [
        (True, 0, 2), (True, LATE_NS, 2), (True, LATE_NS + 1, 1),
        # Without a finger, no sequence is dropped, so that runs with the same seed stay equal.
        (False, HOUR_NS, 2),
    ],
)  # fmt: skip
def test_a_tenth_of_a_second_is_the_limit(on_a_finger, late_ns, sent):
    board = board_of(MemoryDriver, 8, "", on_a_finger=on_a_finger)
    with board:
        board.send(pulses(8, 0))
        due_ns = board.clock.time_ns
        board.clock.time_ns += late_ns
        if sent == 2:
            board.send(pulses(8, 1), due_ns=due_ns)
        else:
            with pytest.raises(SequenceLateError):
                board.send(pulses(8, 1), due_ns=due_ns)
    assert (len(board.driver.sequences), board.dropped_late) == (sent, 2 - sent)


class StandsStill(MemoryDriver):
    """Driver without a port, which simulates a pause of the computer within `write`."""

    clock = None

    def write(self, proved):
        if self.clock is not None:
            self.clock.time_ns += LATE_NS + 1
        super().write(proved)


def test_a_driver_without_a_port_writes_nothing_that_is_late():
    board = board_of(StandsStill, 8, "")
    with board:
        board.send(pulses(8, 0))
        board.driver.clock = board.clock
        with pytest.raises(SequenceLateError):
            board.send(pulses(8, 1))
    assert len(board.driver.sequences) == 1


@pytest.mark.parametrize("pause_ns", [3 * LATE_NS, HOUR_NS])
def test_after_a_pause_it_begins_at_zero(pause_ns):
    """An hour of suspend counts as a pause, because the clock runs on during suspend."""
    board = board_of(MemoryDriver, 8, "")
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
    assert [sequence.intensity for sequence in board.driver.sequences] == [0, 1, 0, 1]
    assert board.dropped_late == 1


class PausesBeforeTheSecondPacket(ManualClock):
    """Simulated clock that pauses the computer while the sender waits for the second packet."""

    waits = 0

    def wait_until(self, deadline_ns, stop):
        super().wait_until(deadline_ns, stop)
        self.waits += 1
        if self.waits == 2:
            self.time_ns += 3 * LATE_NS


@pytest.mark.parametrize("times", [1, 5])
def test_a_packet_whose_time_has_passed_is_not_written(port, times):
    with board_of(Kajimoto61Driver, 61, clock=PausesBeforeTheSecondPacket(late_us=0)) as board:
        deliver(board, pulses(61, 0))
        deliver(board, pulses(61, 1), times=times)
        assert (board.acknowledged, board.dropped_late) == (1, 1)
        with pytest.raises(SequenceLateError):
            board.send(pulses(61, 2))
        with pytest.raises(SafetyError):
            board.send(pulses(61, 3))
        deliver(board, one_each(limits(61), 0, 50, 0.0, 4 * 10**9, cathodic=False))
        assert board.acknowledged == 2
    # Only the two packets without current were written.
    assert port.packets() == [ZERO] * 2
    assert board.report().pulses == 0


def test_what_waits_while_the_level_is_closed_is_not_sent(port):
    """The ramp is checked again at the write, so a proof from before `close_level` is void."""
    with board_of(Kajimoto61Driver, 61) as board:
        deliver(board, pulses(61, 0))
        with board._news:
            board.send(pulses(61, 1))
            board.close_level()
        board.drain()
        assert (board.acknowledged, board.dropped_late) == (1, 1)
    assert port.packets() == [ZERO]


def test_what_got_lost_is_sent_again_only_while_there_is_time(monkeypatch):
    written, clock, driver = [], ManualClock(late_us=0), make_board("emulator:", limits(8)).driver
    # By default the board is on a finger, so it drops late sequences.
    with Board(driver, limits(8), clock=clock, claimed_time=True) as board:
        deliver(board, pulses(8, 0))
        packets, again = board.driver._session, []
        send = packets.send

        def told(kind, about=0, payload=b"", **more):
            again.append(kind)
            send(kind, about, payload, **more)
            if kind == MessageKind.SEQUENCE:
                written.append(about)

        with monkeypatch.context() as patch:
            # All answers are lost, so that the driver sends the sequence again and again.
            patch.setattr(packets, "take", lambda data: 1)
            patch.setattr(packets, "send", told)
            board.send(pulses(8, 1))
            until(lambda: len(written) > 1)
            clock.time_ns += LATE_NS + 1
            tried = again.count(MessageKind.SEQUENCE)
            before = len(written)
            until(lambda: again.count(MessageKind.SEQUENCE) > tried + 1)
            assert len(written) <= before + 1


class Lost(MemoryDriver):
    """Driver that reports a sequence as late, and loses its line right afterwards."""

    opened = 0

    def open(self, line, limits):
        self.opened += 1
        self.was_late = threading.Event()
        return replace(super().open(line, limits), host_timed=True)

    def write(self, proved):
        self.was_late.set()
        raise self._line.late()

    def idle(self):
        if self.was_late.is_set() and self.opened == 1:
            raise self._line.lost("was pulled out")
        return 0.01


def test_a_line_that_is_lost_after_a_late_sequence_is_connected_again():
    with board_of(Lost, 8, "") as board:
        board.send(pulses(8, 0))
        assert until(lambda: board._is_lost)
        with pytest.raises(BoardRestartedError):
            board.send(pulses(8, 1))
        assert board.driver.opened == 2
