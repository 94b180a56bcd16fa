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


class Reads:
    """A line that plays each piece once, then the last for ever; a number is a read that took so
    long."""

    name = "here"

    def __init__(self, packets, *pieces):
        self.packets, self.pieces, self.number = packets, list(pieces), 0

    def read_some(self):
        piece = self.pieces.pop(0) if len(self.pieces) > 1 else self.pieces[0]
        time.sleep(piece if isinstance(piece, float) else 0.02)
        if piece == ALIVE:
            self.number += 1
            session, payload = self.packets.session.number, protocol.ALIVE.pack(0)
            return encode(MessageKind.ALIVE, session, self.number, payload=payload)
        return piece if isinstance(piece, bytes) else b""

    def lost(self, what):
        return LineLostError(f"the board at {self.name} {what}")


@pytest.mark.parametrize(("pieces", "begun", "is_gone"), [
    # Our own absence is not the board's silence, and before a session it says nothing.
    ([ALIVE, 2 * SILENCE_S, b"", ALIVE], True, False),
    ([b""], False, False),
    ([ALIVE, b""], True, True),
    ([ALIVE, b"nothing whole"], True, True),
])  # fmt: skip
def test_a_silent_board_is_gone(pieces, begun, is_gone):
    packets = PacketLine(lambda message: None)
    packets.open(Reads(packets, *pieces))
    packets.session.begun, packets.silence_s = begun, SILENCE_S
    try:
        if is_gone:
            until(lambda: packets.fault is not None)
            with raises(LineLostError, names="board", value="here"):
                packets.raise_fault()
        else:
            time.sleep(3 * SILENCE_S)
            packets.raise_fault()
    finally:
        packets.close()
