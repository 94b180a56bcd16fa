"""Commands of an eTactileKit, their encoding of sequences, and the settings that these need.

On the wire (native USB, or TCP port 8080; little endian, no framing, no checksum)::

    FC u8   electrodes N        FB u8   0 monophasic, 1 biphasic, 2 impedance only
    FD u8   1 anodic 0 cathodic FA u16  pulse width µs
    F9 u8   sense height        F8 u8   sense width µs
    F7 u8   discharge µs        F6 u16  scans per second
    FE N×u16 heights in counts  FF      reply N×u16: ADC of each electrode's last slot
    F5      reply: chips        F4      reply: N, the only echo

So speaks the firmware of commit 71adee2 and later. Older ones know no F4, have one height for all
(FB), and FE N×u8 says which electrodes have it: they are put at zero and refused.

A byte lost inside FE would leave the board waiting, and the next byte sent would
complete a pattern shifted by eight bits: up to 41 mA. So every change is guarded:
all pulses are stopped before it (by a mode without any, or a height of zero), a query
follows it, and pulses come back only when that has been answered. A lost byte swallows the
query: no answer, no pulses, and the driver resets the board's parser. Numbers avoid bytes
that look like commands, and where one byte of a word may be lost, zeros that follow make it
smaller, never larger. Not guarded: a *doubled* byte (USB and TCP make none).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import BoardError
from smarttouch.boards.kits.current_scale import Scale, one_against_all
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

UA_PER_COUNT = 9.99  # nominal scale; the firmware does not cap 4095 counts, which are 41 mA
LARGEST = 1000
"""Counts, about 10 mA: nothing above leaves this host, whatever the limits. Its firmware does not
cap 4095 counts, which are 41 mA."""
FIRST_COMMAND = 0xF4
SLOT_EXTRA_US = 10  # that switching adds to each slot, with a pulse or without
SHORTEST_US = 7  # shortest pulse: switching on and off takes 6.6 µs


@dataclass(frozen=True)
class Settings:
    """Settings shared by all slots of a scan."""

    width_us: int
    discharge_us: int
    rate_hz: int
    anodic: bool

    @property
    def period_ns(self) -> int:
        """Period of its timer, in whole µs."""
        return 1_000_000 // self.rate_hz * 1000

    def scan_us(self, outputs: int, slot_extra_us: int = SLOT_EXTRA_US) -> int:
        return outputs * (self.width_us + self.discharge_us + slot_extra_us)


def settings_of(sequence: ScanSequence) -> Settings:
    """Return the settings of a sequence; raise BoardError if its slots need several polarities or
    widths, or a time that is out of reach."""
    _, current_ua = one_against_all(sequence)
    if len(np.unique(np.sign(current_ua))) > 1:
        raise BoardError(
            "some slots are anodic, some cathodic, and this board has one polarity for all: "
            "send them as two sequences"
        )
    if sequence.slots and np.ptp(sequence.width_us):
        raise BoardError(
            f"slots of {int(sequence.width_us.min())} to {int(sequence.width_us.max())} µs in "
            "one sequence, and this board has one pulse width for all"
        )
    width = int(sequence.width_us.max(initial=0))
    if sequence.slots and width < SHORTEST_US:
        raise BoardError(f"pulses of {width} µs are too short: at least {SHORTEST_US} µs")
    discharge = int(sequence.discharge_us.max(initial=0))
    if discharge >= FIRST_COMMAND:
        raise BoardError(f"a discharge of {discharge} µs is too long: at most {FIRST_COMMAND - 1}")
    rate_hz = max(1, round(1e6 / sequence.period_us))
    return Settings(width, discharge, rate_hz, bool((current_ua < 0).any()))


def payload(
    sequence: ScanSequence, wiring: NDArray[np.intp], scale: Scale, limits: SafetyLimits
) -> bytes:
    """Return the pattern of a sequence: the height of each output in counts, of which neither
    rounding nor a scale that is wrong passes the limits."""
    electrode, current_ua = one_against_all(sequence)
    most = scale.most_counts(limits, sequence.width_us.max(initial=0))
    nearest = np.rint(np.abs(current_ua) / scale.measured_ua)
    counts = np.minimum(np.minimum(nearest, most[electrode]), LARGEST).astype(np.uint16)
    # A byte that looks like a command would be one, if that before it were lost.
    low = counts & 0xFF
    counts -= np.where(low >= FIRST_COMMAND, low - (FIRST_COMMAND - 1), 0).astype(np.uint16)
    heights = np.zeros(wiring.max() + 1, "<u2")
    heights[wiring[electrode]] = counts
    return heights.tobytes()


VOLTS_PER_COUNT = 0.0893
DUMMY_KOHM = 66.0  # load fitted in parallel with the skin; it takes V / 66 kΩ of the current
COMPLIANCE_V = 300.0  # limit of its switches (HV513), the largest voltage of a reading
ZEROS = bytes(2 * 255 + 4)  # padding longer than the rest of any command
PING, CHIPS, READINGS = b"\xf4", b"\xf5", b"\xff"
NO_SENSE = b"\xf9\0\0\xf8\0\0"
_END = bytes(3)  # end of any command that has lost a byte
AT_REST = (
    b"\xfc\0" + _END, NO_SENSE, b"\xfb\0\0" + _END, b"\xfa\x01\0" + _END,
    b"\xf7\0" + _END, b"\xf6\x0a\0" + _END,
)  # fmt: skip
"""Puts every published firmware at zero: no electrodes, no sense pulses, no height (or mode 0), the
shortest pulses, ten scans a second. No other known board takes a byte of it for a query or a
pattern."""


QUIET = b"\xfb\x02\xfb\x02"  # stops all pulses from the next scan on
LOAD = b"\xfb\x02\xfe"  # before a pattern, which is loaded while nothing flows
GO = b"\xfb\0"  # starts its pulses from the next scan on


def zero_anywhere(outputs: int) -> bytes:
    """Return the bytes that put a board at zero in any state of its parser: no sense pulses, no
    pulses at all, and a pattern of zeros.

    Zeros first: they complete any half command as a smaller one, with no pulses meanwhile, and a
    lost byte costs a spare one, never the next command.
    """
    return bytes(2 * outputs + 4) + NO_SENSE + b"\xfb\x02\x02\x02\xfe" + bytes(2 * outputs)


def settings_commands(settings: Settings, between_hz: int) -> bytes:
    """Return the commands of the settings, twice, each followed by zeros: were a word's first
    byte lost, they would make it zero, not a longer pulse. At ``between_hz`` scans of the old and
    of the new pulses fit."""
    once = (
        QUIET + _END + b"\xf9\0" + _END + b"\xf8\0" + _END
        + b"\xf6" + between_hz.to_bytes(2, "little") + _END
        + bytes([0xFD, settings.anodic]) + _END
        + b"\xfa" + settings.width_us.to_bytes(2, "little") + _END
        + bytes([0xF7, settings.discharge_us]) + _END
    )  # fmt: skip
    return once * 2 + (b"\xf6" + settings.rate_hz.to_bytes(2, "little") + _END) * 2
