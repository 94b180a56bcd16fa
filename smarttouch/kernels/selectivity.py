"""Selectivity of the finished currents of slots with several points of one class."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.physiology.activating_function import af_matrix, everywhere, targets
from smarttouch.profile import Profile

Array = NDArray[np.float64]
Single = NDArray[np.float32]


@dataclass(frozen=True)
class FrameFigures:
    """Figures of one slot; activations are relative to the weakest target's, scaled to level 1."""

    off_target: float  # largest activation of any other class
    spill: float  # largest activation of the own class more than a pitch from every target
    weakest: float  # least activation of a target, over its wish
    strongest: float  # most activation of a target, over its wish
    total_ma: float  # of all cathodes together
    electrode_ma: float  # of the strongest electrode


@dataclass(frozen=True)
class FrameBounds:
    """Bounds on the side effects of a slot; impossible ones raise a DesignError.

    0.30 is what a single SAI point reaches on the paper's line array, by its own program. All
    targets may be weaker together by `uneven`, which saves current.
    """

    other: float = 0.30  # of `FrameFigures.off_target`
    spill: float = 0.30  # of `FrameFigures.spill`
    uneven: float = 0.05  # largest relative deviation of a target from its wish

    def __post_init__(self) -> None:
        for name, value in (("other", self.other), ("spill", self.spill), ("uneven", self.uneven)):
            most = 1 if name == "uneven" else np.inf
            if not 0 < value < most:
                raise DesignError(
                    f"bound {name} = {value} of a frame must be above 0, uneven below 1"
                )


_SAME_MM = 1e-9


class FrameJudge:
    """Judge of currents that are to fire one class at several sites.

    A level of 1 requests activation `wish_af`, (E,) V/mm², at each target.
    """

    def __init__(self, profile: Profile, afferent: Afferent, wish_af: Array) -> None:
        if np.shape(wish_af) != (len(profile.electrodes),):
            raise DesignError(
                f"wish_af has {np.size(wish_af)} values, the array {len(profile.electrodes)} "
                "electrodes: give one for each"
            )
        self.profile: Profile = profile
        self.afferent: Afferent = afferent
        self.wish_af: Array = np.asarray(wish_af, np.float64)
        self.target: Array = af_matrix(profile, targets(profile, afferent))
        """Activating function of each site's target, (E, E) V/mm² per mA."""

    @cached_property
    def others(self) -> Single:
        """Activating function at every node of the other classes, (N, E) V/mm² per mA."""
        others = [each for each in Afferent if each is not self.afferent]
        return np.concatenate([self._rows(each) for each in others])

    @cached_property
    def own(self) -> Single:
        """Activating function at every node of the class, (M, E) V/mm² per mA."""
        return self._rows(self.afferent)

    def _rows(self, afferent: Afferent) -> Single:
        nodes = everywhere(self.profile, afferent)
        return np.asarray(af_matrix(self.profile, nodes), np.float32)

    @cached_property
    def full_ma(self) -> Array:
        """Largest current of each electrode at intensity 1, (E,) mA in whole µA, 0 where masked."""
        limits = self.profile.limits
        most = np.minimum(np.asarray(self.profile.full_ma, np.float64), limits.current_ma)
        if limits.electrode_ma is not None:
            most = np.minimum(most, np.asarray(limits.electrode_ma))
        most = np.floor(1000 * most + 1e-6) / 1000
        return np.where(np.isin(np.arange(len(most)), self.profile.driven), most, 0.0)

    @cached_property
    def uneven_af(self) -> tuple[float, float]:
        """Largest sum of a row's steps between electrodes: of other classes, of the own."""
        rows_of = self.others, self.own
        other, own = (float(np.abs(np.diff(rows)).sum(axis=1).max()) for rows in rows_of)
        return other, own

    @cached_property
    def _near(self) -> NDArray[np.bool_]:
        """Which own nodes are within a pitch of each electrode, (E, M)."""
        array, nodes = self.profile.electrodes, everywhere(self.profile, self.afferent)
        away = np.linalg.norm(array.position_mm[:, None] - nodes.position_mm, axis=2)
        return np.tile(away <= array.pitch_mm + _SAME_MM, len(nodes.direction))

    def far(self, active: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Return which own nodes are more than a pitch from every active target, (M,)."""
        return np.asarray(~self._near[active].any(axis=0))

    def judge(self, current: Array, level: Array) -> list[FrameFigures]:
        """Return the figures of slots with currents (S, E) mA that are to activate sites with
        levels (S, E).

        Ratios are infinite if a target is not activated at all. A slot without an active site is a
        DesignError.
        """
        if not len(current):
            return []
        if not level.any(axis=1).all():
            raise DesignError("a slot without an active site has no figures: leave it out")
        single = np.asarray(current, np.float32)
        rest, own = (single @ self.others.T).max(axis=1), single @ self.own.T
        return [
            self._figures(*slot) for slot in zip(current, level, rest.tolist(), own, strict=True)
        ]

    def _figures(self, current: Array, level: Array, rest: float, own: Single) -> FrameFigures:
        active = np.flatnonzero(level)
        reached = self.target[active] @ current / level[active]
        smallest, ratio = float(reached.min()), reached / self.wish_af[active]
        far = max(float(own[self.far(active)].max(initial=-np.inf)), 0.0)
        other, spill = (rest / smallest, far / smallest) if smallest > 0 else (np.inf, np.inf)
        total, most = float(np.abs(current).sum() / 2), float(np.abs(current).max())
        return FrameFigures(other, spill, float(ratio.min()), float(ratio.max()), total, most)


def full_wish(profile: Profile, kernels: Array, receptor: Array) -> Array:
    """Return the activation of single kernels at full comfortable current, (E,) V/mm², from
    `KernelBank.kernels` and `KernelBank.receptor` of the class, (E, E)."""
    return np.asarray(profile.full_ma * (receptor * kernels).sum(axis=1), np.float64)
