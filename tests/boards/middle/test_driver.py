"""The driver of a ``link`` board survives answers that are lost, repeated or nobody's."""

import numpy as np
import pytest
from cobs import cobs

from smarttouch.base.errors import BoardError, EmergencyStopError, LineLostError
from smarttouch.base.wire.framing import frame_packet
from smarttouch.boards import link as protocol
from smarttouch.boards.link import MessageKind, encode_volts
from smarttouch.stimulation.scan_sequence import ScanSequence

from ...support.checks import raises
from .conftest import write


def sequence():
    current, column = np.array([[300, -100, -100, -100]], np.int16), np.full(1, 100, np.uint16)
    return ScanSequence(current, column, column, column * 0, 10_000, 1.0, 0)


def send(board, count=1):
    for _ in range(count):
        write(board, sequence())
    board.drain()


@pytest.fixture
def world(make_world):
    return make_world(1)


@pytest.fixture
def board(world):
    board = world.make_board()
    board.open()
    return board


def lose(world, direction, kind):
    """Let the next packet of a kind be lost."""
    middle = getattr(world, direction)
    pass_on = middle.pass_on

    def swallow(frame, now_ns):
        if cobs.decode(frame[:-1])[1] == kind:
            middle.pass_on = pass_on
        else:
            pass_on(frame, now_ns)

    middle.pass_on = swallow


@pytest.mark.parametrize("lost", [("to_host", MessageKind.ACK), ("to_board", MessageKind.SEQUENCE)])
def test_a_lost_packet_is_made_up_for_without_delivering_twice(world, board, lost):
    lose(world, *lost)
    for _ in range(3):
        send(board)
    assert (board.acknowledged, world.books.slots) == (3, 3)
    assert (board.driver.refused_packets, board.report().refused_packets) == (0, 0)


def test_starts_are_by_the_boards_clock_however_late_an_answer_comes(world, board):
    send(board)
    lose(world, "to_host", MessageKind.ACK)
    send(board, 2)
    starts = [board.start_of(number) for number in (1, 2, 3)]
    assert [each.board_us for each in starts] == [time_us for _, _, time_us in world.books.kept]
    (delay_ns,) = {each.time_ns - 1000 * each.board_us for each in starts}
    assert 0 <= delay_ns <= 2_000_000
    assert board.start_of(4) is None


@pytest.mark.parametrize("slow", [True, False])
def test_the_cause_of_a_silent_host_is_named(world, board, slow):
    write(board, sequence(), 1000)
    world.wait(5)
    host, pass_on = world.host, world.to_board.pass_on
    if slow:
        world.host = None
    else:
        world.to_board.pass_on = lambda *_: None
    world.wait(protocol.SILENCE_MS + 5)
    world.host, world.to_board.pass_on = host, pass_on
    with raises(LineLostError) as error:
        for _ in range(3):
            write(board, sequence())
            world.wait(20)
    assert ("too slow" in str(error.value)) == slow


def say(world, kind, about, payload=b""):
    """Let the board say what it has no reason to say."""
    world.answer(world.firmware._session.encode(kind, about, payload))
    world.wait(2)


@pytest.mark.parametrize(("kind", "payload"), [
    (MessageKind.ACK, b""),
    (MessageKind.ACK, bytes(8)),
    (MessageKind.NAK, b"\x03too much"),
    (MessageKind.NAK, b""),
    (MessageKind.VOLTAGES, encode_volts(np.ones(1))),
    (MessageKind.REPORT, bytes(protocol.REPORT.size)),
    (MessageKind.STOPPED, b""),
    (MessageKind.HEARTBEAT, b""),
    (0x99, b""),
])  # fmt: skip
def test_what_answers_nothing_is_counted_and_has_no_effect(world, board, kind, payload):
    send(board)
    say(world, kind, 77, payload)
    assert (board.driver.refused_packets, board.acknowledged, board.refused) == (1, 1, 0)
    assert board.take_volts()[1:] == []
    send(board)
    assert world.books.slots == 2


def test_a_second_acknowledgment_is_counted_unless_it_was_sent_twice(world, board):
    lose(world, "to_host", MessageKind.ACK)
    send(board, 2)
    say(world, MessageKind.ACK, 1, bytes(8))
    assert (board.driver.refused_packets, board.acknowledged) == (0, 2)
    say(world, MessageKind.ACK, 2, bytes(8))
    assert (board.driver.refused_packets, board.acknowledged) == (1, 2)


def test_what_the_board_refused_before_is_not_of_this_run(world, board):
    for _ in range(3):
        world.to_board.due.append((world.now_ns, b"\0" + world.to_board.record[0]))
        world.wait(2)
    assert board.report().refused_packets == 3
    board.close()
    board.open()
    assert board.report().refused_packets == 0
    assert world.refused() == 3


def test_a_board_of_another_version_is_reported_in_a_sentence(world, monkeypatch):
    def old_board(data, now_ns):
        return frame_packet(2, MessageKind.CAPABILITIES, 0, bytes(14)) if b"\x01" in data else b""

    monkeypatch.setattr(world.firmware, "feed", old_board)
    monkeypatch.setattr(world.firmware, "advance", lambda now_ns: b"")
    monkeypatch.setattr(world, "answer", lambda data: world.to_host.due.append((0, data)))
    with raises(BoardError, names="version", value=2, allowed=protocol.VERSION):
        world.make_board().open()


def test_a_board_that_is_lost_ends_its_session_before_the_next(world, board):
    lose(world, "to_host", MessageKind.ACK)
    write(board, sequence(), 1000)
    before = board.driver._session.number
    board._recover(board._line.lost("is gone"))
    assert board.driver._session.number != before
    assert world.refused() == 0
    send(board)
    assert board.report().refused_packets == 0


def test_an_emergency_switch_ends_the_run_and_keeps_the_board_shut(world, board):
    write(board, sequence(), 2000)
    world.wait(30)
    world.firmware.switch_open = True
    slots = world.books.slots
    world.wait(protocol.ALIVE_MS + 2)
    for _ in range(2):
        with raises(EmergencyStopError, names="board"):
            write(board, sequence())
    with raises(EmergencyStopError, names="board"):
        world.make_board().open()
    world.firmware.switch_open = False
    world.wait(50)
    with raises(EmergencyStopError, names="board"):
        write(board, sequence())
    assert world.books.slots == slots
