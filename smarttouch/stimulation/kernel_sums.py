"""Sums of kernels of which no subset breaks a bound: the slots of a frame without a search."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from smarttouch.kernels.frames.bound import Certainty, SharedKernels
from smarttouch.kernels.frames.figures import FrameBounds

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Found:
    """Slots of several points, at full intensity.

    Attributes
    ----------
    level : ndarray, (S, P)
        Requested level at each point of a slot, 0 at all others.
    current_ma : ndarray, (S, E) mA
    points : ndarray, (S,) intp
        Number of points of each slot.
    do : ndarray, (2, S) float32
        Effects of the currents on other classes, and on their own elsewhere; of sums of kernels
        see `KernelSums.figures`.
    owner : ndarray, (S,) intp
        Of which proved set the points of each slot are; empty where there are none.
    most_ma : float, mA
        No slot carries more in all.
    first : ndarray, (S + 1,) intp
        Where the kernels of each slot begin in `kernel`, and the last one's end.
    kernel, share : ndarray, (N,) intp and float64
        Kernels that each slot is a sum of, as rows of `KernelSums.kernels_ma`, and how much of
        each.
    """

    level: Array
    current_ma: Array
    points: NDArray[np.intp]
    do: NDArray[np.float32]
    owner: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, np.intp))
    most_ma: float = np.inf
    first: NDArray[np.intp] = field(default_factory=lambda: np.zeros(1, np.intp))
    kernel: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, np.intp))
    share: Array = field(default_factory=lambda: np.empty(0))

    def without(self, broken: NDArray[np.bool_]) -> "Found":
        """Return the other slots."""
        kept = ~broken
        size = np.diff(self.first) if len(self.owner) else np.zeros(len(kept), np.intp)
        own = kept.repeat(size)
        return Found(
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

    Parameters
    ----------
    sets : sequence of sequence of SharedKernels
        Those of each class.
    points : int
        P, the sites of all classes.
    aim : float
        Part of their wish that targets get.
    most_ma : float, mA
        Largest current of all cathodes of a slot.
    bounds : FrameBounds
        Bounds on finished currents.
    faintest : float, in (0, 1]
        Lowest level of a point that is active.
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
        self._certain = [Certainty.of(each, aim, faintest) for _, each in every]
        self.certain_from = max((each.least(bounds) for each in self._certain), default=0.0)
        """Intensity from which no sum breaks a bound, whatever rounding to whole µA does."""
        self.figures = lru_cache(maxsize=1)(self._figures)
        """Upper bounds of any slot's worst other and worst spill at an intensity, of each set, (2,
        sets)."""

    def _figures(self, intensity: float) -> NDArray[np.float32]:
        found = [each.figures(intensity) for each in self._certain]
        return np.array(found, np.float32).reshape(-1, 2).T

    def most_ma(self, alone_ma: Array) -> Array:
        """Return what no electrode carries more of in all slots of a frame, magnitudes, (E,) mA.

        Parameters
        ----------
        alone_ma : ndarray, (P, E) mA
            Kernels of points that have a slot by themselves.
        """
        each_ma = np.abs(alone_ma)
        np.maximum.at(each_ma, self._points, np.abs(self.kernels_ma))
        return np.asarray(each_ma.sum(axis=0))

    def add_up(self, level: Array) -> Found:
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
        return Found(levels, current_ma, size, do, first, most_ma, *lists)

    def _added(
        self,
        kernel: NDArray[np.intp],
        share: Array,
        slot: NDArray[np.intp],
        start: NDArray[np.intp],
    ) -> Array:
        """Return shares of kernels added up in slots, (S, E) mA.

        The first of all slots at once, then the second, and so on: a slot that has no more gets
        nothing of the first kernel of all.

        Parameters
        ----------
        kernel, share : ndarray, (N,)
            Of one slot after the other.
        slot : ndarray, (N,) intp
        start : ndarray, (S,) intp
            Where each slot begins.
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
    """Cut the points of one owner into groups that stay below a total.

    One after the other, each into the first part of its owner that has room.

    Returns
    -------
    list of list of int, float
        And the largest total of one part.
    """
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
