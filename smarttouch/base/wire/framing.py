"""Packets on a byte stream: COBS between zeros, and a CRC, for boards and sensors alike."""

import struct
import zlib
from dataclasses import dataclass

from cobs import cobs

LARGEST_PACKET = 4 * 2**20
_HEAD = struct.Struct("<BBI")
_CRC = struct.Struct("<I")
HEAD_BYTES = _HEAD.size  # size of a decoded packet's head: version, kind and number


@dataclass(frozen=True)
class WirePacket:
    """One complete packet."""

    kind: int
    number: int
    payload: bytes
    version: int


def frame_packet(version: int, kind: int, number: int, *payload: bytes) -> bytes:
    """Return a packet in its wire format; its payload may be in pieces.

    It is COBS-encoded and ends with one 0x00, so that a receiver can resynchronize at the next
    zero. Decoded, all little endian: u8 version, u8 kind, u32 number, the payload, u32 CRC-32 of
    all before it.
    """
    head = _HEAD.pack(version, kind, number)
    crc = zlib.crc32(head)
    for piece in payload:
        crc = zlib.crc32(piece, crc)
    return bytes(cobs.encode(b"".join((head, *payload, _CRC.pack(crc))))) + b"\0"


class Deframer:
    """Parser of packets in a stream of bytes; what is longer than ``largest`` is skipped."""

    def __init__(self, largest: int = LARGEST_PACKET) -> None:
        self.errors: int = 0  # pieces between zeros that were no valid packet
        self._largest, self._most = largest, largest * 1.01 + 64
        self._waiting = bytearray()
        self._skipping = False

    @property
    def waiting(self) -> int:
        """Number of bytes of the incomplete packet."""
        return len(self._waiting)

    def head(self, count: int) -> bytes | None:
        """Return the first bytes of the incomplete packet, decoded but unchecked; None if fewer
        than ``count`` have come."""
        data, at = bytearray(self._waiting[: count + 2]), 0
        if not data:
            return None
        while at + data[at] < len(data):
            at += data[at]
        # A block that has not come whole ends here; a zero follows one that has.
        zero = b"\0" if at + data[at] == len(data) and data[at] < 0xFF else b""
        data[at] = len(data) - at
        decoded = bytes(cobs.decode(bytes(data))) + zero
        return decoded[:count] if len(decoded) >= count else None

    def feed(self, data: bytes) -> list[WirePacket]:
        """Return every packet completed by these bytes."""
        *complete, rest = data.split(b"\0")
        packets = []
        for piece in complete:
            coded = bytes(self._waiting) + piece
            self._waiting.clear()
            skipped, self._skipping = self._skipping, False
            try:
                body = b"" if skipped else cobs.decode(coded)
            except cobs.DecodeError:
                body = b""
            end = len(body) - _CRC.size
            fits = _HEAD.size <= end <= self._largest - _CRC.size
            if fits and zlib.crc32(body[:end]) == _CRC.unpack_from(body, end)[0]:
                packets.append(parse_head(body[:end]))
            elif coded:
                self.errors += 1
        self._waiting += rest
        if len(self._waiting) > self._most:
            self._waiting.clear()
            self._skipping = True
        return packets


def parse_head(body: bytes) -> WirePacket:
    """Return a packet from its decoded bytes without the CRC, unchecked."""
    version, kind, number = _HEAD.unpack_from(body)
    return WirePacket(kind, number, body[_HEAD.size :], version)
