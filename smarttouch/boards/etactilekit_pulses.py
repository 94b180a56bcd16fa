"""Settings and pulse heights that an eTactileKit needs for a sequence."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.scale import Scale
from smarttouch.boards.single_source import one_against_all
from smarttouch.errors import BoardError
from smarttouch.stimulation.safety import SafetyLimits
from smarttouch.stimulation.sequence import ScanSequence

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
    """Return the settings of a sequence; raise BoardError if its slots want several polarities or
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
