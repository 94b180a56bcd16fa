"""An attacker on the line of a ``link`` board repeats, delays, mixes and breaks packets. Its driver
also survives answers that are lost, repeated or not requested.

Host and firmware run in one thread, frame by frame, with a simulated clock.
``pytest tests/boards/attacked_line/test_attacked_line.py --runs 3000 --timeout 0 -s`` runs longer
and prints figures.
"""

from collections import Counter

import numpy as np
import pytest
from cobs import cobs

from smarttouch.base.errors import BoardError, EmergencyStopError, LineLostError
from smarttouch.base.wire.framing import frame_packet
from smarttouch.boards import link as protocol
from smarttouch.boards.link import ALIVE_MS, LATE_MS, SILENCE_MS, MessageKind
from smarttouch.emulator.link_packets import encode_volts
from smarttouch.stimulation.scan_sequence import ScanSequence

from ...support.checks import raises
from .conftest import write

RUNS = 40
RUNS_PER_BOARD = 20


class Host:
    """Host that sends sequences with unique currents, and records their number and repetitions."""

    asked_ever = 0

    def __init__(self, world):
        self.board = world.make_board()
        self.asked = {}

    def send(self, times):
        Host.asked_ever += 1
        first, second = 50 + Host.asked_ever % 1000, 50 + Host.asked_ever // 1000
        current = np.array([[first, second, -first - second, 0]] * 2, np.int16)
        column = np.full(2, 100, np.uint16)
        sequence = ScanSequence(current, column, column, column * 0, 5000, 1.0, 0)
        self.asked[tuple(current[0])] = (self.board.driver._number + 1, times)
        try:
            write(self.board, sequence, times)
        except LineLostError as lost:
            self.board._recover(lost)


def one_run(world, ending):
    """Let one host open the board, send sequences and end; return the host and its end time."""
    host = Host(world)
    board = host.board
    world.to_board.share = world.to_host.share = world.random.choice([0.03, 0.1, 0.3])
    world.to_board.record, world.to_host.record = [], []
    try:
        board.open()
        for _ in range(8):
            host.send(world.random.choice([1, 1, 3, 2000]))
            if world.random.random() < 0.5:
                world.wait(world.random.randrange(60))
        if ending == "stop":
            board.stop()
        if ending == "withheld":
            host.send(2000)
            world.to_board.withheld = []
            attack(world, ending, 900)
    except BoardError:
        world.given_up += 1
    world.host, gone_ns = None, world.now_ns
    # Frames that have not arrived yet are lost with the host.
    world.to_board.due = [each for each in world.to_board.due if each[0] <= world.now_ns]
    board._close_driver()
    return host, gone_ns


def attack(world, ending, time_ms):
    """Let time pass; now and then replay an old frame, or release a withheld one."""
    arrived = [each for each in world.to_board.record if world.heard.knows(each)]
    for passed_ms in range(time_ms):
        frame = b""
        if ending == "withheld" and passed_ms % 80 == 0 and world.to_board.withheld:
            frame = world.to_board.withheld.pop(0)
        elif ending == "replayed" and passed_ms % 7 == 0:
            frame = world.to_board.old(arrived)
        if frame:
            world.to_board.due.append((world.now_ns, frame))
        world.step()
    world.to_board.withheld = None if world.host is None else world.to_board.withheld


def check(world, host, gone_ns, ending):
    books = world.books
    assert (books.unsafe, books.violations) == (0, 0)
    flowed = Counter((number, current) for number, current, _ in books.kept)
    for (number, current), pulses in flowed.items():
        assert current in host.asked, "a current flowed that this host did not send"
        wanted, times = host.asked[current]
        assert number == wanted
        assert pulses <= 2 * times
    order = [number for number, _, _ in books.kept]
    assert order == sorted(order), "an old sequence was delivered after a newer one"
    assert books.state == "shorted"
    # The board refuses withheld frames at the latest LATE_MS after its next ALIVE.
    late_ms = SILENCE_MS + 1 + (LATE_MS + ALIVE_MS if ending == "withheld" else 0)
    last_us = max((time_us for *_, time_us in books.kept), default=0)
    assert last_us <= gone_ns / 1000 + 1000 * late_ms
    assert host.board.acknowledged <= len(host.asked)
    books.kept.clear()


def test_a_man_in_the_middle(make_world, runs):
    runs = runs or RUNS
    totals, faults, foreign = Counter(), Counter(), ([], [])
    asked = Host.asked_ever
    for seed in range(runs):
        if seed % RUNS_PER_BOARD == 0:
            world = make_world(seed)
        # The attacker can replay frames of earlier sessions, of this board and of earlier boards.
        world.to_board.foreign, world.to_host.foreign = (each[-400:] for each in foreign)
        ending = world.random.choice(["stop", "silent", "replayed", "withheld"])
        host, gone_ns = one_run(world, ending)
        attack(world, ending, 1500)
        check(world, host, gone_ns, ending)
        foreign[0].extend(world.to_board.record)
        foreign[1].extend(world.to_host.record)
        if seed % RUNS_PER_BOARD == RUNS_PER_BOARD - 1 or seed == runs - 1:
            for middle in (world.to_board, world.to_host):
                faults.update(middle.counts)
                middle.share = 0.0
            # Begin once more: the board then counts earlier HELLOs that no BEGIN followed.
            Host(world).board.open()
            assert world.refused() >= world.replayed["board"]
            totals.update(world.replayed)
            totals.update(slots=world.books.slots, refused=world.refused(), faults=world.given_up)
    print(
        f"\n{runs} runs, {Host.asked_ever - asked} sequences sent, {totals['slots']} slots "
        "delivered: none unsafe, unsent or old. "
        f"{totals['board']} old frames reached the board; the board refused {totals['refused']} "
        f"frames. {totals['host']} old frames reached the host, which counted them all. "
        f"Faults: {dict(faults)}. Hosts with an error: {totals['faults']}"
    )
    assert totals["slots"] > 10 * runs
    assert totals["board"] > 10 * runs
    assert totals["host"] > runs


def test_the_emergency_switch_opened_at_random(make_world, runs):
    """No current flows after the switch opens, nor when it closes again, whatever the line does."""
    runs = runs or RUNS
    while_flowing = reported = 0
    for seed in range(runs):
        world = make_world(seed)
        world.opens_ns = world.random.randrange(20, 600) * 1_000_000
        ending = world.random.choice(["stop", "silent", "replayed", "withheld"])
        host, gone_ns = one_run(world, ending)
        attack(world, ending, 1500)
        last_us = max((time_us for *_, time_us in world.books.kept), default=0)
        assert last_us <= world.opens_ns / 1000
        while_flowing += world.opens_ns / 1000 - last_us <= 5000
        reported += isinstance(host.board.driver._session.fault, EmergencyStopError)
        check(world, host, gone_ns, ending)
        world.to_board.share = world.to_host.share = 0.0
        with pytest.raises(EmergencyStopError):
            Host(world).board.open()
        world.opens_ns, world.firmware.switch_open = None, False
        world.wait(300)
        assert world.books.kept == []
        again = Host(world)
        again.board.open()
        again.send(1)
        world.wait(20)
        assert len(world.books.kept) == 2
    print(f"\n{runs} runs: the switch opened {while_flowing} times while current flowed, and")
    print(f"{reported} hosts ended with EmergencyStopError")
    assert while_flowing > runs // 10
    assert reported > runs // 10


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
    """Lose the next packet of a kind in one direction."""
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
    assert (board.report().refused_by_host, board.report().refused_packets) == (0, 0)


def test_starts_are_by_the_boards_clock_however_late_an_answer_comes(world, board):
    send(board)
    lose(world, "to_host", MessageKind.ACK)
    send(board, 2)
    starts = [board.start_of(number) for number in (1, 2, 3)]
    assert [board_us for _, board_us in starts] == [time_us for _, _, time_us in world.books.kept]
    (delay_ns,) = {time_ns - 1000 * board_us for time_ns, board_us in starts}
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
    """Let the board send a packet that nobody requested."""
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
    assert (board.report().refused_by_host, board.acknowledged, board.refused) == (1, 1, 0)
    assert board.take_volts()[1:] == []
    send(board)
    assert world.books.slots == 2


def test_a_second_acknowledgment_is_counted(world, board):
    lose(world, "to_host", MessageKind.ACK)
    send(board, 2)
    for refused in (1, 2):
        say(world, MessageKind.ACK, 3 - refused, bytes(8))
        assert (board.report().refused_by_host, board.acknowledged) == (refused, 2)


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
