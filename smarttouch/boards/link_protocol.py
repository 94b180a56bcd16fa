"""Numbers of the ``link`` wire format, version 5, for both ends: see ``docs/reference/link.md``.

A packet is COBS-encoded and ends with one 0x00. Decoded, all little endian::

    u8  version = 5
    u8  type
    u32 number      counts the packets of one end in one session, from 1 on
    u8  state       of the board: 1 its emergency switch is open; else 0
    u64 session
    u32 heard       largest number that this end has taken from the other, else 0
    u32 about       of SEQUENCE, ACK, NAK and VOLTAGES: the sequence; of an answer
                    to a question: the question's number; else 0
    ... payload
    u32 CRC-32      (IEEE 802.3) of all before it
"""

import struct
from enum import IntEnum, IntFlag
from typing import Literal, get_args

VERSION = 5
SWITCH_OPEN = 1  # state of a board whose emergency switch is open
IDENTITY_BYTES = 16
SILENCE_MS = 100
ALIVE_MS = 20
LATE_MS = 250  # a packet is old if it confirms nothing that the board sent within this time
LONGEST_PACKET_MS = 1000  # longest time for which an incomplete packet counts as a sign of life
LAST_NUMBER = 2**32 - 1
HALF = 2**32 - 1  # the host's half of a session; the board's is above it
Output = Literal["weighted", "three-state", "one-against-all"]
OUTPUTS: tuple[Output, ...] = get_args(Output)

CAPABILITIES = struct.Struct("<HBBHHHH")
ALIVE = struct.Struct("<h")
KEEPING = struct.Struct("<IIH")  # after CAPABILITIES: room in bytes, packet bytes, most kernels
LIMITS = struct.Struct("<IIHHHHHHIBBH")
"""Least period µs, total µA, width µs, full µA, rounding µA, full µs, ramp ms, session s, session
µC, duty %, 0, width of a full pulse µs; then of each electrode u16 µA, u16 felt µA, u32 pC."""
KERNELS = struct.Struct("<16sII")  # identity, size and offset
KEPT = struct.Struct("<16sIB16s")
"""Identity, bytes that are there, whether all are and are sound, and the session's proof."""
NAK = struct.Struct("<BBHHii")  # reason, rule, slot, electrode, value and what is allowed
REPORT = struct.Struct("<IIQIIIIBIIIII")
"""Counts of sequences, slots, pulses and violations; largest current µA, charge pC and charge left
pC; sequences at hand; old and foreign packets; largest net charge within a second pC; seconds with
current and largest charge µC of the session."""
NOTHING = 0xFFFF  # slot or electrode where a rule is of none; as a slot, the recharge phase


class Kind(IntEnum):
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
    """Rules that a board checks, in the order of the page."""

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
