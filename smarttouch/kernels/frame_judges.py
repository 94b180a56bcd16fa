"""Selectivity of the finished currents of slots with several points of one class."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.kernels.frame_fields import FieldMap, FrameFigures, Single
from smarttouch.physiology.activating_function import af_matrix, everywhere, targets
from smarttouch.profile import Profile

Array = NDArray[np.float64]

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
        self.others: list[FieldMap] = [
            FieldMap(profile, everywhere(profile, each))
            for each in Afferent
            if each is not afferent
        ]
        place = everywhere(profile, afferent)
        self.own: FieldMap = FieldMap(profile, place)
        self._near = _near(place.position_mm, profile)

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
        count = len(self.wish_af)
        steps = np.eye(count - 1, count) - np.eye(count - 1, count, 1)
        other = max(float(np.abs(field(steps)).sum(axis=0).max()) for field in self.others)
        return other, float(np.abs(self.own(steps)).sum(axis=0).max())

    def far(self, active: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Return which own nodes are more than a pitch from every active target, (D·N,)."""
        mask = np.ones(self.own.places_n + 1, np.bool_)
        mask[self._near[active]] = False
        return np.tile(mask[:-1], self.own.directions_n)

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
        others = [field(current).max(axis=1) for field in self.others]
        rest, own = np.max(others, axis=0, initial=-np.inf), self.own(current)
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


def _near(position_mm: Array, profile: Profile) -> NDArray[np.intp]:
    """Return the places within a pitch of each electrode, (E, K), padded with N."""
    array = profile.electrodes
    found = []
    for center in array.position_mm:
        away = np.hypot(*(position_mm - center).T)
        found.append(np.flatnonzero(away <= array.pitch_mm + _SAME_MM))
    near = np.full((len(found), max(map(len, found))), len(position_mm), np.intp)
    for row, places in zip(near, found, strict=True):
        row[: len(places)] = places
    return near
