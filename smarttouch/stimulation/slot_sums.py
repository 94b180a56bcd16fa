"""Exact sums over the slots of a sequence, in memory reused for each frame, and the load of a pass:
pulses that count as felt, and charge, on each electrode.
"""

from typing import Any, NamedTuple

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


BLOCK = 131_072
"""Currents per block: in single precision half a megabyte, which stays in a
processor's own cache."""
_EXACT_SINGLE = 2**24  # bound below which whole numbers are exact in single precision

_largest = np.maximum.reduce


def rows_of_block(electrodes: int) -> int:
    """Return the number of slots per block."""
    return max(1, BLOCK // electrodes)


class SlotSums(NamedTuple):
    """Sums over the currents of S slots."""

    net_ua: NDArray[np.floating]  # (S,) zero where a slot is in balance
    total_ua: NDArray[np.floating]  # (S,) sum of magnitudes
    highest_ua: int  # largest magnitude of all
    sums: Sums  # (3, E) load of each electrode, and its charge, positive cathodic


class SlotAdder:
    """Adder of slots, block by block, that counts pulses from currents `felt_ua`, (E,), on; not for
    two threads at once."""

    def __init__(self, felt_ua: NDArray[np.float32]) -> None:
        self._felt_ua, self._electrodes = felt_ua, len(felt_ua)
        self._rows = rows_of_block(self._electrodes)
        self._most = max(self._rows, self._electrodes)
        self._scratch: dict[type[np.floating], tuple[NDArray[Any], NDArray[Any]]] = {}

    def add_up(
        self,
        current_ua: NDArray[np.int16],
        width_us: NDArray[np.uint16],
        kind: type[np.floating] = np.float32,
    ) -> SlotSums:
        """Return the sums of slots, currents (S, E) and widths (S,), S > 0, again in double
        precision where single is not exact."""
        slots = len(current_ua)
        if kind not in self._scratch:
            block = np.empty((self._rows, self._electrodes), kind)
            self._scratch[kind] = block, np.ones(self._most, kind)
        scratch, ones = self._scratch[kind]
        across = ones[: self._electrodes]
        one_us = int(width_us[0])
        alike = bool((width_us == one_us).all())
        times_us = one_us if alike else 1
        units = np.array([[PER_PULSE], [PER_PC * times_us], [times_us]], np.float64)
        net, total = np.empty(slots, kind), np.empty(slots, kind)
        of_block = np.empty((3, self._electrodes), kind if alike else np.float64)
        sums = np.empty(of_block.shape)
        highest = 0
        for first in range(0, slots, self._rows):
            part = slice(first, min(slots, first + self._rows))
            block = scratch[: part.stop - first]
            down = ones[: len(block)]
            np.copyto(block, current_ua[part])
            block.dot(across, out=net[part])
            each = down if alike else width_us[part].astype(np.float64)
            each.dot(block, out=of_block[2])
            np.abs(block, out=block)
            highest = max(highest, int(_largest(block, axis=None)))
            block.dot(across, out=total[part])
            each.dot(block, out=of_block[1])
            np.greater_equal(block, self._felt_ua, out=block, casting="unsafe")
            of_block[0] = down.dot(block)
            if first:
                sums += of_block * units
            else:
                np.multiply(of_block, units, out=sums)
        # No sum on the way is larger than that of all magnitudes.
        if kind is np.float32 and highest * self._most >= _EXACT_SINGLE:
            return self.add_up(current_ua, width_us, np.float64)
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
