"""Kernels in whole numbers, and slots as sums of them: the same µA here and on a board.

A weight is an int16, 32,767 the largest of its kernel; an amplitude counts quarters of a µA. What
flows is defined to the bit, by `KernelLists.current_ua`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from smarttouch.afferent import Afferent

PEAK = 32_767
"""Largest magnitude of a kernel's weights."""
PER_UA = 4
"""Amplitudes are in quarters of a µA."""
SHIFT = 17
"""A weight of 2^15 times an amplitude of 4 is one µA: 2^17."""
MOST_KERNELS = 0xFFFF
_BLOCK = 1 << 15
_ABOVE = 1 << 30
"""Above what any slot's electrodes carry together, µA; a multiple of 2^16."""

Shared = Mapping[Afferent, tuple[NDArray[np.float64], NDArray[np.intp]]]


@dataclass(frozen=True, eq=False)
class KernelTable:
    """Kernels of a run in whole numbers."""

    # (K, E) positive cathodic, peak `PEAK`, sum zero; rows of masked sites are zero
    weights: NDArray[np.int16]
    site: NDArray[np.uint16]  # (K,) electrode of each
    points: dict[Afferent, int]  # row of electrode 0 of each class
    shared: dict[Afferent, int]  # first row of the kernels of each class that share slots

    @cached_property
    def ua_so_far(self) -> NDArray[np.float64]:
        """Sum of each kernel's currents from electrode 0 to each, (K, E) µA, at amplitude 1."""
        summed = np.cumsum(self.weights, axis=1, dtype=np.float64)
        # By a power of two: exact.
        summed *= 2.0**-SHIFT
        summed.setflags(write=False)
        return summed

    @classmethod
    def of(cls, weights: Mapping[Afferent, NDArray[np.float64]], shared: Shared) -> "KernelTable":
        """Return a bank's kernels, (E, E), and those that share slots, (A, E), and their sites
        (A,), of any scale, in whole numbers."""
        every = {each: (own, np.arange(len(own))) for each, own in weights.items()}
        parts: list[NDArray[np.float64]] = []
        sites: list[NDArray[np.intp]] = []
        points: dict[Afferent, int] = {}
        sharing: dict[Afferent, int] = {}
        # Those in use first: a board may not have room for all.
        for first, kernels in ((sharing, shared), (points, every)):
            for afferent in sorted(kernels):
                first[afferent] = sum(map(len, parts))
                parts.append(np.asarray(kernels[afferent][0], np.float64))
                sites.append(kernels[afferent][1])
        site = np.concatenate(sites).astype(np.uint16)
        return cls(quantized(np.concatenate(parts)), site, points, sharing)


def quantized(kernels: NDArray[np.float64]) -> NDArray[np.int16]:
    """Return kernels (K, E) as whole numbers, each row with sum zero; zero stays zero."""
    peak = np.abs(kernels).max(axis=1, keepdims=True, initial=0)
    carried = np.cumsum(kernels * (PEAK / np.where(peak > 0, peak, 1)), axis=1)
    carried[:, -1:] = 0
    # Halves upward: to even, the peak of (-0.5, 1, -0.5) would be 32,768. Sums of doubles are
    # exact to far less than the sixth decimal.
    whole = np.floor(carried.round(6) + 0.5)
    return np.asarray(np.diff(whole, axis=1, prepend=0), np.int16)


@dataclass(frozen=True, eq=False)
class KernelLists:
    """Slots as lists of kernels with amplitudes."""

    table: KernelTable
    # (S + 1,) start of each slot's list, and the last one's end; none is empty
    first: NDArray[np.intp]
    kernel: NDArray[np.uint16]  # (N,) row in the table
    amplitude: NDArray[np.uint16]  # (N,) in quarters of a µA; those of a slot sum to at most 65,535

    @property
    def site(self) -> NDArray[np.uint16]:
        """Site of each slot, (S,): that of its first kernel."""
        return self.table.site[self.kernel[self.first[:-1]]]

    def current_ua(self) -> NDArray[np.int16]:
        """Return the currents that flow, (S, E) µA, positive cathodic.

        Of weights times amplitudes, added up, the sum from electrode 0 to each one is rounded to
        whole µA, halves upward; an electrode gets the difference of two of these.
        """
        first, slots, so_far = self.first, len(self.first) - 1, self.table.ua_so_far
        found = np.empty((slots, so_far.shape[1]), np.int16)
        amplitude = self.amplitude.astype(np.float64)[:, None]
        # By as many slots as stay in the processor's cache.
        step = max(1, _BLOCK // so_far.shape[1])
        for start in range(0, slots, step):
            rows = slice(start, min(start + step, slots))
            pairs = slice(first[start], first[rows.stop])
            # In doubles all of it is exact: sums stay far below 2^36, in parts of 2^-17.
            scaled = so_far[self.kernel[pairs]]
            scaled *= amplitude[pairs]
            if len(scaled) > rows.stop - start:
                scaled = np.add.reduceat(scaled, first[rows] - first[start], axis=0)
            scaled += _ABOVE + 0.5
            # Nothing is negative now, and cut off is rounded down; what is above 16 bits cancels.
            whole = scaled.astype(np.int64).astype(np.int16)
            found[rows, 0] = whole[:, 0]
            np.subtract(whole[:, 1:], whole[:, :-1], out=found[rows, 1:])
        return found

    def joined(self, other: "KernelLists") -> "KernelLists":
        """Return these slots, and then others of the same table."""
        return KernelLists(
            self.table,
            np.concatenate([self.first, self.first[-1] + other.first[1:]]),
            np.concatenate([self.kernel, other.kernel]),
            np.concatenate([self.amplitude, other.amplitude]),
        )


def largest_amplitude(
    weights: NDArray[np.int16], most_ua: NDArray[np.float64]
) -> NDArray[np.uint16]:
    """Return the largest amplitude of each kernel (K, E) that keeps whole limits (E,) µA."""
    room = np.floor(most_ua) * 2.0**SHIFT / np.maximum(np.abs(weights.astype(np.float64)), 1)
    return np.asarray(np.minimum(np.floor(room.min(axis=1)), 0xFFFF), np.uint16)
