"""Hardware of the published kits: their one source, and the generations of their firmware."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from smarttouch.emulator.finger_events import EmulatedFinger
from smarttouch.emulator.firmware import DeliveryLog
from smarttouch.emulator.skin import SkinCircuit

VOLTS_PER_COUNT = 0.0893  # scale of the eTactileKit's converter; assumed for its relative's as well
LARGEST_READING = 4095


class SingleSource:
    """Output stage of a kit, with the skin connected; a shunt is a load beside the skin."""

    def __init__(
        self,
        books: DeliveryLog,
        finger: EmulatedFinger | None,
        compliance_v: float,
        shunt_ohm: float = math.inf,
    ) -> None:
        self.books = books
        self._skin = SkinCircuit(books.electrodes, compliance_v=compliance_v)
        self._finger = finger or EmulatedFinger(books.electrodes)
        self._shunt_ohm = shunt_ohm
        self._state = np.zeros(books.electrodes, np.int8)
        self._rested_ns = 0

    def pulse(
        self,
        number: int,
        electrode: int,
        current_ua: float,
        width_us: float,
        start_ns: int,
        *,
        among: int,
        rest_us: float,
        slot: int | None = None,
        grounded: bool = True,
        more: bool = False,
    ) -> int:
        """Deliver a pulse, ground all outputs for the rest after it, and record both; return the
        converter's reading at its end.

        Current is positive cathodic; the first ``among`` electrodes take part, one against the
        others. Before it, outputs were ``grounded`` or unconnected; with ``more``, another pulse of
        the slot follows. The slot's number is the electrode's if not given.
        """
        self._finger.at(start_ns / 1e9, self._skin)
        if start_ns > self._rested_ns:
            pass_time = self._skin.short if grounded else self._skin.idle
            pass_time((start_ns - self._rested_ns) / 1000)
        sign = 1 if current_ua > 0 else -1
        self._state[:among], self._state[among:] = -sign, 0
        if electrode < len(self._state):
            self._state[electrode] = sign
        delivered = self._skin.switched_pulse(
            self._state, abs(current_ua), width_us, self._shunt_ohm
        )
        if rest_us:
            self._skin.short(rest_us)
        self._rested_ns = start_ns + round(1000 * (width_us + rest_us))
        self.books.enter(
            number,
            electrode if slot is None else slot,
            electrode,
            delivered,
            width_us,
            self._skin.residual_uc,
            start_ns // 1000,
            more=more,
        )
        flowed = bool(delivered.current_ua.any())
        volts = delivered.source_v if flowed else self._skin.compliance_v
        return min(LARGEST_READING, int(volts / VOLTS_PER_COUNT))


PATTERN, READINGS, COUNT, MODE, POLARITY, WIDTH = 0xFE, 0xFF, 0xFC, 0xFB, 0xFD, 0xFA
SENSE_HEIGHT, SENSE_WIDTH, DISCHARGE, RATE, CHIPS, ECHO = 0xF9, 0xF8, 0xF7, 0xF6, 0xF5, 0xF4
BIPHASIC, SENSE_ONLY = 1, 2
LARGEST = LARGEST_READING
SHORTEST_US = 6.6  # time to switch the source on and off
Pulse = tuple[int, float, tuple[int, ...]]  # height in counts, width µs, signs (+ cathodic)
_SIZES = {
    COUNT: 1,
    MODE: 1,
    POLARITY: 1,
    WIDTH: 2,
    SENSE_HEIGHT: 1,
    SENSE_WIDTH: 1,
    DISCHARGE: 1,
    RATE: 2,
}


@dataclass(frozen=True)
class Generation:
    """One published firmware."""

    sizes: Mapping[int, int]  # bytes after each op-code that sets a number
    # Of each electrode in a pattern: 2 for its height, 1 for a code (0 sense, 1 monophasic,
    # 2 biphasic) where one height counts for all.
    height_bytes: int
    reading_bytes: int = 2  # of each electrode in the answer to `READINGS`
    echoes: bool = True  # whether it has `ECHO`
    forgets: bool = True  # whether half a command is dropped after two seconds
    waits: bool = True  # whether its parser stands still during a scan: one processor core
    slot_ns: int = 10_000  # that switching adds to each slot's pulse and discharge
    silence_ns: int | None = None  # after so long without a byte all amplitudes are zero

    @property
    def has_modes(self) -> bool:
        """True if `MODE` sets a mode; else it sets a height for all electrodes."""
        return self.height_bytes == 2

    def pulse(self, numbers: Mapping[int, int], height: int) -> Pulse:
        """Return an electrode's height in counts, width in µs, and the signs of its phases, from
        all that commands have set, by op-code, and its height or code in the pattern."""
        sense, own = numbers[SENSE_HEIGHT], -1 if numbers[POLARITY] else 1
        if self.has_modes:
            senses, biphasic = numbers[MODE] == SENSE_ONLY, numbers[MODE] == BIPHASIC
            phases = (own, -own) if biphasic else (own,)
        else:
            code, sense = height, 4 * sense
            one_byte = self.sizes[MODE] == 1
            senses = code == 0 if one_byte else code not in (1, 2)
            phases = (-1, 1) if code == 2 and not one_byte else (own,)
            height = 4 * min(numbers[MODE], 250) if one_byte else min(numbers[MODE], LARGEST)
        if senses:
            return sense, max(float(numbers[SENSE_WIDTH]), SHORTEST_US), (own,)
        return height, max(float(numbers[WIDTH]), SHORTEST_US), phases


GENERATIONS = {
    "v1.0": Generation(
        dict.fromkeys(_SIZES, 1), 1, reading_bytes=1, echoes=False, forgets=False, waits=False
    ),
    "936c6c0": Generation(_SIZES | {MODE: 2}, 1, echoes=False, forgets=False, slot_ns=17_000),
    "71adee2": Generation(_SIZES, 2),
    "newest": Generation(_SIZES, 2, waits=False, silence_ns=500_000_000),
}
"""Firmwares by the first commit of their repository that has them; the last one parses on a second
processor core.
"""
