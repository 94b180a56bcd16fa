"""Figures of a slot, and the interface of all judges of slots."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from smarttouch.errors import DesignError
from smarttouch.kernels.frames.fields import FieldMap, Single
from smarttouch.profile import Profile

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FrameFigures:
    """Figures of one slot; activations are relative to the weakest target's, scaled to level 1."""

    off_target: float  # largest activation of any other class
    spill: float  # largest activation of the own class more than a pitch from every target
    weakest: float  # least activation of a target, over its wish
    strongest: float  # most activation of a target, over its wish
    total_ma: float  # of all cathodes together
    electrode_ma: float  # of the strongest electrode

    @property
    def error(self) -> float:
        """Spread of the targets, each relative to its requested activation; 0 is even."""
        return self.strongest / self.weakest - 1 if self.weakest > 0 else np.inf


@dataclass(frozen=True)
class FrameBounds:
    """Bounds on the side effects of a slot; impossible ones raise a DesignError.

    0.30 is what the paper's own single SAI point reaches on its line array (Fig. 8). All targets
    may be weaker together by `uneven`, which saves current.
    """

    other: float = 0.30  # of `FrameFigures.off_target`
    spill: float = 0.30  # of `FrameFigures.spill`
    uneven: float = 0.05  # largest relative deviation of a target from its wish

    def __post_init__(self) -> None:
        for name, value in (("other", self.other), ("spill", self.spill), ("uneven", self.uneven)):
            most = 1 if name == "uneven" else np.inf
            if not 0 < value < most:
                raise DesignError(
                    f"bound {name} = {value} of a frame must be above 0, uneven below 1", about=name
                )


Bounded = tuple[FieldMap, float, NDArray[np.bool_] | None]
"""A field, its bound in V/mm², and the places where it holds; None is everywhere."""


class SlotJudge(Protocol):
    """Evaluates the effects of a slot's currents on its P points, and on all else."""

    @property
    def profile(self) -> Profile: ...
    @property
    def target(self) -> Array:
        """Activating function of each point's target, (P, E) V/mm² per mA."""

    @property
    def wish_af(self) -> Array:
        """Activation requested by a level of 1 at each point, (P,) V/mm²."""

    @property
    def full_ma(self) -> Array: ...
    @property
    def wanted(self) -> list[FieldMap]:
        """Classes that are to fire somewhere."""

    @property
    def unwanted(self) -> list[FieldMap]:
        """Classes that are not to fire."""

    def reached(self, current: Array) -> list[Single]: ...
    def limits(
        self, active: NDArray[np.intp], bounds: FrameBounds, aimed: float
    ) -> list[Bounded]: ...
    def judge(
        self, current: Array, level: Array, reached: Sequence[Single] | None = None
    ) -> FrameFigures: ...


def judge_all(judge: SlotJudge, current: Array, level: Array) -> list[FrameFigures]:
    """Return the figures of slots with currents (S, E) mA and levels (S, P), computed together."""
    if not len(current):
        return []
    fields = judge.reached(current)
    return [
        judge.judge(current[slot], level[slot], [field[slot] for field in fields])
        for slot in range(len(current))
    ]


def no_active_site() -> DesignError:
    """Return the error of a frame without an active site."""
    message = "a frame without an active site has no figures: leave its slot out"
    return DesignError(message, about="slot")


def masked_point(site: int) -> DesignError:
    """Return the error of a site that no frame can activate."""
    message = f"site {site} is masked: its electrode is not driven; leave it out"
    return DesignError(message, about="site", electrode=site)
