"""Points of several classes in one slot: currents of one class return through the other's.

RA wants an anode over its receptor and SAI a cathode (paper, Fig. 10), so that
an RA point and an SAI point may be each other's return: together they need
little more current than one of them alone.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from smarttouch.errors import DesignError
from smarttouch.kernels.frames.fields import FieldMap, Single
from smarttouch.kernels.frames.figures import Bounded, FrameBounds, FrameFigures, no_active_site
from smarttouch.kernels.frames.judge import FrameJudge, reached
from smarttouch.profile import Profile

Array = NDArray[np.float64]


class MixedJudge:
    """Judge of currents that are to fire K different classes at once, from a judge of each.

    A point is a site of a class: points 0 to E − 1 are the sites of the first judge's class, the
    next E those of the second one's. For each class with active points, whatever other classes get
    far from their own points is `FrameFigures.off_target`, relative to its own weakest target.
    """

    def __init__(self, judges: Sequence[FrameJudge]) -> None:
        self.judges = tuple(judges)
        classes = [each.afferent for each in judges]
        if not classes or len(set(classes)) < len(classes):
            message = "a mixed frame needs one judge for each of its classes"
            raise DesignError(message, about="judges")
        self.target = np.concatenate([each.target for each in judges])
        self.wish_af = np.concatenate([each.wish_af for each in judges])
        self.wanted: list[FieldMap] = [each.own for each in judges]
        self.unwanted = [
            field for afferent, field in judges[0].by_class.items() if afferent not in classes
        ]

    @property
    def profile(self) -> Profile:
        return self.judges[0].profile

    @property
    def full_ma(self) -> Array:
        return self.judges[0].full_ma

    def reached(self, current: Array) -> list[Single]:
        """Return the activation of each wanted class, then of the others; see `FrameJudge`."""
        return reached([*self.wanted, *self.unwanted], current)

    def limits(self, active: NDArray[np.intp], bounds: FrameBounds, aimed: float) -> list[Bounded]:
        """Return the bound of each field of `reached`; see `FrameJudge.limits`."""
        count = len(self.judges)
        owner, site = active // self.full_ma.size, active % self.full_ma.size
        smallest = np.full(count, np.inf)
        np.minimum.at(smallest, owner, aimed * self.wish_af[active])
        found: list[Bounded] = []
        for index, judge in enumerate(self.judges):
            beside = bounds.other * float(np.delete(smallest, index).min(initial=np.inf))
            if np.isinf(smallest[index]):
                found.append((judge.own, beside, None))
            else:
                most = min(beside, bounds.spill * float(smallest[index]))
                found.append((judge.own, most, judge.far(site[owner == index])))
        return found + [
            (field, bounds.other * float(smallest.min()), None) for field in self.unwanted
        ]

    def judge(
        self, current: Array, level: Array, reached: Sequence[Single] | None = None
    ) -> FrameFigures:
        """Return the figures of currents (E,) mA for points with level (K·E,) > 0."""
        if not level.any():
            raise no_active_site()
        count = len(self.judges)
        fields = self.reached(current) if reached is None else reached
        rest = max((float(field.max()) for field in fields[count:]), default=0.0)
        smallest, ratios, far = np.full(count, np.nan), [], np.empty(count)
        for index, judge in enumerate(self.judges):
            mine = level.reshape(count, -1)[index]
            active = np.flatnonzero(mine)
            far[index] = max(judge.strongest_far(fields[index], active), 0.0)
            if len(active):
                smallest[index], ratio = judge.reference(current, mine)
                ratios.append(ratio)
        other = spill = 0.0
        for index in np.flatnonzero(np.isfinite(smallest)).tolist():
            if smallest[index] <= 0:
                other = spill = np.inf
                break
            beside = max(rest, np.delete(far, index).max(initial=0.0))
            other = max(other, beside / float(smallest[index]))
            spill = max(spill, float(far[index] / smallest[index]))
        ratio = np.concatenate(ratios)
        total, most = float(np.abs(current).sum() / 2), float(np.abs(current).max())
        return FrameFigures(other, spill, float(ratio.min()), float(ratio.max()), total, most)
