"""The ``link`` wire format, version 5, for both ends: see ``firmware/PROTOCOL.md``.

A packet is COBS-encoded and ends with one 0x00. Decoded, all little endian::

    u8  version = 5
    u8  type
    u32 number      counts the packets of one end in one session, from 1 on
    u8  state       from the board: 1 if its emergency switch is open; else 0
    u64 session
    u32 heard       largest number that this end has received from the other, else 0
    u32 about       in SEQUENCE, ACK, NAK and VOLTAGES, number of the sequence; in an
                    answer, number of the query; else 0
    ... payload
    u32 CRC-32      (IEEE 802.3) of all before it
"""

import hashlib
import secrets
import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import Literal, get_args

from smarttouch.base.wire.framing import HEAD, WirePacket, frame_packet

VERSION = 5
VOLT = 100  # counts per volt in VOLTAGES
SWITCH_OPEN = 1  # bit of the state: the emergency switch is open
SILENCE_MS = 100
ALIVE_MS = 20
LATE_MS = 250  # a packet is late if the newest ALIVE that it confirms is older than this
LONGEST_PACKET_MS = 1000  # longest time for which an incomplete packet counts as a sign of life
HALF = 2**32 - 1  # mask of the lower half of a session number; the host draws this half at random
Output = Literal["weighted", "three-state", "one-against-all"]
OUTPUTS: tuple[Output, ...] = get_args(Output)

CAPABILITIES = struct.Struct("<HBBHHHHIIH")
"""Payload of CAPABILITIES: electrodes, output kind, features, largest current µA, most slots, time
to zero ms, compliance V, kernel bytes, packet bytes, most kernels. The firmware's name follows."""
ALIVE = struct.Struct("<h")
LIMITS = struct.Struct("<IIHHHHHHIBBH")
"""First part of the payload of LIMITS; the values of each electrode follow. The section on limits
in ``firmware/PROTOCOL.md`` describes all fields."""
SEQUENCE = struct.Struct("<IHHBB")  # period µs, times, intensity, flags, number of pulse shapes
GROUP = struct.Struct("<BBH")  # kind, pulse shape and number of slots
POINTS, SUM, CURRENTS, STATES = range(4)  # kinds of groups
MEASURE, RECHARGE, MORE, GOES_ON = 1, 2, 4, 8  # flags of a sequence
FULL = 0xFFFF  # encodes intensity 1; also the largest sum of the amplitudes of a slot
KERNELS = struct.Struct("<16sII")  # identity, size and offset
KEPT = struct.Struct("<16sIB16s")
"""Payload of KEPT: identity of the stored kernels, number of stored bytes, whether all kernels are
stored and valid, and the proof for this session."""
ACK = struct.Struct("<Q")  # start of the sequence by the board's clock, µs
NAK = struct.Struct("<BBHHii")  # reason, rule, slot, electrode, value, allowed value
REPORT = struct.Struct("<IIQIIIIBIIIII")
"""Payload of REPORT. The table of packets in ``firmware/PROTOCOL.md`` describes its fields."""
NOTHING = 0xFFFF  # value of slot or electrode in a NAK, if there is none


def digest_of(data: bytes, session: int | None = None) -> bytes:
    """Return the digest that identifies kernels. With ``session``, return the digest by which a
    board proves that it stores the kernels."""
    head = b"" if session is None else session.to_bytes(8, "little")
    return hashlib.sha256(head + data).digest()[:16]


class MessageKind(IntEnum):
    """Types of packets."""

    HELLO = 0x01
    SEQUENCE = 0x02
    HEARTBEAT = 0x03
    STOP = 0x04
    STATUS = 0x05
    BEGIN = 0x06
    LIMITS = 0x07
    KERNELS = 0x08
    CAPABILITIES = 0x81
    ACK = 0x82
    NAK = 0x83
    ALIVE = 0x84
    REPORT = 0x85
    STOPPED = 0x86
    VOLTAGES = 0x87
    BEGUN = 0x88
    LIMITED = 0x89
    KEPT = 0x8A


class Feature(IntFlag):
    """Optional abilities of a board."""

    VOLTAGE = 1
    FORCE = 2
    RECHARGE = 4
    KERNELS = 8
    EMERGENCY = 16


class Refusal(IntEnum):
    """Reasons why a board refuses a sequence or a packet."""

    BUSY = 1
    MALFORMED = 2
    UNSAFE = 3
    STOPPED = 4
    SILENCE = 5
    GARBLED = 6
    OLD = 7
    FOREIGN = 8
    EMERGENCY = 9


class Rule(IntEnum):
    """Rules that a board checks, in the order of PROTOCOL.md."""

    NONE = 0
    LIMITS = 1
    SLOTS = 2
    PERIOD = 3
    WIDTH = 4
    DISCHARGE = 5
    FIT = 6
    DUTY = 7
    KIND = 8
    KERNEL = 9
    SUM = 10
    BALANCE = 11
    CURRENT = 12
    TOTAL = 13
    CHARGE = 14
    STATES = 15
    MEAN = 16
    INTENSITY = 17
    RISE = 18
    RECHARGE = 19
    FELT = 20
    FELT_IN_SECOND = 21
    CHARGE_IN_SECOND = 22
    NET_IN_SECOND = 23
    OFTEN = 24
    SESSION_TIME = 25
    SESSION_CHARGE = 26
    READY = 27
    PART = 28


_HEAD = struct.Struct("<BQII")
WHOLE_HEAD_BYTES = HEAD.size + _HEAD.size  # bytes of a decoded packet before its payload
ANSWERS = {
    MessageKind.HELLO: MessageKind.CAPABILITIES,
    MessageKind.BEGIN: MessageKind.BEGUN,
    MessageKind.STOP: MessageKind.STOPPED,
    MessageKind.STATUS: MessageKind.REPORT,
    MessageKind.LIMITS: MessageKind.LIMITED,
    MessageKind.KERNELS: MessageKind.KEPT,
}


@dataclass(frozen=True)
class Message:
    """Packet of this protocol; for an unknown version only ``kind`` and ``version`` are valid."""

    kind: int
    number: int
    session: int = 0
    heard: int = 0
    about: int = 0
    payload: bytes = b""
    state: int = 0
    version: int = VERSION


def encode(message: Message) -> bytes:
    """Encode a message as a packet."""
    head = _HEAD.pack(message.state, message.session, message.heard, message.about)
    return frame_packet(VERSION, message.kind, message.number, head, message.payload)


def decode(packet: WirePacket) -> Message:
    """Decode a packet; a packet that is too short gets session 0, which is never valid."""
    if packet.version != VERSION or len(packet.payload) < _HEAD.size:
        return Message(packet.kind, packet.number, version=packet.version)
    state, session, heard, about = _HEAD.unpack_from(packet.payload)
    payload = packet.payload[_HEAD.size :]
    return Message(packet.kind, packet.number, session, heard, about, payload, state)


def draw_half() -> int:
    """Return one half of a session number: 32 random bits that are not all 0."""
    return secrets.randbelow(HALF) + 1
