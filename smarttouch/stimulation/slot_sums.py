"""Exact sums over the slots of a sequence, in memory reused for each frame, and the load of a pass:
pulses that count as felt, and charge, on each electrode.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.profile.ceilings import BURST_S, CEILING_MEAN_MA, CEILING_NET_MA, CEILING_PULSES_HZ

WINDOW_NS = 1_000_000_000
BURST_US = round(1e6 * BURST_S)
PER_PULSE = 1_000_000
PER_PC = round(1000 * CEILING_PULSES_HZ / (1e6 * CEILING_MEAN_MA))
"""Weights that give felt pulses and charge one limit, in whole numbers: 3 of it for 1 pC, a
million for a pulse, and `MOST_PER_US` of either for each microsecond."""
MOST_PER_US = round(CEILING_PULSES_HZ)
NET_PC = round(1e9 * CEILING_NET_MA)  # largest net charge of an electrode in a second
PLANNED = 0.9
"""Part of the limit used by schedules, so that jittered steps keep the window of a second."""

Load = NDArray[np.float64]
"""Felt pulses × `PER_PULSE` and charge in pC × `PER_PC` of each electrode, (2, E): whole numbers,
all far below 2^53, where doubles are exact."""
Charge = NDArray[np.float64]
"""Signed charge of each electrode, positive cathodic, (E,) pC: whole numbers below 2^53."""


Sums = NDArray[np.float64]  # load and signed charge of each electrode, (3, E)


class PassLoad(NamedTuple):
    """Load of one pass of a sequence on each electrode."""

    sums: Sums  # (3, E): load and net charge, with its recharge phase
    recharge_pc: Charge | None  # (E,), of its recharge phase if it has one, positive cathodic
    busy_us: int  # time of its slots and its recharge phase
    peak_pc: int  # largest charge of one pulse of its slots; 0 if none has current


def shortest_period_us(load: Load) -> int:
    """Return the shortest period that a schedule plans for a load, µs.

    Above `BURST_US` it is more than any period allows.
    """
    return int(np.ceil(load.max(initial=0) / (PLANNED * MOST_PER_US)))


BLOCK = 65_536
"""Currents per block: half a megabyte in doubles, which stays in a processor's own cache."""


def rows_of_block(electrodes: int) -> int:
    """Return the number of slots per block."""
    return max(1, BLOCK // electrodes)


class SlotSums(NamedTuple):
    """Sums over the currents of S slots."""

    net_ua: NDArray[np.float64]  # (S,) zero where a slot is in balance
    total_ua: NDArray[np.float64]  # (S,) sum of magnitudes
    highest_ua: int  # largest magnitude of all
    sums: Sums  # (3, E) load of each electrode, and its charge, positive cathodic


class SlotAdder:
    """Adder of slots, block by block, that counts pulses from currents `felt_ua`, (E,), on; not for
    two threads at once. All sums are whole numbers below 2^53, where doubles are exact."""

    def __init__(self, felt_ua: NDArray[np.float32]) -> None:
        self._felt_ua, self._rows = felt_ua, rows_of_block(len(felt_ua))
        self._scratch = np.empty((self._rows, len(felt_ua)))
        self._ones = np.ones(max(self._scratch.shape))

    def add_up(self, current_ua: NDArray[np.int16], width_us: NDArray[np.uint16]) -> SlotSums:
        """Return the sums of slots, currents (S, E) and widths (S,), S > 0."""
        slots, electrodes = current_ua.shape
        across, wide_us = self._ones[:electrodes], width_us.astype(np.float64)
        net, total = np.empty(slots), np.empty(slots)
        sums, highest = np.zeros((3, electrodes)), 0
        for first in range(0, slots, self._rows):
            part = slice(first, min(slots, first + self._rows))
            block = self._scratch[: part.stop - first]
            np.copyto(block, current_ua[part])
            block.dot(across, out=net[part])
            sums[2] += wide_us[part].dot(block)
            np.abs(block, out=block)
            highest = max(highest, int(np.maximum.reduce(block, axis=None)))
            block.dot(across, out=total[part])
            sums[1] += wide_us[part].dot(block)
            np.greater_equal(block, self._felt_ua, out=block, casting="unsafe")
            sums[0] += self._ones[: len(block)].dot(block)
        sums[:2] *= [[PER_PULSE], [PER_PC]]
        return SlotSums(net, total, highest, sums)


def round_charge_balanced(current_ua: NDArray[np.float64]) -> NDArray[np.int16]:
    """Return currents (S, E) in whole µA that sum to zero in every slot, like the given ones.

    The rounding error is carried on from electrode to electrode, so that none is off by a whole µA.
    """
    carried = np.cumsum(current_ua, axis=1)
    np.rint(carried, out=carried)
    whole = np.empty(carried.shape, np.int16)
    whole[:, :1] = carried[:, :1]
    np.subtract(carried[:, 1:], carried[:, :-1], out=whole[:, 1:], casting="unsafe")
    return whole
