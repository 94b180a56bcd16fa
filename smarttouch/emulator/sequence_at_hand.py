"""What an emulated ``link`` board holds: room, the sequence at hand, and the scan that it is of."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.link.protocol import WireSequence
from smarttouch.emulator.link_limits import MAX_SLOTS, Load
from smarttouch.emulator.link_packets import ReceivedSequence
from smarttouch.emulator.rules_over_time import Ramp

PACKET_BYTES = 1 << 20
KERNEL_BYTES = 1 << 23
MOST_KERNELS = 4096


@dataclass(frozen=True)
class Room:
    """What a board has room for: a small one gets a scan in parts."""

    slots: int = MAX_SLOTS
    packet_bytes: int = PACKET_BYTES
    kernel_bytes: int = KERNEL_BYTES
    kernels: int = MOST_KERNELS


@dataclass
class ScanSoFar:
    """Parts of a scan that were accepted: to the rules they are one sequence with those to come."""

    period_us: int
    intensity: int
    rise_us: int  # when it was to begin, on the skin
    rise: Ramp  # as it was before the scan
    load: Load
    more: bool = True

    def goes_on_in(self, lists: ReceivedSequence) -> bool:
        same = (self.period_us, self.intensity) == (lists.sequence.period_us, lists.intensity)
        return self.more and same


@dataclass
class SequenceAtHand:
    """Sequence that executes, or waits to."""

    number: int
    sequence: WireSequence
    load: Load | None  # of a pass; None without slots
    left: int  # number of remaining scans, with the current one
    more: bool = False  # whether it is a part of a scan that goes on
    goes_on: bool = False
    came_ns: int = 0
    start_ns: int = 0
    starts_ns: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    end_ns: int = 0
    done: int = 0
    volts: list[float] = field(default_factory=list)
    recharge_ns: int | None = None  # start of its recharge phase, until that has been recorded

    @property
    def over_ns(self) -> int:
        """End of the last slot or recharge phase of the pass at hand."""
        sequence = self.sequence
        busy_us = int(
            sequence.width_us.sum(dtype=np.int64) + sequence.discharge_us.sum(dtype=np.int64)
        )
        return self.start_ns + 1000 * (busy_us + sequence.recharge_us)

    def begin(self, start_ns: int, scan_end_ns: int) -> None:
        """Begin a pass; that of a scan's further part ends when the scan does."""
        sequence = self.sequence
        lengths = sequence.width_us.astype(np.int64) + sequence.discharge_us
        self.start_ns, self.done = start_ns, 0
        self.starts_ns = start_ns + 1000 * (np.cumsum(lengths) - lengths)
        self.end_ns = start_ns + 1000 * sequence.period_us
        if self.goes_on:
            self.end_ns = max(scan_end_ns, self.over_ns)
        recharges = sequence.recharge_ua is not None
        self.recharge_ns = start_ns + 1000 * int(lengths.sum()) if recharges else None
        self.volts.clear()
