"""The exact bytes that the driver writes to a 61-electrode kit, and when it writes them."""

import threading
from dataclasses import replace

import numpy as np
import pytest

from smarttouch.base.errors import BoardError
from smarttouch.boards.board import Board
from smarttouch.boards.kits.kajimoto61 import Kajimoto61Driver
from smarttouch.profile.profile_tables import Output
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

from ..support.checks import raises
from .emulator_waits import deliver

ZERO = bytes([0xFF]) + bytes(61)
LIMITS = SafetyLimits(61, 5.0, 200, 0.5, 200, 0.8, 0.5, 4.0)


def kajimoto(limits=LIMITS, output=None, driver=Kajimoto61Driver, **options):
    """Return a board whose gate uses the times stated in sequences."""
    return Board(driver("x", limits, output), limits, output, claimed_time=True, **options)


def anodic(levels_ua, step=1, period_us=20_000, width=50, discharge=150, sign=-1):
    """Return one slot for each electrode of ``levels_ua``; all others share the return current."""
    site = np.array(sorted(levels_ua), np.uint16)
    current = np.zeros((len(site), 61), np.int16)
    for row, electrode in zip(current, site, strict=True):
        level = levels_ua[int(electrode)]
        row[:] = level // 60
        row[electrode] = 0
        row[electrode] = -row.sum()
    column = np.ones(len(site), np.uint16)
    return ScanSequence(
        -sign * current, column * width, column * discharge, site, period_us,
        float(bool(levels_ua)), step * 10**9,
    )  # fmt: skip


def packet(**intensities):
    data = bytearray(ZERO)
    for electrode, value in intensities.items():
        data[1 + int(electrode[1:])] = value
    return bytes(data)


def test_zero_first_scans_between_zero_last(port):
    with kajimoto() as board:
        # A step is 39.0625 µA: 1,020 µA are 26.1 steps, 3,900 µA are 99.84.
        deliver(board, anodic({}, 0), anodic({0: 1020, 60: 3900}))
        report = board.report()
    assert port.packets() == [ZERO, packet(e0=26, e60=100)]
    assert (report.sequences, report.slots, report.by) == (2, 2, "host")
    assert report.max_current_ma == pytest.approx(3.9)
    assert board.acknowledged == 2


def test_what_a_broken_line_may_have_carried_counts_as_a_range(port, monkeypatch):
    with kajimoto() as board:
        deliver(board, anodic({}, 0), anodic({0: 1020}))

        def broken(data, proved=None):
            if proved is not None:
                raise board._line.lost("broke")
            write(data)

        write = board._line.write
        monkeypatch.setattr(board._line, "write", broken)
        deliver(board, anodic({0: 1020, 60: 3900}, 2))
        report = board.report()
    assert (report.sequences, report.slots) == (3, 1)
    assert (report.pulses, report.most_pulses) == (61, 3 * 61)


@pytest.mark.parametrize(("sequence", "attributes"), [
    (anodic({3: 1000}, sign=1), {"slot": 0}),
    (anodic({3: 1000}, width=100), {"value": (100, 150)}),
    (anodic({3: 1000}, discharge=200), {"value": (50, 200)}),
    (anodic(dict.fromkeys(range(61), 1000), period_us=13_000),
     {"value": 13_000}),
    (replace(anodic({3: 1000}), current_ua=np.int16([[-500] * 2 + [500] * 2 + [0] * 57])),
     {"slot": 0}),
])  # fmt: skip
def test_what_it_cannot_do_is_refused_and_never_sent(port, sequence, attributes):
    with kajimoto() as board:
        deliver(board, anodic({}, 0))
        deliver(board, sequence)
        with raises(BoardError, **attributes):
            board.send(anodic({}, 2))
    assert not b"".join(port.packets()).strip(b"\xff\0")


def test_a_board_that_answers_a_pattern_is_another(port):
    port.incoming += b"\x10\x02" * 4
    with raises(BoardError, names="board"):
        # The reply arrives before the pattern is sent. Keep it: `open` would discard early input.
        board = kajimoto()
        board._line.discard_input = lambda: None
        board.open()


def test_another_profile_is_refused():
    with raises(BoardError, names="electrodes", value=64, allowed=61):
        kajimoto(SafetyLimits(64, 5.0, 200, 0.5, 200, 0.8, 0.5, 4.0))
    with raises(BoardError, value="weighted", allowed="one-against-all"):
        kajimoto(LIMITS, Output(kind="weighted"))
    with raises(BoardError, names="output.wiring"):
        kajimoto(LIMITS, Output(kind="one-against-all", wiring=tuple(range(61))))


class StillClock:
    """Simulated clock that records each deadline, and jumps there when the test releases `gate`."""

    def __init__(self):
        self.time_ns, self.deadlines = 0, []
        self.gate = threading.Semaphore(0)

    def now_ns(self):
        return self.time_ns

    def wait_until(self, deadline_ns, stop):
        self.deadlines.append(deadline_ns)
        while not self.gate.acquire(timeout=0.01):
            if stop.is_set():
                return
        self.time_ns = max(self.time_ns, deadline_ns)


def test_packets_leave_on_a_grid_and_the_newest_wins(port):
    # All packets carry zero current: only their times and number matter here.
    clock = StillClock()
    with kajimoto(clock=clock) as board:
        for step in range(3):
            board.send(anodic({}, step))
        clock.gate.release()
        board.drain()
        # The third sequence has replaced the first two before their deadline.
        assert (board.acknowledged, board.replaced) == (1, 2)
        board.send(anodic({}, 4), times=3)
        for _ in range(3):
            clock.gate.release()
        board.drain()
        assert board.acknowledged == 2
        assert board.report().sequences == 2
    first = clock.deadlines[0]
    assert clock.deadlines[:4] == [first + each * 20_000_000 for each in range(4)]
    assert port.packets() == [ZERO] * 4


@pytest.mark.parametrize(("late_ms", "notes"), [
    (9, []), (49, ["this computer was too slow: 2 sequences were skipped"]),
])  # fmt: skip
def test_a_packet_that_left_late_is_not_made_up_for(port, late_ms, notes):
    """After a delay, packets keep the proved rate; the driver does not send faster to catch up."""

    class Late(StillClock):
        def wait_until(self, deadline_ns, stop):
            super().wait_until(deadline_ns, stop)
            sent.append(self.time_ns)
            if len(sent) == 2:
                self.time_ns += late_ms * 1_000_000
                sent[-1] = self.time_ns

    sent = []
    clock = Late()
    with kajimoto(clock=clock) as board:
        for _ in range(5):
            clock.gate.release()
        deliver(board, anodic({}, 0), times=5)
        assert board.notes == notes
    assert port.packets() == [ZERO] * 5
    steps_ms = [20 + late_ms, 19, 20, 20]
    assert np.diff(sent[:5]).tolist() == [each * 1_000_000 for each in steps_ms]
