"""A board that comes back must be the same; another in its place gets only a question."""

import os
import threading
import tty

import pytest

from smarttouch.base.errors import BoardError, BoardRestartedError
from smarttouch.base.wire.framing import Deframer
from smarttouch.boards import link as protocol
from smarttouch.boards.link import MessageKind, decode, encode

from ..support.checks import assert_says
from ..support.full import sample

CHIPS = b"\xf5"
ALL = pytest.mark.parametrize("hosted", ["link", "kajimoto61", "etactilekit"], indirect=True)


class Stranger:
    """A device at a path that keeps what it receives and answers as it is set."""

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
    monkeypatch.setattr("smarttouch.boards.kits.etactilekit_line.FORGETS_S", 0.1)
    monkeypatch.setattr("smarttouch.boards.line.RECOVER_S", 0.3)
    made = []

    def make(path, *answer):
        made.append(Stranger(path, *answer))
        return made[-1]

    yield make
    for each in made:
        each.close()


def kinds(heard):
    """Return the kinds of packets in what a stranger heard; nothing else may be in it."""
    deframer = Deframer()
    found = [each.kind for each in deframer.feed(heard)]
    assert (deframer.errors, deframer.waiting) == (0, 0)
    return found


def replaced(hosted, stranger, *answer):
    """Let a board's place be taken while it is driven; return what was sent there."""
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


@ALL
def test_another_by_its_usb_numbers_gets_no_byte(hosted, stranger, usb_ports):
    here = os.path.realpath(hosted.line.path)
    usb_ports(here, vid=1, pid=2, serial_number="3")
    assert replaced(hosted, stranger) == b""


@ALL
def test_without_usb_numbers_another_gets_nothing_but_a_question(hosted, stranger):
    heard = replaced(hosted, stranger)
    if hosted.kind == "link":
        assert set(kinds(heard)) == {MessageKind.HELLO}
    else:
        assert heard.replace(CHIPS, b"") == b""
    assert (heard == b"") == (hosted.kind == "kajimoto61")


@pytest.mark.parametrize("hosted", ["link"], indirect=True)
def test_a_link_board_that_reports_another_identity_gets_no_sequence(hosted, stranger):
    said = protocol.CAPABILITIES.pack(8, 0, 0, 5000, 100, 120, 0)
    said += protocol.KEEPING.pack(0, 1 << 20, 0) + b"another firmware"

    def answer(heard):
        (hello,) = (decode(each) for each in Deframer().feed(heard))
        session = hello.session | 1 << 32
        return encode(MessageKind.CAPABILITIES, session, 1, 0, hello.number, said)

    assert kinds(replaced(hosted, stranger, answer)) == [MessageKind.HELLO]


@pytest.mark.parametrize("hosted", ["etactilekit"], indirect=True)
@pytest.mark.parametrize("answer", sample([b"\x02", b"\x01\x01", b"ready"], 3))
def test_an_etactilekit_of_another_size_gets_no_pattern(hosted, stranger, answer):
    assert replaced(hosted, stranger, {CHIPS: answer}.get) == CHIPS
