"""The line to a ``link`` board: whose silence counts."""

import time

import pytest

from smarttouch.base.errors import LineLostError
from smarttouch.boards.link import protocol as protocol
from smarttouch.boards.link.packet_line import SILENCE_S, PacketLine
from smarttouch.boards.link.protocol import MessageKind, encode

from ..raising import raises
from .fresh import until

pytestmark = pytest.mark.realtime

ALIVE = "alive"


class Port:
    """Plays each piece once, then the last for ever; a number is a read that took so long."""

    def __init__(self, line, *pieces):
        self.line, self.pieces, self.in_waiting, self.number = line, list(pieces), 0, 0

    def read(self, _):
        piece = self.pieces.pop(0) if len(self.pieces) > 1 else self.pieces[0]
        time.sleep(piece if isinstance(piece, float) else 0.02)
        if piece == ALIVE:
            self.number += 1
            session, payload = self.line.session.number, protocol.ALIVE.pack(0)
            return encode(MessageKind.ALIVE, session, self.number, payload=payload)
        return piece if isinstance(piece, bytes) else b""

    def write(self, _):
        pass

    def close(self):
        pass


class Reads:
    """A line that reads from such a port."""

    name = "here"

    def __init__(self, port):
        self.port = port

    def read_some(self):
        return self.port.read(1)

    def lost(self, what):
        return LineLostError(f"the board at {self.name} {what}")


@pytest.fixture
def listen():
    """Return a maker of packets from a port that plays pieces."""
    lines = []

    def start(*pieces, begun=True):
        line = PacketLine(lambda message: None)
        line.open(Reads(Port(line, *pieces)))
        line.session.begun, line.silence_s = begun, SILENCE_S
        lines.append(line)
        return line

    yield start
    for line in lines:
        line.close()


def test_our_own_absence_is_not_the_boards_silence(listen):
    line = listen(ALIVE, 2 * SILENCE_S, b"", ALIVE)
    time.sleep(3 * SILENCE_S)
    line.raise_fault()


@pytest.mark.parametrize("noise", [b"", b"nothing whole"])
def test_a_silent_board_is_gone(listen, noise):
    line = listen(ALIVE, noise)
    until(lambda: line.fault is not None)
    with raises(LineLostError, names="board", value="here"):
        line.raise_fault()


def test_a_board_is_silent_before_a_session(listen):
    line = listen(b"", begun=False)
    time.sleep(2 * SILENCE_S)
    line.raise_fault()
