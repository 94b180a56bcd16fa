"""Sums of kernels of which no subset breaks a bound: the slots of a frame without a search."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from smarttouch.kernels.frame_fields import FrameBounds
from smarttouch.kernels.proved_sets import Certainty, SharedKernels

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SharedSlots:
    """Slots of several points, at full intensity."""

    level: Array  # (S, P) requested level at each point of a slot, 0 at all others
    current_ma: Array  # (S, E)
    points: NDArray[np.intp]  # (S,) number of points of each slot
    # (2, S) effects on other classes, and on their own elsewhere; of sums `figures`
    do: NDArray[np.float32]
    # proved set of each slot's points, (S,) or empty
    owner: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, np.intp))
    most_ma: float = np.inf  # most that a slot carries in all
    # (S + 1,) start of each slot's kernels in `kernel`, and the last one's end
    first: NDArray[np.intp] = field(default_factory=lambda: np.zeros(1, np.intp))
    # (N,) rows of `KernelSums.kernels_ma` that slots are sums of
    kernel: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, np.intp))
    share: Array = field(default_factory=lambda: np.empty(0))  # (N,) factor of each

    def without(self, broken: NDArray[np.bool_]) -> "SharedSlots":
        """Return the other slots."""
        kept = ~broken
        size = np.diff(self.first) if len(self.owner) else np.zeros(len(kept), np.intp)
        own = kept.repeat(size)
        return SharedSlots(
            self.level[kept],
            self.current_ma[kept],
            self.points[kept],
            self.do[:, kept],
            self.owner[kept] if len(self.owner) else self.owner,
            self.most_ma,
            np.concatenate([[0], size[kept].cumsum()]),
            self.kernel[own],
            self.share[own],
        )


class KernelSums:
    """Adds up kernels of proved sets, as many at once as total current allows.

    There are sets for each class, of P sites in all. Targets get the fraction `aim` of their wish,
    all cathodes of a slot together `most_ma`, and active points a level of `faintest` at least.
    """

    def __init__(
        self,
        sets: Sequence[Sequence[SharedKernels]],
        points: int,
        aim: float,
        most_ma: float,
        bounds: FrameBounds,
        faintest: float,
    ) -> None:
        self._points_n, self._aim, self._most_ma = points, aim, most_ma
        self._electrodes = points // len(sets)
        every = [(index, each) for index, own in enumerate(sets) for each in own]
        nothing = np.empty(0, np.intp)
        self._points = np.concatenate(
            [nothing, *(each.sites + index * self._electrodes for index, each in every)]
        )
        self.kernels_ma = np.concatenate(
            [np.empty((0, self._electrodes)), *(each.kernels for _, each in every)]
        )
        """Kernels of all sets, (A, E) mA."""
        self.sites = self._points % self._electrodes
        """Site of each, (A,)."""
        self._scratch_ma = np.empty_like(self.kernels_ma)
        self._totals_ma = np.concatenate([np.empty(0), *(each.totals_ma for _, each in every)])
        self._owner = np.repeat(np.arange(len(every)), [len(each.sites) for _, each in every])
        self._certain = Certainty.of([each for _, each in every], aim, faintest, most_ma)
        self.certain_from = self._certain.least(bounds)
        """Intensity from which no sum breaks a bound, whatever rounding to whole numbers does."""
        self.rounding_ua = self._certain.total_ua
        """Most that rounding adds to a slot's total current."""
        self.figures = lru_cache(maxsize=1)(self._certain.figures)
        """Upper bounds of any slot's worst other and worst spill at an intensity, of each set, (2,
        sets)."""

    def most_ma(self, alone_ma: Array) -> Array:
        """Return an upper bound of each electrode's magnitudes summed over a frame, (E,) mA, where
        points alone have kernels (P, E) mA."""
        each_ma = np.abs(alone_ma)
        np.maximum.at(each_ma, self._points, np.abs(self.kernels_ma))
        return np.asarray(each_ma.sum(axis=0))

    def add_up(self, level: Array) -> SharedSlots:
        """Return the slots that several points share, at levels (P,)."""
        wanted = level.take(self._points)
        active = wanted.nonzero()[0]
        aimed, owner = self._aim * wanted.take(active), self._owner.take(active)
        totals_ma = aimed * self._totals_ma.take(active)
        # Set after set, the strongest of each first.
        order = np.lexsort((-totals_ma, owner))
        parts, most_ma = _parts(
            totals_ma.take(order).tolist(), owner.take(order).tolist(), self._most_ma
        )
        count = len(parts)
        size = np.fromiter(map(len, parts), np.intp, count)
        index = order.take(np.fromiter(chain.from_iterable(parts), np.intp))
        chosen, owner = active.take(index), owner.take(index)
        ends = size.cumsum()
        starts = ends - size
        levels = np.zeros((count, self._points_n))
        slot = np.arange(count).repeat(size)
        levels[slot, self._points.take(chosen)] = wanted.take(chosen)
        aimed = aimed.take(index)
        current_ma = self._added(chosen, aimed, slot, starts)
        first = owner.take(starts)
        do = np.zeros((2, count), np.float32)
        lists = np.concatenate([[0], ends]), chosen, aimed
        return SharedSlots(levels, current_ma, size, do, first, most_ma, *lists)

    def _added(
        self,
        kernel: NDArray[np.intp],
        share: Array,
        slot: NDArray[np.intp],
        start: NDArray[np.intp],
    ) -> Array:
        """Return kernels times shares, (N,) slot after slot, summed in each, (S, E) mA.

        Slots are padded to one length by the first kernel times zero, and all added at once.
        """
        place = np.arange(len(slot)) - start.take(slot)
        shape = int(place.max(initial=0)) + 1, len(start)
        rows, shares = np.zeros(shape, np.intp), np.zeros(shape)
        rows[place, slot], shares[place, slot] = kernel, share
        if rows.size > len(self._scratch_ma):
            self._scratch_ma = np.empty((rows.size, self._electrodes))
        added_ma = self._scratch_ma[: rows.size]
        # With "raise", numpy would fill a copy first.
        self.kernels_ma.take(rows.ravel(), axis=0, out=added_ma, mode="clip")
        added_ma *= shares.reshape(-1, 1)
        return np.asarray(np.add.reduce(added_ma.reshape(*shape, self._electrodes)))


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
