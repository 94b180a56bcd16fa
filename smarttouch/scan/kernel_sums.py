"""Kernels of which no subset breaks a bound, added up: the slots of a frame without a search."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from smarttouch.modes.frames.bound import Certainty, SharedKernels
from smarttouch.modes.frames.figures import FrameBounds

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Found:
    """Slots of several points, at full intensity.

    Attributes
    ----------
    level : ndarray, (S, P)
        What is wished at each point of a slot, 0 at all others.
    current_ma : ndarray, (S, E) mA
    do : ndarray, (2, S) float32
        What the currents do to other classes, and to their own elsewhere; of sums of kernels
        see `KernelSums.figures`.
    owner : ndarray, (S,) intp
        Of which proved set the points of each slot are; empty where there are none.
    """

    level: Array
    current_ma: Array
    do: NDArray[np.float32]
    owner: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, np.intp))

    def without(self, broken: NDArray[np.bool_]) -> "Found":
        """Return the others."""
        owner = self.owner[~broken] if len(self.owner) else self.owner
        return Found(self.level[~broken], self.current_ma[~broken], self.do[:, ~broken], owner)


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
        What all cathodes of a slot may carry.
    bounds : FrameBounds
        What finished currents keep.
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
        self._kernels_ma = np.concatenate(
            [np.empty((0, self._electrodes)), *(each.kernels for _, each in every)]
        )
        self._totals_ma = np.concatenate([np.empty(0), *(each.totals_ma for _, each in every)])
        self._owner = np.repeat(np.arange(len(every)), [len(each.sites) for _, each in every])
        self._certain = [Certainty.of(each, aim, faintest) for _, each in every]
        self.certain_from = max((each.least(bounds) for each in self._certain), default=0.0)
        """Intensity from which no sum breaks a bound, whatever rounding to whole µA does."""
        self._figures: tuple[float, NDArray[np.float32]] = -1.0, np.empty((2, 0), np.float32)

    def figures(self, intensity: float) -> NDArray[np.float32]:
        """Return what no slot's worst other and worst spill are above, of each set, (2, sets)."""
        if intensity != self._figures[0]:
            found = [each.figures(intensity) for each in self._certain]
            self._figures = intensity, np.array(found, np.float32).reshape(-1, 2).T
        return self._figures[1]

    def add_up(self, level: Array) -> Found:
        """Return the slots in which several points find together, at levels (P,)."""
        wanted = level[self._points]
        aimed = self._aim * wanted
        totals_ma = aimed * self._totals_ma
        active = np.flatnonzero(totals_ma)
        # Set after set, the strongest of each first.
        active = active[np.lexsort((-totals_ma[active], self._owner[active]))]
        parts = _parts(totals_ma[active].tolist(), self._owner[active].tolist(), self._most_ma)
        chosen = active[np.array([each for part in parts for each in part], np.intp)]
        sizes = [len(part) for part in parts]
        levels = np.zeros((len(parts), self._points_n))
        slot = np.repeat(np.arange(len(parts)), sizes)
        levels[slot, self._points[chosen]] = wanted[chosen]
        aimed, kernels_ma = aimed[chosen], self._kernels_ma.take(chosen, axis=0)
        current_ma = np.empty((len(parts), self._electrodes))
        end = 0
        for row, size in zip(current_ma, sizes, strict=True):
            begin, end = end, end + size
            aimed[begin:end].dot(kernels_ma[begin:end], out=row)
        unknown = np.full((2, len(parts)), np.nan, np.float32)
        owner = self._owner[chosen[np.cumsum(sizes) - sizes]] if parts else self._owner[:0]
        return Found(levels, current_ma, unknown, owner)


def _parts(totals_ma: list[float], owners: list[int], most_ma: float) -> list[list[int]]:
    """Cut what is of one owner into parts of several that stay below a total.

    One after the other, each into the first part of its owner that has room.
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
    return [part for part in parts if len(part) > 1]
