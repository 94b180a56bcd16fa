"""Faults of a line: the driver recovers, or stops at zero with an error. If the connection is lost,
the driver accepts only the same board again. Another device at the port gets at most a query.

``pytest tests/boards/test_line_faults.py -k unsafe --runs 600 --timeout 0 -s`` runs 600 seconds
of random faults on each board, and prints figures.
"""

import contextlib
import itertools
import os
import random
import threading
import time
import tty
from collections import deque
from dataclasses import replace
from types import SimpleNamespace

import pytest

from smarttouch.base.errors import (
    BoardError,
    BoardRestartedError,
    BoardStoppedError,
    EmergencyStopError,
    LineLostError,
)
from smarttouch.base.wire.framing import Deframer
from smarttouch.boards import link as protocol
from smarttouch.boards.kits.etactilekit_protocol import zero_anywhere
from smarttouch.boards.link import Message, MessageKind, decode, encode
from smarttouch.emulator.firmware_base import read_state

from ..support.checks import assert_says, raises
from ..support.full import WHOLE, sample
from .conftest import FIRMWARES
from .emulator_waits import HANGS_S

pytestmark = pytest.mark.realtime


def once(change):
    """Return a function that changes the first piece of bytes, and passes on all later pieces."""
    left = [change]

    def pass_on(data):
        return left.pop()(data) if left else data

    return pass_on


def drop_one(data):
    middle = len(data) // 2
    return data[:middle] + data[middle + 1 :]


def double_one(data):
    middle = len(data) // 2
    return data[: middle + 1] + data[middle:]


def cut_short(data):
    return data[: len(data) // 2]


def send_on(hosted, count):
    for _ in range(count):
        hosted.send()


@pytest.fixture
def known_by_usb(monkeypatch):
    """Return a function that sets whether USB identifies the device at a path."""

    def know(path, known):
        def listed():
            # The system lists devices, not symbolic links to them.
            return [SimpleNamespace(device=str(path.resolve()), vid=1, pid=2, serial_number="3",
                                    location="1-1")] * (known and path.exists())  # fmt: skip

        monkeypatch.setattr("smarttouch.base.wire.port.list_ports.comports", listed)

    return know


ALL = pytest.mark.parametrize(
    "hosted", sample(["link", "kajimoto61", "etactilekit", *FIRMWARES]), indirect=True
)


def pulled_out_after(count, hosted):
    send_on(hosted, count)
    hosted.line.pull_out()
    send_on(hosted, 30)


# An eTactileKit cannot detect doubled bytes, but USB and TCP never double a byte.
MISHAPS = [
    *itertools.product(("link", "kajimoto61", "etactilekit"), (drop_one, cut_short)),
    ("link", double_one),
    ("kajimoto61", double_one),
    *(pytest.param(*kind.values, change, marks=kind.marks)
      for kind in FIRMWARES for change in (drop_one, cut_short, double_one)),
]  # fmt: skip


@pytest.mark.parametrize(("hosted", "change"), sample(MISHAPS, 3), indirect=["hosted"])
def test_bytes_lost_or_doubled_on_the_way_to_the_board(hosted, change):
    with hosted.board as board:
        send_on(hosted, 4)
        hosted.line.to_board = once(change)
        send_on(hosted, 6)
        # The driver has recovered if the board delivers these sequences.
        before = hosted.state()["slots"]
        send_on(hosted, 2)
        assert hosted.state()["slots"] > before
        assert board.refused <= 2
    hosted.assert_zero()


@ALL
def test_a_port_that_goes_and_comes_back_begins_at_zero(hosted, known_by_usb):
    # A kajimoto61 answers no query: only USB can identify it.
    known_by_usb(hosted.line.path, hosted.kind == "kajimoto61")
    with hosted.board as board:
        send_on(hosted, 4)
        hosted.line.pull_out()
        threading.Timer(0.5, hosted.line.plug_in).start()
        with raises(BoardRestartedError, names="board", value=str(hosted.line.path)):
            send_on(hosted, 30)
        # On a busy machine there can be another note, about slow answers.
        assert sum(str(hosted.line.path) in note for note in board.notes) == 1
        before = hosted.state()["slots"]
        send_on(hosted, 4)
        assert hosted.state()["slots"] > before
    hosted.assert_zero()


@ALL
def test_a_port_that_stays_away_is_reported(hosted, monkeypatch):
    monkeypatch.setattr("smarttouch.boards.driver.RECOVER_S", 0.3)
    with raises(BoardError, names="board", value=str(hosted.line.path)) as error, hosted.board:
        pulled_out_after(4, hosted)
    goes_on = hosted.kind == "etactilekit"
    assert ("switch the board off" in str(error.value)) == goes_on
    if not goes_on:
        hosted.assert_zero()


@pytest.mark.parametrize("hosted", ["etactilekit"], indirect=True)
@pytest.mark.parametrize("known", [False, True], ids=["asked", "known"])
def test_a_board_that_is_back_gets_zero_first(hosted, known_by_usb, known):
    """The driver sends zero first. If USB does not identify the board, a query precedes zero."""
    known_by_usb(hosted.line.path, known)
    heard = []
    with hosted.board:
        send_on(hosted, 3)
        hosted.line.pull_out()
        hosted.line.to_board = lambda data: (heard.append(data), data)[1]
        hosted.line.plug_in()
        with pytest.raises(BoardRestartedError):
            send_on(hosted, 30)
        zero = zero_anywhere(hosted.electrodes)
        first = zero if known else b"\xf5" + zero
        assert b"".join(heard).startswith(first)


@pytest.mark.parametrize("hosted", ["link"], indirect=True)
def test_an_emergency_switch_that_opens_at_a_stop_is_reported(hosted):
    packets = Deframer()

    def opened(data):
        messages = [decode(packet) for packet in packets.feed(data)]
        return b"".join(encode(replace(each, state=protocol.SWITCH_OPEN)) for each in messages)

    with hosted.board as board:
        send_on(hosted, 4)
        hosted.line.to_host = opened
        board.stop()
        with raises(EmergencyStopError, names="switch"):
            board.report()
    hosted.assert_zero()


@pytest.mark.parametrize("hosted", ["etactilekit", "kajimoto61"], indirect=True)
def test_a_stop_of_a_board_that_is_away_says_whether_it_goes_on(hosted, known_by_usb, monkeypatch):
    known_by_usb(hosted.line.path, True)
    away, raised = threading.Event(), []

    def reopen(_name, _within_s, _identity, pause, _baudrate):
        away.set()
        pause(HANGS_S)

    def send():
        try:
            send_on(hosted, 30)
        except BoardError as error:
            raised.append(error)

    monkeypatch.setattr("smarttouch.boards.driver.reopen_port", reopen)
    goes_on = hosted.kind == "etactilekit"

    def said():
        lost = {"names": "board"}
        return raises(LineLostError, **lost) if goes_on else contextlib.nullcontext()

    hosted.board.open()
    send_on(hosted, 4)
    sending = threading.Thread(target=send, daemon=True)
    hosted.line.pull_out()
    sending.start()
    assert away.wait(HANGS_S)
    with said():
        hosted.board.halt()
    sending.join(HANGS_S)
    assert isinstance(raised[0], LineLostError if goes_on else BoardStoppedError)
    with said():
        hosted.board.close()


SECONDS = 2 if WHOLE else 1


class RandomFaults:
    """Random changes to 3 % of all pieces of bytes, counted by kind."""

    def __init__(self, seed, doubles, replays):
        self.random = random.Random(seed)
        self.kinds = ["drop", "cut", "none", "swallow"] + ["double"] * doubles
        self.kinds += ["again"] * replays
        self.before = deque(maxlen=1000)
        self.counts = dict.fromkeys(self.kinds, 0)

    def __call__(self, data):
        if not data:
            return data
        self.before.append(data)
        if self.random.random() > 0.03:
            return data
        kind, where = self.random.choice(self.kinds), self.random.randrange(len(data))
        self.counts[kind] += 1
        return {
            "drop": data[:where] + data[where + 1 :],
            "double": data[: where + 1] + data[where:],
            "cut": data[:where],
            "swallow": b"",
            # Add zero bytes, which delimit frames, so that the repeated frame is complete.
            "again": data + b"\0" + self.random.choice(self.before) + b"\0",
            "none": data,
        }[kind]


@pytest.mark.parametrize("hosted", sample([
    "link C", "link", "kajimoto61", "etactilekit", "etactilekit newest", FIRMWARES[1],
], 3), indirect=True)  # fmt: skip
def test_nothing_unsafe_flows(hosted, runs):
    runs = runs or SECONDS
    # USB and TCP, the lines of an eTactileKit, never double a byte.
    faults = RandomFaults(1, doubles=hosted.kind != "etactilekit", replays=hosted.kind == "link")
    hosted.line.to_board = hosted.line.to_host = faults
    begun = time.monotonic()
    opened = sent = restarts = 0
    sentences = []

    def over():
        # On a busy machine, wait longer for the first sequence.
        seconds = time.monotonic() - begun
        return seconds > runs and (sent > 0 or seconds > HANGS_S)

    while not over():
        hosted.step = 0
        try:
            with hosted.board:
                opened += 1
                pull = threading.Timer(faults.random.uniform(1, 20), unplug, [hosted.line])
                pull.start()
                try:
                    while not over():
                        try:
                            hosted.send(times=faults.random.choice([1, 1, 1, 4]))
                            sent += 1
                        except BoardRestartedError:
                            restarts += 1
                finally:
                    pull.cancel()
                    pull.join()
        except BoardError as error:
            sentences.append(str(error))
    hosted.line.to_board = hosted.line.to_host = bytes
    time.sleep(0.4)
    state = read_state(hosted.folder)
    print(
        f"\n{hosted.kind}: {runs:g} s, {sent} sequences, {state['slots']} slots; "
        f"{faults.counts}; opened {opened}, restarts {restarts}, errors {len(sentences)}; "
        f"unsafe slots {state['unsafe']}, old packets {state['old_packets']}"
    )
    assert sent > 0
    assert not any("\n" in sentence for sentence in sentences)
    assert state["unsafe"] == 0


def unplug(line):
    line.pull_out()
    time.sleep(0.5)
    line.plug_in()


CHIPS = b"\xf5"
EMULATED = pytest.mark.parametrize(
    "hosted", sample(["link", "kajimoto61", "etactilekit"]), indirect=True
)


class Stranger:
    """Another device at a board's path. It records received bytes, and replies with ``answer``."""

    def __init__(self, path, answer=lambda _heard: b""):
        self.heard, self._answer = b"", answer
        self._far, self._near = os.openpty()
        tty.setraw(self._near)
        self.device = os.ttyname(self._near)
        path.symlink_to(self.device)
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def _listen(self):
        while (data := os.read(self._far, 1000)) != b"\xa5" * 9:
            self.heard += data
            if answer := self._answer(data):
                os.write(self._far, answer)

    def close(self):
        os.write(self._near, b"\xa5" * 9)
        self._thread.join()
        os.close(self._near)
        os.close(self._far)


@pytest.fixture
def stranger(monkeypatch):
    monkeypatch.setattr("smarttouch.boards.kits.etactilekit_protocol.FORGETS_S", 0.1)
    monkeypatch.setattr("smarttouch.boards.driver.RECOVER_S", 0.3)
    made = []

    def make(path, *answer):
        made.append(Stranger(path, *answer))
        return made[-1]

    yield make
    for each in made:
        each.close()


def kinds(heard):
    """Return the kinds of packets in received bytes, which must consist of complete packets."""
    deframer = Deframer()
    found = [each.kind for each in deframer.feed(heard)]
    assert (deframer.errors, deframer.waiting) == (0, b"")
    return found


def replaced(hosted, stranger, *answer):
    """Replace a board by a `Stranger` in a run; return the bytes that the stranger received."""
    others = []

    def drive():
        with hosted.board:
            for _ in range(4):
                hosted.send()
            hosted.line.pull_out()
            others.append(stranger(hosted.line.path, *answer))
            for _ in range(30):
                hosted.send()

    with pytest.raises(BoardError) as error:
        drive()
    hosted.line.path.unlink()
    assert not isinstance(error.value, BoardRestartedError)
    assert_says(error.value, names="board")
    return others[0].heard


@EMULATED
def test_another_by_its_usb_numbers_gets_no_byte(hosted, stranger, usb_ports):
    here = os.path.realpath(hosted.line.path)
    usb_ports(here, vid=1, pid=2, serial_number="3")
    assert replaced(hosted, stranger) == b""


@EMULATED
def test_without_usb_numbers_another_gets_nothing_but_a_question(hosted, stranger):
    heard = replaced(hosted, stranger)
    if hosted.kind == "link":
        assert set(kinds(heard)) == {MessageKind.HELLO}
    else:
        assert heard.replace(CHIPS, b"") == b""
    assert (heard == b"") == (hosted.kind == "kajimoto61")


@pytest.mark.parametrize("hosted", ["link"], indirect=True)
def test_a_link_board_that_reports_another_identity_gets_no_sequence(hosted, stranger):
    said = protocol.CAPABILITIES.pack(8, 0, 0, 5000, 100, 120, 0, 0, 1 << 20, 0)
    said += b"another firmware"

    def answer(heard):
        (hello,) = (decode(each) for each in Deframer().feed(heard))
        session = hello.session | 1 << 32
        return encode(Message(MessageKind.CAPABILITIES, 1, session, 0, hello.number, said))

    assert kinds(replaced(hosted, stranger, answer)) == [MessageKind.HELLO]


@pytest.mark.parametrize("hosted", ["etactilekit"], indirect=True)
@pytest.mark.parametrize("answer", sample([b"\x02", b"\x01\x01", b"ready"], 3))
def test_an_etactilekit_of_another_size_gets_no_pattern(hosted, stranger, answer):
    assert replaced(hosted, stranger, {CHIPS: answer}.get) == CHIPS
