"""Packets on a byte stream, for boards and sensors: COBS-encoded between zeros, with a CRC."""

import struct
import zlib
from dataclasses import dataclass

from cobs import cobs

LARGEST_PACKET = 4 * 2**20
HEAD = struct.Struct("<BBI")  # of a decoded packet: version, kind and number
_CRC = struct.Struct("<I")


@dataclass(frozen=True)
class WirePacket:
    """Decoded packet."""

    kind: int
    number: int
    payload: bytes
    version: int


def frame_packet(version: int, kind: int, number: int, *payload: bytes) -> bytes:
    """Encode a packet; its payload can consist of several pieces.

    A packet is COBS-encoded and ends with one 0x00, so that receivers resynchronize at the next
    zero. Decoded, it is little endian: u8 version, u8 kind, u32 number, payload, u32 CRC-32 of all
    bytes before the CRC.
    """
    head = HEAD.pack(version, kind, number)
    crc = zlib.crc32(head)
    for piece in payload:
        crc = zlib.crc32(piece, crc)
    return bytes(cobs.encode(b"".join((head, *payload, _CRC.pack(crc))))) + b"\0"


class Deframer:
    """Parser of packets in a stream of bytes. It skips packets longer than ``largest`` bytes."""

    def __init__(self, largest: int = LARGEST_PACKET) -> None:
        self.errors: int = 0  # number of invalid packets
        self._largest, self._most = largest, largest * 1.01 + 64
        self.waiting: bytearray = bytearray()  # bytes of the packet that is not complete yet
        self._skipping = False

    def head(self, count: int) -> bytes | None:
        """Return the first ``count`` bytes of the incomplete packet, decoded but without a check of
        the CRC. Return None if fewer bytes have arrived."""
        data, at = bytearray(self.waiting[: count + 2]), 0
        if not data:
            return None
        while at + data[at] < len(data):
            at += data[at]
        # If the last COBS block is incomplete, shorten it to the bytes that have arrived. A zero
        # follows each complete block below the largest length. `cobs.decode` omits the last zero.
        zero = b"\0" if at + data[at] == len(data) and data[at] < 0xFF else b""
        data[at] = len(data) - at
        decoded = bytes(cobs.decode(bytes(data))) + zero
        return decoded[:count] if len(decoded) >= count else None

    def feed(self, data: bytes) -> list[WirePacket]:
        """Add received bytes to the stream, and return the packets that end in them."""
        *complete, rest = data.split(b"\0")
        packets = []
        for piece in complete:
            coded = bytes(self.waiting) + piece
            self.waiting.clear()
            skipped, self._skipping = self._skipping, False
            try:
                body = b"" if skipped else cobs.decode(coded)
            except cobs.DecodeError:
                body = b""
            end = len(body) - _CRC.size
            fits = HEAD.size <= end <= self._largest - _CRC.size
            if fits and zlib.crc32(body[:end]) == _CRC.unpack_from(body, end)[0]:
                version, kind, number = HEAD.unpack_from(body)
                packets.append(WirePacket(kind, number, body[HEAD.size : end], version))
            elif coded:
                self.errors += 1
        self.waiting += rest
        if len(self.waiting) > self._most:
            self.waiting.clear()
            self._skipping = True
        return packets
