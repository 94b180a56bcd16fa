"""What makes a board drive leaves by one way, which a stop closes: sending and measuring alike."""

import threading

import pytest

from smarttouch.base.errors import BoardClosedError, BoardStoppedError
from smarttouch.boards.board import Board
from smarttouch.boards.link.protocol import MessageKind
from smarttouch.boards.open import MemoryDriver, make_board

from ..raising import raises

pytestmark = pytest.mark.usefixtures("patient_boards")

STOPS = {"stop": lambda board: board.stop(), "halt": lambda board: board.halt()}


@pytest.fixture
def board(make_limits):
    return make_board("emulator:", make_limits())


@pytest.mark.parametrize("how", STOPS)
def test_a_board_that_was_stopped_neither_sends_nor_measures(board, how, make_sequence):
    with board:
        board.send(make_sequence(0))
        STOPS[how](board)
        for act in (board.measure, lambda: board.send(make_sequence(1))):
            with pytest.raises(BoardStoppedError):
                act()


def test_a_board_that_is_closed_does_not_measure(board):
    with raises(BoardClosedError, names="board"):
        board.measure()


def test_a_sequence_that_meets_a_stop_on_its_way_is_not_written(
    monkeypatch, make_limits, make_sequence
):
    with make_board("emulator:", make_limits()) as board:
        board.send(make_sequence(0))
        packets = board.driver._packets
        kinds, write = [], packets.send

        def told(kind, *rest, **named):
            write(kind, *rest, **named)
            kinds.append(kind)

        monkeypatch.setattr(packets, "send", told)
        wait = board.driver._wait_for_room

        def stopped_meanwhile():
            wait()
            stop_elsewhere(board)

        monkeypatch.setattr(board.driver, "_wait_for_room", stopped_meanwhile)
        with pytest.raises(BoardStoppedError):
            board.send(make_sequence(1))
        assert MessageKind.STOP in kinds
        assert MessageKind.SEQUENCE not in kinds


def stop_elsewhere(board):
    """Stop a board from another thread, and wait until it is."""
    thread = threading.Thread(target=board.stop, daemon=True)
    thread.start()
    thread.join(20)
    assert not thread.is_alive()


class Noting(MemoryDriver):
    """A driver that notes what flows, and what it does just before that."""

    def __init__(self, before, *given):
        super().__init__(*given)
        self.before, self.did = before, []

    def write(self, proved):
        with self._line.current(proved):
            self.before()
            self.did.append("current")

    def zero(self):
        self.did.append("zero")


def noting(before, limits):
    return Board(Noting(before, "", limits), limits, on_a_finger=False, claimed_time=True)


@pytest.mark.parametrize("long", [False, True])
def test_a_write_that_meets_a_stop_is_over_before_zero_or_followed_by_it(
    monkeypatch, make_limits, make_sequence, long
):
    """As of a driver that was never made for that, with a line that takes its time."""
    if long:
        monkeypatch.setattr("smarttouch.boards.line.WRITE_S", 0.05)
    writing, goes_on = threading.Event(), threading.Event()

    def wait():
        writing.set()
        goes_on.wait(20)

    with noting(wait, make_limits()) as board:
        sender = threading.Thread(target=board.send, args=(make_sequence(0),), daemon=True)
        stopper = threading.Thread(target=board.stop, daemon=True)
        sender.start()
        assert writing.wait(20)
        stopper.start()
        assert board._stopped.wait(20)
        if long:
            stopper.join(20)
        goes_on.set()
        for each in (sender, stopper):
            each.join(20)
        assert board.driver.did == (["zero", "current", "zero"] if long else ["current", "zero"])
