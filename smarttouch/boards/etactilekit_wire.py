"""The commands of an eTactileKit, version 2, and what of a sequence goes into them.

On the wire (native USB, or TCP port 8080; little endian, no framing, no checksum)::

    FC u8   electrodes N        FB u8   0 monophasic, 1 biphasic, 2 impedance only
    FD u8   1 anodic 0 cathodic FA u16  pulse width µs
    F9 u8   sense height        F8 u8   sense width µs
    F7 u8   discharge µs        F6 u16  scans per second
    FE N×u16 heights in counts  FF      reply N×u16: ADC of the last finished scan
    F5      reply: chips        F4      reply: N, the only echo

A byte lost inside FE would leave the board waiting, and the next byte sent would
complete a pattern shifted by eight bits: up to 41 mA. So every change is guarded:
impedance-only with a sense height of zero (no pulses) goes before it, F4 after it,
and pulses come back only when its echo has come. A lost byte eats the F4: no echo,
no pulses, and the driver starts the board's parser afresh. Heights avoid bytes that
look like commands. A *doubled* byte cannot be told by anything on this wire; USB and
TCP do not double bytes.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.streamed import one_against_all
from smarttouch.errors import BoardError
from smarttouch.scan.sequence import ScanSequence

UA_PER_COUNT = 9.99
"""Nominal; its firmware does not cap 4095 counts, which are 41 mA."""
LARGEST = 1000
"""Counts, about 10 mA: nothing above leaves this host, whatever the limits."""
FIRST_COMMAND = 0xF4
SENSE_COUNTS, SENSE_US = 100, 50
ZEROS = bytes(2 * 255 + 4)
"""More than any command waits for."""
QUIET, ON = bytes([0xFB, 2]), bytes([0xFB, 0])
PING, CHIPS, READINGS = b"\xf4", b"\xf5", b"\xff"
NO_SENSE = b"\xf9\0\0\xf8\0\0"
SENSE = QUIET + b"\xfd\x01\xf7\x64\xf6\x0a\0" + bytes([0xF8, SENSE_US, 0xF9, SENSE_COUNTS])
"""Ten anodic sense scans a second."""


@dataclass(frozen=True)
class Settings:
    """What all slots of a scan share."""

    width_us: int
    discharge_us: int
    rate_hz: int
    anodic: bool

    def commands(self) -> bytes:
        """Return what sets them, twice over, each command followed by zeros that end it.

        Were the first byte of a word lost, the zeros would make it zero, not a longer pulse.
        """
        end = bytes(3)
        once = (
            QUIET + end + b"\xf9\0" + end + b"\xf8\0" + end
            + bytes([0xFD, self.anodic]) + end
            + b"\xfa" + self.width_us.to_bytes(2, "little") + end
            + bytes([0xF7, self.discharge_us]) + end
            + b"\xf6" + self.rate_hz.to_bytes(2, "little") + end
        )  # fmt: skip
        return once * 2


def settings_of(sequence: ScanSequence) -> Settings:
    """Return the settings that a sequence needs.

    Raises
    ------
    BoardError
        If its slots want more than one polarity or width.
    """
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
    discharge = int(sequence.discharge_us.max(initial=0))
    if discharge >= FIRST_COMMAND:
        raise BoardError(f"a discharge of {discharge} µs is too long: at most {FIRST_COMMAND - 1}")
    return Settings(
        int(sequence.width_us.max(initial=0)),
        discharge,
        max(1, round(1e6 / sequence.period_us)),
        bool((current_ua < 0).any()),
    )


def heights_of(
    sequence: ScanSequence, wiring: NDArray[np.intp], ua_per_count: float, most: int
) -> bytes:
    """Return the payload of a pattern: a height in counts for each output, little endian.

    Parameters
    ----------
    wiring : ndarray, (E,)
        The output of each electrode.
    most : int
        Counts that rounding must not pass.
    """
    electrode, current_ua = one_against_all(sequence)
    counts = np.minimum(np.rint(np.abs(current_ua) / ua_per_count), min(most, LARGEST))
    heights = np.zeros(int(wiring.max()) + 1, np.uint16)
    heights[wiring[electrode]] = counts.astype(np.uint16)
    # A byte that looks like a command would be one, if the FE before it were lost.
    low = heights & 0xFF
    heights -= np.where(low >= FIRST_COMMAND, low - (FIRST_COMMAND - 1), 0).astype(np.uint16)
    return heights.astype("<u2").tobytes()


def pattern(heights: bytes) -> bytes:
    """Return a pattern under guard: no pulses from before it until `ON`, then the echo."""
    return QUIET + b"\xfe" + heights + PING
