"""The ``link`` wire format of version 3, for both ends; a specification for firmware.

New firmware speaks version 4: ``docs/reference/link.md``, and ``firmware/`` in C. Hosts speak both.

A packet is COBS-encoded and ends with one 0x00, so a receiver that has lost
its place finds it again at the next zero. Decoded, all little endian::

    u8  version = 3
    u8  type
    u32 number      counts the packets of one end in one session, from 1 on
    u64 session
    u32 heard       largest number that this end has taken from the other, else 0
    u32 about       of SEQUENCE, ACK, NAK and VOLTAGES: the sequence; of an answer
                    to a question: the question's number; else 0
    ... payload
    u32 CRC-32      (IEEE 802.3) of all before it

Host to board:

==== ========= ==============================================================
type name      payload
==== ========= ==============================================================
0x01 HELLO     none; a question, answered by CAPABILITIES; changes nothing
0x02 SEQUENCE  see below; answered by ACK or NAK
0x03 HEARTBEAT none and no answer: the host lives
0x04 STOP      none; all electrodes shorted now, all that waits is dropped,
               the session is over; a question, answered by STOPPED
0x05 STATUS    none; a question, answered by REPORT
0x06 BEGIN     none; opens the session: drops all that waits, shorts all
               electrodes, ends a stop; a question, answered by BEGUN
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
                  5 the host had fallen silent; about no sequence: 6 something
                  came garbled, 7 an old packet, 8 a packet of another session
0x84 ALIVE        i16 finger force mN; sent by itself every 20 ms
0x85 REPORT       u32 sequences, u32 slots, u64 pulses, u32 violations,
                  f64 largest current mA, f64 largest charge µC, f64 largest
                  net charge left on an electrode µC, u8 sequences waiting
                  or executing, u32 old packets refused, u32 packets of other
                  sessions refused; all since the board was switched on
0x86 STOPPED      none
0x87 VOLTAGES     u16 [S]: what the source needed at the end of each slot's
                  pulse, 10 mV; after each scan of a sequence that asked
0x88 BEGUN        none: the session is open, its numbers begin here
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

Sessions keep out what was sent at another time or to another run: a line that
repeats, delays, reorders or mixes packets can lose some, and never make the board
deliver an old one. They are no cipher: who writes packets of his own is not kept out.

1. The host draws 32 random bits, not 0, and asks HELLO with these as the lower
   half of the session, upper half 0. The board answers CAPABILITIES with the
   same lower half, and its own 32 bits above: the *challenge*, random, not 0, or
   from a counter that survives switching off. HELLO changes nothing.
2. The host asks BEGIN with that session. The board opens it if the upper half is
   its challenge, and draws a new one at once: no session can be opened twice.
3. A session is *live* from BEGIN until STOP, until the host has been silent for
   100 ms, or until the host closes the line; it never becomes live again. While
   one is live, HELLO and BEGIN of any other are refused. One that is over may
   still ask STATUS and STOP.
4. Both ends number all their packets of a session, whatever their type, each
   above the one before; a packet that is sent again gets a new number. HELLO is
   numbered too, BEGIN goes on from there. CAPABILITIES alone has number 0.
5. The board refuses a packet as of another session (reason 8) unless it bears the
   session begun last, and as old (reason 7) if its number is not above that of the
   packet taken before it, or if (STOP excepted) its sender had heard nothing of what
   the board said in the 250 ms before its first byte came. What is refused has no effect, is no
   sign of life, is counted, and answered by NAK 7 or 8 while a session is live.
6. Of the hosts that asked HELLO since the last BEGIN the board remembers the lower
   halves and numbers, of eight at least: HELLO with a number not above the last of
   that host, its BEGIN included, is old. With BEGIN, and when there are more hosts
   than it can remember, it counts the HELLOs of the others as of other sessions.
7. The host refuses a packet from the board that bears another session, a number
   not above that of the packet taken before it, or that answers nothing it asked:
   an ACK or NAK of a sequence that is not on its way, voltages of one that was not
   sent, an answer whose question is unknown or has been answered. It counts these
   from CAPABILITIES on.
8. After 2^32 - 1 packets the host begins another session.

What a board does:

- It executes a sequence ``times`` times (at least once): slot after slot, each
  a pulse and then all electrodes shorted; the recharge phase, if there is one;
  and shorted until the period is over.
- It holds one more while it executes one; that one begins when the scan at
  hand is over, so no scan is ever torn. A third is refused as busy. A host that
  waits for the ACK of each before it sends the next is paced by the board.
- Sequences are numbered upwards (``about``). One with the number of the one before
  is the same one, sent again because an ACK or the packet itself was lost: it is
  not executed twice, and acknowledged again if it has begun. One with a smaller
  number is refused as old. BEGIN forgets these numbers.
- It checks every sequence itself and refuses what breaks its own limits.
- What is no packet (wrong length, code or CRC) is answered by NAK 6.
- When it has taken no packet for 100 ms it drops everything, shorts all electrodes,
  and refuses every SEQUENCE (reason 5) until BEGIN: what comes after a silence
  begins at zero, and only the host can see to that. A SEQUENCE that is still coming
  in, with a head that would be taken, counts as a sign of life with each of its
  bytes for 1 s from the first.
- It says ALIVE every 20 ms from BEGIN on; a host that hears nothing for long
  takes it for gone.
- HELLO of any version is answered, by a CAPABILITIES that bears the board's; nothing
  else of another version is.
"""

import struct
from enum import IntEnum, IntFlag
from typing import Literal, get_args

VERSION = 3
NEWEST = 4
"""Version whose boards keep kernels; its packets and sessions are those of `VERSION`."""
VERSIONS = (VERSION, NEWEST)
SILENCE_MS = 100
ALIVE_MS = 20
LATE_MS = 250
"""A packet is old if it confirms nothing that the board sent within this time."""
LONGEST_PACKET_MS = 1000
"""Longest time for which an incomplete packet counts as a sign of life."""
LAST_NUMBER = 2**32 - 1
HALF = 2**32 - 1
"""The host's half of a session; the board's is above it."""
Output = Literal["weighted", "three-state", "one-against-all"]
OUTPUTS: tuple[Output, ...] = get_args(Output)

CAPABILITIES = struct.Struct("<HBBHHHH")
ALIVE = struct.Struct("<h")
REPORT = struct.Struct("<IIQIdddBII")
KEEPING = struct.Struct("<IIH")
"""Version 4: room for kernels and for a packet, in bytes, and most kernels; after CAPABILITIES."""
LIMITS = struct.Struct("<IIIHHHH")
"""Version 4: least period µs, total µA, charge pC, width µs, full µA, rounding µA, full µs."""
KERNELS = struct.Struct("<III")
"""Version 4: identity, size and offset."""
KEPT = struct.Struct("<IIB")
"""Version 4: identity, bytes that are there, and whether all are and are sound."""
NAK = struct.Struct("<BBHHii")
"""Version 4: reason, rule, slot, electrode, value and what is allowed."""
ACCOUNT = struct.Struct("<IIQIIIIBII")
"""Version 4: REPORT in whole µA and pC."""
NOTHING = 0xFFFF
"""Slot or electrode where a rule is of none; as a slot, the recharge phase."""


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


class Rule(IntEnum):
    """Rules that a board of version 4 checks, in this order."""

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
