"""Bounds over all subsets of a set of sites: a proof for all frames at once.

Fixed kernels that do not move one another's targets are superposed. A node of
another class is then reached by at most the sum of what it gets from those
that excite it, whichever of them are on; the worst node bounds all subsets.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import DesignError
from smarttouch.kernels.frame_fields import FrameBounds
from smarttouch.kernels.frame_judges import FrameJudge
from smarttouch.kernels.frame_operator import AIM, FrameOperator

Array = NDArray[np.float64]

MOST_PROVED = 300
"""Largest number of electrodes for which sets are proved, in about a second."""
_STEPS = (2, 3, 4)
"""Distances, in rows and columns, between the points of a set to try."""
_SINGLE = 1.0001
"""Factor above the loss of single precision in a field."""
_HALF_UA_MA = 0.0005


@dataclass(frozen=True, eq=False)
class SharedKernels:
    """Kernels of sites that may be on together, in any combination."""

    operator: FrameOperator[FrameJudge]
    sites: NDArray[np.intp]  # (A,)

    @cached_property
    def kernels(self) -> Array:
        """Kernels (A, E) mA: row i gives site i its wish, and the others of the set nothing."""
        return np.asarray(self.operator.independent(self.sites) * self._wish[:, None])

    @property
    def _wish(self) -> Array:
        return self.operator.judge.wish_af[self.sites]

    @cached_property
    def off_target(self) -> float:
        """Upper bound of `FrameFigures.off_target` over all subsets."""
        judge = self.operator.judge
        reached = [np.maximum(field(self.kernels), 0).sum(axis=0).max() for field in judge.others]
        return self._against_targets(float(max(reached)))

    @cached_property
    def spill(self) -> float:
        """Upper bound of `FrameFigures.spill` over all subsets.

        A node counts only if every active site is more than a pitch away: nearer ones add nothing.
        """
        judge = self.operator.judge
        own = np.maximum(judge.own(self.kernels), 0)
        for row, site in zip(own, self.sites, strict=True):
            row[~judge.far(np.array([site]))] = 0
        return self._against_targets(float(own.sum(axis=0).max()))

    @cached_property
    def totals_ma(self) -> Array:
        """Total current of the kernel of each site, (A,); their sum bounds that of any subset."""
        return np.asarray(np.abs(self.kernels).sum(axis=1) / 2)

    @cached_property
    def electrode_ma(self) -> Array:
        """Upper bound of the current of each electrode over all subsets, (E,)."""
        positive = np.maximum(self.kernels, 0).sum(axis=0)
        return np.asarray(np.maximum(positive, np.maximum(-self.kernels, 0).sum(axis=0)))

    @cached_property
    def weakest(self) -> float:
        """Lower bound of an active target's fraction of its requested activation, over all subsets.

        It is below 1 with as many wishes as electrodes: zero-sum currents cannot meet them all.
        """
        return float((self._reached / self._wish).min())

    def _against_targets(self, reached: float) -> float:
        """Return a value over the least activation of a target; infinite if that is zero."""
        return reached / self.smallest if self.smallest > 0 else np.inf

    @cached_property
    def smallest(self) -> float:
        """Lower bound of the activation of an active target of level 1, over all subsets, V/mm²."""
        return float(self._reached.min())

    @cached_property
    def _reached(self) -> Array:
        each = self.operator.judge.target[self.sites] @ self.kernels.T
        own = np.diag(each)
        return np.asarray(own + np.minimum(each - np.diag(own), 0).sum(axis=1))


@dataclass(frozen=True)
class Certainty:
    """Bounds over all subsets of a set, in V/mm², after currents are rounded to whole µA."""

    # most that nodes of other classes and of the own get, per intensity
    reached: tuple[float, float]
    rounding: tuple[float, float]  # most that rounding adds to it
    target: float  # least that the weakest target gets, scaled to level 1, per intensity
    lost: float  # most that rounding takes from it

    @classmethod
    def of(cls, kernels: SharedKernels, aim: float, faintest: float) -> "Certainty":
        """Return the bounds for levels from ``faintest`` to 1 and targets at ``aim`` of theirs.

        `round_charge_balanced` leaves the running sum of currents off by half a µA at most, so each
        row of a field is off by at most half the sum of its steps from electrode to electrode.
        """
        judge = kernels.operator.judge
        rows = judge.target[kernels.sites]
        each = rows @ kernels.kernels.T
        own = np.diag(each)
        # What is fainter than another point gets so much more of what that one's kernel does.
        least = own + np.minimum(each - np.diag(own), 0).sum(axis=1) / faintest
        lost = float(np.abs(np.diff(rows, axis=1)).sum(axis=1).max()) / faintest
        other, spill = judge.uneven_af
        smallest = kernels.smallest
        return cls(
            (
                _SINGLE * aim * kernels.off_target * smallest,
                _SINGLE * aim * kernels.spill * smallest,
            ),
            (_HALF_UA_MA * other, _HALF_UA_MA * spill),
            aim * float(least.min()),
            _HALF_UA_MA * lost,
        )

    def figures(self, intensity: float) -> tuple[float, float]:
        """Return the upper bounds of `FrameFigures.off_target` and `spill`."""
        weakest = intensity * self.target - self.lost
        if weakest <= 0:
            return np.inf, np.inf
        other, spill = (
            (intensity * reached + rounding) / weakest
            for reached, rounding in zip(self.reached, self.rounding, strict=True)
        )
        return other, spill

    def least(self, bounds: FrameBounds) -> float:
        """Return the intensity from which bounds are kept; infinite if never."""
        least = 0.0
        for most, reached, rounding in zip(
            (bounds.other, bounds.spill), self.reached, self.rounding, strict=True
        ):
            room = most * self.target - reached
            least = max(least, (rounding + most * self.lost) / room if room > 0 else np.inf)
        return least


def color_classes(operator: FrameOperator[FrameJudge], step: int) -> list[SharedKernels]:
    """Return a grid's sites by rows and columns modulo a step; DesignError if it is no grid."""
    array, driven = operator.judge.profile.electrodes, operator.judge.profile.driven
    x, column = np.unique(array.position_mm[:, 0].round(6), return_inverse=True)
    y, row = np.unique(array.position_mm[:, 1].round(6), return_inverse=True)
    if len(x) * len(y) != len(array):
        message = "color classes are for grids: give the sites of each set by yourself"
        raise DesignError(message, about="array")
    color = (row % step) * step + column % step
    sets = (driven[color[driven] == each] for each in range(step * step))
    return [SharedKernels(operator, sites) for sites in sets if len(sites)]


def proved_sets(operator: FrameOperator[FrameJudge], bounds: FrameBounds) -> list[SharedKernels]:
    """Return few sets of sites whose subsets all keep the bounds with targets aimed at `AIM`.

    Limits of single electrodes are kept too, the total current is not checked. None are returned
    where the array is no grid or large, or nothing could be proved.
    """
    judge, aim = operator.judge, 1 - AIM * bounds.uneven
    if judge.profile.array.layout != "grid" or len(judge.full_ma) > MOST_PROVED:
        return []
    for step in _STEPS:
        sets = color_classes(operator, step)
        if all(
            each.off_target <= bounds.other
            and each.spill <= bounds.spill
            and aim * each.weakest >= 1 - bounds.uneven
            and (aim * each.electrode_ma <= judge.full_ma).all()
            for each in sets
        ):
            return sets
    return []
