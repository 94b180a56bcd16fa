"""Commands of an eTactileKit, their encoding of sequences, and the settings that these need.

On the wire (native USB, or TCP port 8080; little endian, no framing, no checksum)::

    FC u8   electrodes N        FB u8   0 monophasic, 1 biphasic, 2 impedance only
    FD u8   1 anodic 0 cathodic FA u16  pulse width µs
    F9 u8   sense height        F8 u8   sense width µs
    F7 u8   discharge µs        F6 u16  scans per second
    FE N×u16 heights in counts  FF      reply N×u16: ADC of each electrode's last slot
    F5      reply: chips        F4      reply: N, the only echo

So speaks the firmware of commit 71adee2 and later (`ModeCodec`). That of commit 936c6c0
("hardware version 2") has one height for all, FB u16, and FE N×u8 says which electrodes
have it; it knows no F4, F9 counts fourfold, and half a command waits for ever
(`HeightCodec`).

A byte lost inside FE would leave the board waiting, and the next byte sent would
complete a pattern shifted by eight bits: up to 41 mA. So every change is guarded:
all pulses are stopped before it (by a mode without any, or a height of zero), a query
follows it, and pulses come back only when that has been answered. A lost byte swallows the
query: no answer, no pulses, and the driver resets the board's parser. Numbers avoid bytes
that look like commands, and where one byte of a word may be lost, zeros that follow make it
smaller, never larger. Not guarded: a *doubled* byte (USB and TCP make none); and with
`HeightCodec` the answer says that all has arrived, not what.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar

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

    def scan_us(self, outputs: int, slot_extra_us: int) -> int:
        return outputs * (self.width_us + self.discharge_us + slot_extra_us)


def settings_of(sequence: ScanSequence) -> Settings:
    """Return the settings of a sequence; raise BoardError if its slots need several polarities or
    widths, or a time that is out of reach."""
    _, current_ua = one_against_all(sequence)
    if len(np.unique(np.sign(current_ua))) > 1:
        raise BoardError(
            "some slots are anodic, some cathodic, and this board has one polarity for all: "
            "send them as two sequences",
            about="current_ua",
        )
    if sequence.slots and np.ptp(sequence.width_us):
        raise BoardError(
            f"slots of {int(sequence.width_us.min())} to {int(sequence.width_us.max())} µs in "
            "one sequence, and this board has one pulse width for all",
            about="width_us",
        )
    width = int(sequence.width_us.max(initial=0))
    if sequence.slots and width < SHORTEST_US:
        raise BoardError(
            f"pulses of {width} µs are too short: at least {SHORTEST_US} µs", about="width_us"
        )
    discharge = int(sequence.discharge_us.max(initial=0))
    if discharge >= FIRST_COMMAND:
        raise BoardError(
            f"a discharge of {discharge} µs is too long: at most {FIRST_COMMAND - 1}",
            about="discharge_us",
        )
    rate_hz = max(1, round(1e6 / sequence.period_us))
    return Settings(width, discharge, rate_hz, bool((current_ua < 0).any()))


def slots_of(sequence: ScanSequence, chosen: NDArray[np.bool_]) -> ScanSequence:
    """Return a copy of a sequence with only some of its slots, (S,)."""
    return replace(
        sequence,
        current_ua=sequence.current_ua[chosen],
        width_us=sequence.width_us[chosen],
        discharge_us=sequence.discharge_us[chosen],
        site=sequence.site[chosen],
        proof=None,
    )


def heights(
    sequence: ScanSequence, scale: Scale, limits: SafetyLimits
) -> tuple[NDArray[np.intp], NDArray[np.uint16]]:
    """Return the electrode of each slot, and its height in counts; neither rounding nor a scale
    that is wrong may pass the limits."""
    electrode, current_ua = one_against_all(sequence)
    most = scale.most_counts(limits, sequence.width_us.max(initial=0))
    nearest = np.rint(np.abs(current_ua) / scale.measured_ua)
    counts = np.minimum(np.minimum(nearest, most[electrode]), LARGEST).astype(np.uint16)
    # A byte that looks like a command would be one, if that before it were lost.
    low = counts & 0xFF
    counts -= np.where(low >= FIRST_COMMAND, low - (FIRST_COMMAND - 1), 0).astype(np.uint16)
    return electrode, counts


VOLTS_PER_COUNT = 0.0893
DUMMY_KOHM = 66.0  # load fitted in parallel with the skin; it takes V / 66 kΩ of the current
COMPLIANCE_V = 300.0  # limit of its switches (HV513), the largest voltage of a reading
SENSE_COUNTS, SENSE_US = 100, 50
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


class Codec(ABC):
    """Wire format of one generation, for a number N of outputs."""

    lead: ClassVar[bytes] = b""  # bytes before all others, which end a command whose end was lost
    slot_extra_us: ClassVar[int]
    forgets: ClassVar[bool]  # whether silence ends a partial command
    even: ClassVar[bool]  # whether a slot takes as long without a pulse as with one
    quiet: ClassVar[bytes]  # command that stops all pulses from the next scan on
    sense: ClassVar[bytes]  # ten anodic scans a second, `SENSE_COUNTS` by `SENSE_US`
    question: ClassVar[bytes]  # command that is answered
    answer_bytes: int
    nothing: bytes  # payload of a pattern without any pulse

    def __init__(self, outputs: int) -> None:
        self.outputs = outputs

    def payload(
        self, sequence: ScanSequence, wiring: NDArray[np.intp], scale: Scale, limits: SafetyLimits
    ) -> bytes:
        """Return what a sequence asks of the outputs; raise BoardError if it is impossible."""
        electrode, counts = heights(sequence, scale, limits)
        return self._pattern(wiring[electrode], counts)

    @abstractmethod
    def _pattern(self, output: NDArray[np.intp], counts: NDArray[np.uint16]) -> bytes:
        """Return the patterns of slots that each drive one output, (S,), with a height."""

    def parts(self, payload: bytes) -> list[bytes]:
        """Return the patterns of a payload, each for a scan of its own."""
        return [payload]

    @abstractmethod
    def load(self, payload: bytes) -> bytes:
        """Return the command that loads a pattern while nothing flows."""

    @abstractmethod
    def go(self, payload: bytes) -> bytes:
        """Return the command that starts its pulses from the next scan on."""

    @abstractmethod
    def is_answer(self, answer: bytes) -> bool: ...

    @property
    @abstractmethod
    def zero_anywhere(self) -> bytes:
        """Return the bytes that put the board at zero in any state of its parser. Zeros first: they
        complete any half command as a smaller one, with no pulses meanwhile, and a lost byte costs
        a spare one, never the next command."""

    @property
    def readings_bytes(self) -> int:
        return 2 * self.outputs

    def settings(self, settings: Settings, between_hz: int) -> bytes:
        """Return the commands of the settings, twice, each followed by zeros: were a word's first
        byte lost, they would make it zero, not a longer pulse. At ``between_hz`` scans of the old
        and of the new pulses fit."""
        once = (
            self.quiet + _END + b"\xf9\0" + _END + b"\xf8\0" + _END
            + b"\xf6" + between_hz.to_bytes(2, "little") + _END
            + bytes([0xFD, settings.anodic]) + _END
            + b"\xfa" + settings.width_us.to_bytes(2, "little") + _END
            + bytes([0xF7, settings.discharge_us]) + _END
        )  # fmt: skip
        return once * 2 + (b"\xf6" + settings.rate_hz.to_bytes(2, "little") + _END) * 2


class ModeCodec(Codec):
    """Wire format of commit 71adee2 and later ones."""

    slot_extra_us = 10
    forgets = even = True
    quiet = b"\xfb\x02\xfb\x02"
    sense: ClassVar[bytes] = (
        quiet + b"\xf6\x0a\0\xfd\x01\xf7\x64" + bytes([0xF8, SENSE_US, 0xF9, SENSE_COUNTS])
    )
    question: ClassVar[bytes] = PING

    def __init__(self, outputs: int) -> None:
        super().__init__(outputs)
        self.answer_bytes: int = 1
        self.nothing: bytes = bytes(2 * outputs)

    def _pattern(self, output: NDArray[np.intp], counts: NDArray[np.uint16]) -> bytes:
        heights = np.zeros(self.outputs, np.uint16)
        heights[output] = counts
        return heights.astype("<u2").tobytes()

    def load(self, payload: bytes) -> bytes:
        return b"\xfb\x02\xfe" + payload

    def go(self, payload: bytes) -> bytes:
        return b"\xfb\0"

    @property
    def zero_anywhere(self) -> bytes:
        # No sense pulses, no pulses at all, and a pattern of zeros.
        end = bytes(2 * self.outputs + 4)
        return end + NO_SENSE + b"\xfb\x02\x02\x02\xfe" + bytes(2 * self.outputs)

    def is_answer(self, answer: bytes) -> bool:
        return answer == bytes([self.outputs])


class HeightCodec(Codec):
    """Wire format of commit 936c6c0: one height for all, and no echo but its readings. A sequence
    of several heights becomes as many patterns, one scan each."""

    lead = _END
    slot_extra_us = 17
    forgets = even = False
    quiet: ClassVar[bytes] = (b"\xfb\0\0" + _END) * 2
    # Four counts to a unit; outputs without a pulse of the pattern get a sense pulse.
    sense: ClassVar[bytes] = (
        quiet + b"\xf6\x0a\0\xfd\x01\xf7\x64" + bytes([0xF8, SENSE_US, 0xF9, SENSE_COUNTS // 4])
    )
    question: ClassVar[bytes] = READINGS

    def __init__(self, outputs: int) -> None:
        super().__init__(outputs)
        self.answer_bytes: int = 2 * outputs
        self.nothing: bytes = bytes(outputs + 2)

    def _pattern(self, output: NDArray[np.intp], counts: NDArray[np.uint16]) -> bytes:
        parts = []
        while counts.any():
            # Rounding may split one current into two heights; the lower one is never too much.
            height = int(counts[counts > 0].min())
            chosen = (counts == height) | (counts == height + 1)
            codes = np.zeros(self.outputs, np.uint8)
            codes[output[chosen]] = 1
            parts.append(codes.tobytes() + height.to_bytes(2, "little"))
            counts = np.where(chosen, 0, counts).astype(np.uint16)
        return b"".join(parts) or self.nothing

    def parts(self, payload: bytes) -> list[bytes]:
        size = self.outputs + 2
        return [payload[start : start + size] for start in range(0, len(payload), size)]

    def load(self, payload: bytes) -> bytes:
        return self.quiet + b"\xfe" + payload[:-2]

    def go(self, payload: bytes) -> bytes:
        return b"\xfb" + payload[-2:] + _END

    @property
    def zero_anywhere(self) -> bytes:
        # It ends with zero electrodes: nothing may follow.
        return bytes(2 * self.outputs + 4) + b"".join(AT_REST)

    def is_answer(self, answer: bytes) -> bool:
        return len(answer) == self.answer_bytes
