"""Exact sums over the slots of a sequence, in memory reused for each frame."""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.stimulation.pass_load import PER_PC, PER_PULSE, Load, Sums

BLOCK = 131_072
"""Currents per block: in single precision half a megabyte, which stays in a
processor's own cache."""
_EXACT_SINGLE = 2**24
"""Bound below which whole numbers are exact in single precision."""

_largest = np.maximum.reduce


def rows_of_block(electrodes: int) -> int:
    """Return the number of slots per block."""
    return max(1, BLOCK // electrodes)


@lru_cache(maxsize=256)
def extent_us(data: bytes) -> tuple[int, int, int]:
    """Return the shortest, longest and total time of slots, µs, of uint16 as bytes; or zeros."""
    times_us = np.frombuffer(data, np.uint16)
    if not len(times_us):
        return 0, 0, 0
    return int(times_us.min()), int(times_us.max()), int(times_us.sum(dtype=np.int64))


class SlotSums(NamedTuple):
    """Sums over the currents of S slots."""

    net_ua: NDArray[np.floating]  # (S,) zero where a slot is in balance
    total_ua: NDArray[np.floating]  # (S,) sum of magnitudes
    highest_ua: int  # largest magnitude of all
    sums: Sums  # (3, E) load of each electrode, and its charge, positive cathodic

    @property
    def load(self) -> Load:
        return self.sums[:2]


@lru_cache(maxsize=256)
def _units(width_us: int) -> NDArray[np.float64]:
    """Return the factors of sums of pulses, magnitudes and currents, (3, 1)."""
    return np.array([[PER_PULSE], [PER_PC * width_us], [width_us]], np.float64)


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
        each_us, longest_us, _ = extent_us(width_us.tobytes())
        alike = each_us == longest_us
        net, total = np.empty(slots, kind), np.empty(slots, kind)
        of_block = np.empty((3, self._electrodes), kind if alike else np.float64)
        units = _units(each_us if alike else 1)
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
