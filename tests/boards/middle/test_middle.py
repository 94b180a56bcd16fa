"""Someone sits on the line of a ``link`` board and repeats, delays, mixes and breaks packets.

Host and firmware are driven in one thread, on a clock that is told, frame by frame.
``pytest tests/boards/middle/test_middle.py --runs 3000 --timeout 0 -s`` for the long run, and
figures.
"""

from collections import Counter

import numpy as np
import pytest

from smarttouch.base.errors import BoardError, EmergencyStopError, LineLostError
from smarttouch.boards.link import ALIVE_MS, LATE_MS, SILENCE_MS
from smarttouch.stimulation.scan_sequence import ScanSequence

from .conftest import write

RUNS = 40
RUNS_PER_BOARD = 20


class Host:
    """Asks for sequences of which no two are alike, and remembers for what."""

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
    """Let one host come, ask and go; return it and when it was gone."""
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
        if ending == "hoarded":
            host.send(2000)
            world.to_board.hoard = []
            haunt(world, ending, 900)
    except BoardError:
        world.given_up += 1
    world.host, gone_ns = None, world.now_ns
    # What is still on its way is lost with the host.
    world.to_board.due = [each for each in world.to_board.due if each[0] <= world.now_ns]
    board._close_driver()
    return host, gone_ns


def haunt(world, ending, time_ms):
    """Play what was sent before, or let through what was kept back, one frame now and then."""
    arrived = [each for each in world.to_board.record if world.heard.knows(each)]
    for passed_ms in range(time_ms):
        frame = b""
        if ending == "hoarded" and passed_ms % 80 == 0 and world.to_board.hoard:
            frame = world.to_board.hoard.pop(0)
        elif ending == "replayed" and passed_ms % 7 == 0:
            frame = world.to_board.old(arrived)
        if frame:
            world.to_board.due.append((world.now_ns, frame))
        world.step()
    world.to_board.hoard = None if world.host is None else world.to_board.hoard


def check(world, host, gone_ns, ending):
    books = world.books
    assert (books.unsafe, books.violations) == (0, 0)
    flowed = Counter((number, current) for number, current, _ in books.kept)
    for (number, current), pulses in flowed.items():
        assert current in host.asked, "what this host never asked for flowed"
        wanted, times = host.asked[current]
        assert number == wanted
        assert pulses <= 2 * times
    order = [number for number, _, _ in books.kept]
    assert order == sorted(order), "an old sequence flowed after a newer one"
    assert books.state == "shorted"
    # What is kept back is fresh until its sender would have heard from the board again.
    late_ms = SILENCE_MS + 1 + (LATE_MS + ALIVE_MS if ending == "hoarded" else 0)
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
        # Of this board's sessions, and of another board's of the same kind.
        world.to_board.foreign, world.to_host.foreign = (each[-400:] for each in foreign)
        ending = world.random.choice(["stop", "silent", "replayed", "hoarded"])
        host, gone_ns = one_run(world, ending)
        haunt(world, ending, 1500)
        check(world, host, gone_ns, ending)
        foreign[0].extend(world.to_board.record)
        foreign[1].extend(world.to_host.record)
        if seed % RUNS_PER_BOARD == RUNS_PER_BOARD - 1 or seed == runs - 1:
            for middle in (world.to_board, world.to_host):
                faults.update(middle.counts)
                middle.share = 0.0
            # HELLOs that led to nothing are counted when the next host begins.
            Host(world).board.open()
            assert world.refused() >= world.replayed["board"]
            totals.update(world.replayed)
            totals.update(slots=world.books.slots, refused=world.refused(), faults=world.given_up)
    print(
        f"\n{runs} runs, {Host.asked_ever - asked} sequences asked for, {totals['slots']} slots: "
        "0 unsafe, 0 unasked, 0 old delivered; old frames that reached the board "
        f"{totals['board']}, refused by it {totals['refused']}; that reached the host, all "
        f"counted, {totals['host']}; "
        f"faults {dict(faults)}, hosts that gave up {totals['faults']}"
    )
    assert totals["slots"] > 10 * runs
    assert totals["board"] > 10 * runs
    assert totals["host"] > runs


def test_the_emergency_switch_opened_at_random(make_world, runs):
    """Whatever the line does, nothing flows from then on, and closing it begins nothing."""
    runs = runs or RUNS
    while_flowing = reported = 0
    for seed in range(runs):
        world = make_world(seed)
        world.opens_ns = world.random.randrange(20, 600) * 1_000_000
        ending = world.random.choice(["stop", "silent", "replayed", "hoarded"])
        host, gone_ns = one_run(world, ending)
        haunt(world, ending, 1500)
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
    print(f"{reported} hosts ended by it")
    assert while_flowing > runs // 10
    assert reported > runs // 10
