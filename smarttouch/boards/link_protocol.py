"""The ``link`` wire format, for both ends; firmware can be written from this page.

A packet is COBS-encoded and ends with one 0x00, so a receiver that has lost
its place finds it again at the next zero. Decoded, all little endian::

    u8  version = 2
    u8  type
    u32 number      of the sequence this is, or answers; else 0
    ... payload
    u32 CRC-32      (IEEE 802.3) of all before it

Host to board:

==== ========= ==============================================================
type name      payload
==== ========= ==============================================================
0x01 HELLO     none; answered by CAPABILITIES, whatever version it is of;
               drops all that waits, shorts all electrodes, ends a stop
0x02 SEQUENCE  see below; answered by ACK or NAK
0x03 HEARTBEAT none and no answer: the host lives
0x04 STOP      none; all electrodes shorted now, all that waits is dropped,
               every SEQUENCE refused until HELLO; answered by STOPPED
0x05 STATUS    none; answered by REPORT
==== ========= ==============================================================

Board to host:

==== ============ ===========================================================
0x81 CAPABILITIES u16 electrodes, u8 output (0 weighted, 1 three-state, 2 one
                  against all), u8 features (1 measures voltage, 2 measures
                  finger force, 4 makes recharge phases), u16 largest current
                  µA, u16 most slots, u16 time to zero ms, u16 compliance V,
                  then the firmware's name in UTF-8
0x82 ACK          none: the sequence has begun, the next one may be sent
0x83 NAK          u8 reason, UTF-8: 1 busy, 2 malformed, 3 unsafe, 4 stopped,
                  5 the host had fallen silent, 6 something came garbled
                  (number 0)
0x84 ALIVE        i16 finger force mN; sent by itself every 20 ms
0x85 REPORT       u32 sequences, u32 slots, u64 pulses, u32 violations,
                  f64 largest current mA, f64 largest charge µC, f64 largest
                  net charge left on an electrode µC, u8 sequences waiting
                  or executing
0x86 STOPPED      none
0x87 VOLTAGES     u16 [S]: what the source needed at the end of each slot's
                  pulse, 10 mV; after each scan of a sequence that asked
==== ============ ===========================================================

SEQUENCE::

    u32 period µs, u16 slots S, u16 electrodes E, u8 kind, u8 flags, u16 times
    u16 width µs [S], u16 discharge µs [S], u16 site [S]
    kind 0, weighted:  i16 current µA [S][E], positive cathodic, sum zero
    kind 1, switched:  u16 source µA [S], then per slot ceil(E/4) bytes of
                       two-bit states, electrode 0 lowest:
                       0 insulated, 1 cathode, 2 anode
    flags: 1 answer each scan with VOLTAGES, 2 a recharge phase follows (kind 0):
    u16 recharge µs, i16 current µA [E], positive cathodic, sum zero

What a board does:

- It executes a sequence ``times`` times (at least once): slot after slot, each
  a pulse and then all electrodes shorted; the recharge phase, if there is one;
  and shorted until the period is over.
- It holds one more while it executes one; that one begins when the scan at
  hand is over, so no scan is ever torn. A third is refused as busy. A host that
  waits for the ACK of each before it sends the next is paced by the board.
- A SEQUENCE with the number of the one before it is the same one, sent again
  because an ACK or the packet itself was lost: it is not executed twice, and
  acknowledged again if it has begun. HELLO forgets numbers.
- It checks every sequence itself and refuses what breaks its own limits.
- What is no packet (wrong length, code or CRC) is answered by NAK 6.
- When nothing has come from the host for 100 ms it drops everything, shorts all
  electrodes, and refuses every SEQUENCE (reason 5) until HELLO: what comes after
  a silence begins at zero, and only the host can see to that.
- It says ALIVE every 20 ms from HELLO on; a host that hears nothing for long
  takes it for gone.
"""

import struct
from enum import IntEnum, IntFlag
from typing import Literal, get_args

from smarttouch.errors import BoardError
from smarttouch.wire.framing import LARGEST_PACKET, frame_packet

VERSION = 2
SILENCE_MS = 100
ALIVE_MS = 20
Output = Literal["weighted", "three-state", "one-against-all"]
OUTPUTS: tuple[Output, ...] = get_args(Output)

CAPABILITIES = struct.Struct("<HBBHHHH")
ALIVE = struct.Struct("<h")
REPORT = struct.Struct("<IIQIdddB")


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
    VOLTAGES = 0x87


class Feature(IntFlag):
    """Abilities that not every board has."""

    VOLTAGE = 1
    FORCE = 2
    RECHARGE = 4


class Refusal(IntEnum):
    """Why a board declines a sequence."""

    BUSY = 1
    MALFORMED = 2
    UNSAFE = 3
    STOPPED = 4
    SILENCE = 5
    GARBLED = 6


def encode(kind: Kind, number: int = 0, payload: bytes = b"") -> bytes:
    """Return a packet as it goes over the wire.

    Raises
    ------
    BoardError
        If it is larger than any receiver accepts.
    """
    if len(payload) > LARGEST_PACKET:
        raise BoardError(
            f"a packet of {len(payload)} bytes is above the limit of {LARGEST_PACKET}: "
            "scan fewer points at once"
        )
    return frame_packet(VERSION, kind, number, payload)
