"""The ``link`` wire format, for both ends; firmware can be written from this page.

A packet is COBS-encoded and ends with one 0x00, so a receiver that has lost
its place finds it again at the next zero. Decoded, all little endian::

    u8  version = 1
    u8  type
    u32 number      of the sequence this is, or answers; else 0
    ... payload
    u32 CRC-32      (IEEE 802.3) of all before it

Host to board:

==== ========= ==============================================================
type name      payload
==== ========= ==============================================================
0x01 HELLO     none; answered by CAPABILITIES; ends a stop
0x02 SEQUENCE  see below; answered by ACK or NAK
0x03 HEARTBEAT none; answered by ALIVE
0x04 STOP      none; all electrodes shorted now, all that waits is dropped,
               every SEQUENCE refused until HELLO; answered by STOPPED
0x05 STATUS    none; answered by REPORT
==== ========= ==============================================================

Board to host:

==== ============ ===========================================================
0x81 CAPABILITIES u16 electrodes, u8 output (0 weighted, 1 three-state, 2 one
                  against all), u16 largest current µA, u16 most slots, u16
                  time to zero ms, then the firmware's name in UTF-8
0x82 ACK          none: the sequence has begun, the next one may be sent
0x83 NAK          u8 reason (1 busy, 2 malformed, 3 unsafe, 4 stopped, 5 dropped
                  in silence), UTF-8
0x84 ALIVE        none
0x85 REPORT       u32 sequences, u32 slots, u64 pulses, u32 violations,
                  f64 largest current mA, f64 largest charge µC, f64 largest
                  net charge left on an electrode µC, u8 sequences waiting
                  or executing
0x86 STOPPED      none
==== ============ ===========================================================

SEQUENCE::

    u32 period µs, u16 slots S, u16 electrodes E, u8 kind
    u16 width µs [S], u16 discharge µs [S], u16 site [S]
    kind 0, weighted:  i16 current µA [S][E], positive cathodic, sum zero
    kind 1, switched:  u16 source µA [S], then per slot ceil(E/4) bytes of
                       two-bit states, electrode 0 lowest:
                       0 insulated, 1 cathode, 2 anode

A board executes a sequence once: slot after slot, each a pulse and then all
electrodes shorted, and shorted until the period is over. It holds one more
while it executes one; a third is refused as busy. So a host that waits for the
ACK of each before it sends the next is paced by the board, whosever clock is
slow. It checks every sequence itself and refuses what breaks its own limits.
When nothing has come from the host for 100 ms it drops everything and shorts
all electrodes.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, get_args

import numpy as np
from cobs import cobs
from numpy.typing import NDArray

from smarttouch.errors import BoardError

VERSION = 1
SILENCE_MS = 100
LARGEST_PACKET = 4 * 2**20
"""1,024 slots of 1,024 weighted electrodes need half of it."""

Output = Literal["weighted", "three-state", "one-against-all"]
OUTPUTS: tuple[Output, ...] = get_args(Output)

CAPABILITIES = struct.Struct("<HBHHH")
REPORT = struct.Struct("<IIQIdddB")
_U16_MAX = 0xFFFF
_HEAD = struct.Struct("<BBI")
_CRC = struct.Struct("<I")
_SEQUENCE = struct.Struct("<IHHB")


class Kind(IntEnum):
    """Types of packets."""

    HELLO = 0x01
    SEQUENCE = 0x02
    HEARTBEAT = 0x03
    STOP = 0x04
    STATUS = 0x05
    CAPABILITIES = 0x81
    ACK = 0x82
    NAK = 0x83
    ALIVE = 0x84
    REPORT = 0x85
    STOPPED = 0x86


class Refusal(IntEnum):
    """Why a board declines a sequence."""

    BUSY = 1
    MALFORMED = 2
    UNSAFE = 3
    STOPPED = 4
    SILENCE = 5


@dataclass(frozen=True)
class Packet:
    """One packet that came whole."""

    kind: int
    number: int
    payload: bytes


@dataclass(frozen=True, eq=False)
class WireSequence:
    """A sequence as it arrives at a board.

    ``current_ua`` is (S, E) int16 for weighted boards; for switched ones
    ``state`` is (S, E) int8 (1 cathode, −1 anode, 0 insulated, 2 not a state)
    and ``source_ua`` (S,) uint16. Positive is cathodic.
    """

    period_us: int
    electrodes: int
    width_us: NDArray[np.uint16]
    discharge_us: NDArray[np.uint16]
    site: NDArray[np.uint16]
    current_ua: NDArray[np.int16] | None
    source_ua: NDArray[np.uint16] | None
    state: NDArray[np.int8] | None


def encode(kind: Kind, number: int = 0, payload: bytes = b"") -> bytes:
    """Return a packet as it goes over the wire.

    Raises
    ------
    BoardError
        If it is larger than any receiver accepts.
    """
    body = _HEAD.pack(VERSION, kind, number) + payload
    if len(body) > LARGEST_PACKET:
        raise BoardError(
            f"a packet of {len(body)} bytes is above the limit of {LARGEST_PACKET}: "
            "scan fewer points at once"
        )
    return bytes(cobs.encode(body + _CRC.pack(zlib.crc32(body)))) + b"\0"


def encode_sequence(
    number: int,
    output: Output,
    period_us: int,
    width_us: NDArray[np.uint16],
    discharge_us: NDArray[np.uint16],
    site: NDArray[np.uint16],
    current_ua: NDArray[np.int16],
) -> bytes:
    """Return a SEQUENCE packet; the columns are those of a scan sequence.

    Raises
    ------
    BoardError
        If it is larger than a packet, or needs a stronger source than the wire can say.
    """
    slots, electrodes = current_ua.shape
    if slots > _U16_MAX:
        raise BoardError(f"{slots} slots are above the limit of {_U16_MAX}: scan fewer points")
    switched = output != "weighted"
    parts = [
        _SEQUENCE.pack(period_us, slots, electrodes, switched),
        _u16(width_us),
        _u16(discharge_us),
        _u16(site),
    ]
    if switched:
        source = np.maximum(current_ua, 0).sum(axis=1, dtype=np.int64)
        strongest = int(source.max(initial=0))
        if strongest > _U16_MAX:
            raise BoardError(
                f"a slot asks {strongest / 1000:.1f} mA of one source, the wire carries at most "
                f"{_U16_MAX / 1000:.1f} mA: lower the currents"
            )
        parts += [_u16(source.astype(np.uint16)), _pack_states(np.sign(current_ua))]
    else:
        parts.append(current_ua.astype("<i2", copy=False).tobytes())
    return encode(Kind.SEQUENCE, number, b"".join(parts))


def decode_sequence(payload: bytes) -> WireSequence:
    """Return the sequence in a payload.

    Raises
    ------
    ValueError
        If the payload is not exactly one sequence.
    """
    if len(payload) < _SEQUENCE.size:
        raise ValueError(f"{len(payload)} bytes are no sequence")
    period_us, slots, electrodes, kind = _SEQUENCE.unpack_from(payload)
    packed = -(-electrodes // 4)
    row = 6 + (2 * electrodes if kind == 0 else 2 + packed)
    if kind not in (0, 1) or len(payload) != _SEQUENCE.size + slots * row:
        raise ValueError(
            f"{len(payload)} bytes are not {slots} slots of {electrodes} electrodes, kind {kind}"
        )
    columns = np.frombuffer(payload, "<u2", (4 if kind else 3) * slots, _SEQUENCE.size)
    rest = payload[_SEQUENCE.size + columns.nbytes :]
    width, discharge, site = columns[: 3 * slots].reshape(3, slots)
    current = source = state = None
    if kind == 0:
        current = np.frombuffer(rest, "<i2").reshape(slots, electrodes)
    else:
        source = columns[3 * slots :]
        state = _unpack_states(np.frombuffer(rest, np.uint8).reshape(slots, packed), electrodes)
    return WireSequence(period_us, electrodes, width, discharge, site, current, source, state)


class Deframer:
    """Finds packets in whatever bytes come.

    Attributes
    ----------
    errors : int
        Pieces between zeros that were no valid packet.
    """

    def __init__(self) -> None:
        self.errors = 0
        self._waiting = bytearray()
        self._skipping = False

    def feed(self, data: bytes) -> Iterator[Packet]:
        """Yield every packet that is complete with these bytes."""
        *whole, rest = data.split(b"\0")
        for piece in whole:
            body = bytes(self._waiting) + piece
            self._waiting.clear()
            packet = None if self._skipping else _parse(body)
            self._skipping = False
            if packet is not None:
                yield packet
            elif body:
                self.errors += 1
        self._waiting += rest
        if len(self._waiting) > LARGEST_PACKET * 1.01 + 64:
            self._waiting.clear()
            self._skipping = True


def _parse(piece: bytes) -> Packet | None:
    try:
        body = cobs.decode(piece)
    except cobs.DecodeError:
        return None
    if len(body) < _HEAD.size + _CRC.size:
        return None
    if zlib.crc32(body[: -_CRC.size]) != _CRC.unpack_from(body, len(body) - _CRC.size)[0]:
        return None
    version, kind, number = _HEAD.unpack_from(body)
    if version != VERSION:
        return None
    return Packet(kind, number, body[_HEAD.size : -_CRC.size])


def _u16(values: NDArray[np.uint16]) -> bytes:
    return values.astype("<u2", copy=False).tobytes()


def _pack_states(signs: NDArray[np.int16]) -> bytes:
    slots, electrodes = signs.shape
    row = -(-electrodes // 4)
    codes = np.zeros((slots, row * 4), np.uint8)
    codes[:, :electrodes] = np.where(signs < 0, 2, signs)
    four = codes.reshape(slots, row, 4)
    packed = four[..., 0] | four[..., 1] << 2 | four[..., 2] << 4 | four[..., 3] << 6
    return bytes(packed.tobytes())


def _unpack_states(packed: NDArray[np.uint8], electrodes: int) -> NDArray[np.int8]:
    codes = (packed[..., None] >> np.array([0, 2, 4, 6], np.uint8)) & 3
    flat = codes.reshape(len(packed), packed.shape[1] * 4)[:, :electrodes]
    return np.asarray(np.array([0, 1, -1, 2], np.int8)[flat])
