"""Sums of kernels of which no subset breaks a bound: the slots of a frame without a search."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from smarttouch.kernels.frame_fields import FrameBounds
from smarttouch.kernels.proved_sets import Certainty, SharedKernels

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SummedSlots:
    """Slots as sums of kernels, at full intensity; levels and currents are made when needed."""

    sums: "KernelSums"
    points: NDArray[np.intp]  # (S,) number of points of each slot
    owner: NDArray[np.intp]  # (S,) proved set of each slot's points
    most_ma: float  # most that a slot carries in all
    first: NDArray[np.intp]  # (S + 1,) start of each slot in `kernel`, and the last one's end
    kernel: NDArray[np.intp]  # (N,) rows of `KernelSums.kernels_ma` that slots are sums of
    wanted: Array  # (N,) requested level of each one's point
    share: Array  # (N,) factor of each kernel

    @cached_property
    def level(self) -> Array:
        """Requested level at each point of a slot, (S, P); 0 at all others."""
        level = np.zeros((len(self.points), self.sums.points_n))
        slot = np.arange(len(self.points)).repeat(self.points)
        level[slot, self.sums.points.take(self.kernel)] = self.wanted
        return level

    @cached_property
    def current_ma(self) -> Array:
        """Kernels times shares, summed in each slot, (S, E)."""
        if not len(self.kernel):
            return np.empty((0, self.sums.kernels_ma.shape[1]))
        scaled_ma = self.sums.kernels_ma.take(self.kernel, axis=0)
        scaled_ma *= self.share[:, None]
        return np.asarray(np.add.reduceat(scaled_ma, self.first[:-1], axis=0))

    def left(self, level: Array) -> Array:
        """Return levels, (P,), without those of the points in these slots."""
        left = level.copy()
        left[self.sums.points.take(self.kernel)] = 0
        return left

    def without(self, broken: NDArray[np.bool_]) -> "SummedSlots":
        """Return the other slots."""
        kept = ~broken
        own, points = kept.repeat(self.points), self.points[kept]
        return replace(
            self, points=points, owner=self.owner[kept],
            first=np.concatenate([[0], points.cumsum()]), kernel=self.kernel[own],
            wanted=self.wanted[own], share=self.share[own],
        )  # fmt: skip


class KernelSums:
    """Adds up kernels of proved sets of a class, as many at once as total current allows.

    Targets get the fraction `aim` of their wish, all cathodes of a slot together `most_ma`, and
    active points a level of `faintest` at least.
    """

    def __init__(
        self,
        sets: Sequence[SharedKernels],
        electrodes: int,
        aim: float,
        most_ma: float,
        bounds: FrameBounds,
        faintest: float,
    ) -> None:
        self.points_n: int = electrodes
        self._aim, self._most_ma = aim, most_ma
        self.points: NDArray[np.intp] = np.concatenate(
            [np.empty(0, np.intp), *(each.sites for each in sets)]
        )
        """Site of each kernel, (A,)."""
        self.kernels_ma: Array = np.concatenate(
            [np.empty((0, electrodes)), *(each.kernels for each in sets)]
        )
        """Kernels of all sets, (A, E) mA."""
        self.peaks_ma: Array = np.abs(self.kernels_ma).max(axis=1, initial=0)
        """Largest magnitude of each, (A,)."""
        self._totals_ma = np.concatenate([np.empty(0), *(each.totals_ma for each in sets)])
        self._owner = np.repeat(np.arange(len(sets)), [len(each.sites) for each in sets])
        self._certain = Certainty.of(sets, aim, faintest, most_ma)
        self.certain_from: float = self._certain.least(bounds)
        """Intensity from which no sum breaks a bound, whatever rounding to whole numbers does."""
        self.rounding_ua: float = self._certain.total_ua
        """Most that rounding adds to a slot's total current."""
        self.figures: Callable[[float], Array] = lru_cache(maxsize=1)(self._certain.figures)
        """Upper bounds of any slot's worst other and worst spill at an intensity, of each set, (2,
        sets)."""

    def most_ma(self, alone_ma: Array) -> Array:
        """Return an upper bound of each electrode's magnitudes summed over a frame, (E,) mA, where
        points alone have kernels (P, E) mA."""
        each_ma = np.abs(alone_ma)
        np.maximum.at(each_ma, self.points, np.abs(self.kernels_ma))
        return np.asarray(each_ma.sum(axis=0))

    def add_up(self, level: Array) -> SummedSlots:
        """Return the slots that several points share, at levels (P,)."""
        wanted = level.take(self.points)
        active = wanted.nonzero()[0]
        wanted, owner = wanted.take(active), self._owner.take(active)
        share = self._aim * wanted
        totals_ma = share * self._totals_ma.take(active)
        # Set after set, the strongest of each first.
        order = np.lexsort((-totals_ma, owner))
        parts, most_ma = _parts(
            totals_ma.take(order).tolist(), owner.take(order).tolist(), self._most_ma
        )
        size = np.fromiter(map(len, parts), np.intp, len(parts))
        index = order.take(np.fromiter(chain.from_iterable(parts), np.intp))
        first = np.zeros(len(parts) + 1, np.intp)
        size.cumsum(out=first[1:])
        return SummedSlots(
            self, size, owner.take(index.take(first[:-1])), most_ma, first, active.take(index),
            wanted.take(index), share.take(index),
        )  # fmt: skip


def _parts(
    totals_ma: list[float], owners: list[int], most_ma: float
) -> tuple[list[list[int]], float]:
    """Return groups of each owner's points, each in the first with room below a total, and the
    largest total of a group."""
    parts: list[list[int]] = []
    sums_ma: list[float] = []
    first, before = 0, -1
    for index, (total_ma, owner) in enumerate(zip(totals_ma, owners, strict=True)):
        if owner != before:
            first, before = len(parts), owner
        for part in range(first, len(parts)):
            if sums_ma[part] + total_ma <= most_ma:
                parts[part].append(index)
                sums_ma[part] += total_ma
                break
        else:
            parts.append([index])
            sums_ma.append(total_ma)
    return [part for part in parts if len(part) > 1], max(sums_ma, default=0.0)
