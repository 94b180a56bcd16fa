"""Messages of ``link``, and the host's end of a session, which accepts only new, requested ones."""

import secrets
import struct
from collections.abc import Callable
from dataclasses import dataclass

from smarttouch.boards.link_protocol import HALF, LAST_NUMBER, VERSION, Kind
from smarttouch.errors import LineLostError
from smarttouch.wire.framing import HEAD_BYTES, Packet, frame_packet, parse_head

_HEAD = struct.Struct("<BQII")
WHOLE_HEAD_BYTES = HEAD_BYTES + _HEAD.size  # bytes of a decoded packet before its payload
ANSWERS = {
    Kind.HELLO: Kind.CAPABILITIES,
    Kind.BEGIN: Kind.BEGUN,
    Kind.STOP: Kind.STOPPED,
    Kind.STATUS: Kind.REPORT,
    Kind.LIMITS: Kind.LIMITED,
    Kind.KERNELS: Kind.KEPT,
}
_ANSWERS = frozenset(ANSWERS.values())


@dataclass(frozen=True)
class Message:
    """Packet of this protocol; of an unknown version only ``kind`` and ``version`` are known."""

    kind: int
    number: int
    session: int = 0
    heard: int = 0
    about: int = 0
    payload: bytes = b""
    version: int = VERSION
    state: int = 0


def encode(
    kind: Kind,
    session: int,
    number: int,
    heard: int = 0,
    about: int = 0,
    payload: bytes = b"",
    state: int = 0,
) -> bytes:
    """Return a packet in its wire format."""
    head = _HEAD.pack(state, session, heard, about)
    return frame_packet(VERSION, kind, number, head, payload)


def decode(packet: Packet) -> Message:
    """Return a packet as a message; one that is too short has session 0, which is never valid."""
    if packet.version != VERSION or len(packet.payload) < _HEAD.size:
        return Message(packet.kind, packet.number, version=packet.version)
    state, session, heard, about = _HEAD.unpack_from(packet.payload)
    payload = packet.payload[_HEAD.size :]
    return Message(packet.kind, packet.number, session, heard, about, payload, VERSION, state)


def decode_head(head: bytes) -> Message:
    """Return the message that begins with these `WHOLE_HEAD_BYTES`, before its CRC."""
    return decode(parse_head(head))


def draw_half() -> int:
    """Return 32 random bits that are not all 0."""
    return secrets.randbelow(HALF) + 1


class HostSession:
    """One session with a board, from before HELLO on; ``draw`` returns 32 random bits that are not
    all 0."""

    def __init__(self, draw: Callable[[], int] = draw_half) -> None:
        self.number = draw()  # its upper half is 0 until the board has answered HELLO
        self.begun = False  # whether the board has answered BEGIN
        self.refused = 0  # number of packets
        self._sent = self._taken = self._offered = 0
        self._asked: dict[int, Kind] = {}

    @property
    def sent(self) -> int:
        """Number of the packet sent last."""
        return self._sent

    def encode(self, kind: Kind, about: int = 0, payload: bytes = b"") -> bytes:
        """Return the host's next packet."""
        if self._sent == LAST_NUMBER:
            raise LineLostError(f"the session of {LAST_NUMBER} packets is over", about="packets")
        self._sent += 1
        if kind in ANSWERS:
            self._asked[self._sent] = ANSWERS[kind]
        session = self.number & HALF if kind == Kind.HELLO else self.number
        return encode(kind, session, self._sent, self._taken, about, payload)

    def take(self, packet: Packet) -> Message | None:
        """Return a packet as a message, or None if it is refused."""
        message = decode(packet)
        if message.kind == Kind.CAPABILITIES:
            taken = self._take_capabilities(message)
        elif taken := (
            message.session == self.number
            and message.number > self._taken
            and message.version == VERSION
        ):
            self._taken = message.number
            if message.kind in _ANSWERS:
                taken = self._was_asked(message)
                self.begun |= taken and message.kind == Kind.BEGUN
        if not taken:
            self.refuse()
        return message if taken else None

    def refuse(self) -> None:
        """Count a refused packet; those before CAPABILITIES are of an earlier run."""
        self.refused += self.number > HALF

    def _take_capabilities(self, message: Message) -> bool:
        if message.version != VERSION:
            # A board of another version is reported by its version.
            return not self.begun
        if message.session & HALF != self.number & HALF or not self._was_asked(message):
            return False
        if self.begun or message.about < self._offered:
            return message.session == self.number
        self.number, self._offered = message.session, message.about
        return True

    def _was_asked(self, message: Message) -> bool:
        return self._asked.pop(message.about, None) == message.kind
