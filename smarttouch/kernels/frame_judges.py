"""Effects of the finished currents of a slot, of one class or of several, on targets and all else.

RA wants an anode over its receptor and SAI a cathode (paper, Fig. 10), so that
an RA point and an SAI point may be each other's return: together they need
little more current than one of them alone.
"""

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.kernels.frame_fields import (
    Bounded,
    FieldMap,
    FrameBounds,
    FrameFigures,
    Single,
)
from smarttouch.physiology.activating_function import Afferents, af_matrix, everywhere, targets
from smarttouch.profile import Profile, Skin

Array = NDArray[np.float64]

_SAME_MM = 1e-9


class SlotJudge:
    """Judge of currents that are to fire K different classes at once, from a judge of each.

    A point is a site of a class: points 0 to E − 1 are the sites of the first judge's class, the
    next E those of the second one's. For each class with active points, whatever other classes get
    far from their own points is `FrameFigures.off_target`, relative to its own weakest target.
    """

    def __init__(self, judges: Sequence["FrameJudge"]) -> None:
        classes = [each.afferent for each in judges]
        if not classes or len(set(classes)) < len(classes):
            message = "a mixed frame needs one judge for each of its classes"
            raise DesignError(message, about="judges")
        self.judges: tuple[FrameJudge, ...] = tuple(judges)
        self.profile: Profile = judges[0].profile
        self.target: NDArray[np.float64] = np.concatenate([each.target for each in judges])
        """Activating function of each point's target, (P, E) V/mm² per mA."""
        self.wish_af: NDArray[np.float64] = np.concatenate([each.wish_af for each in judges])
        """Activation requested by a level of 1 at each point, (P,) V/mm²."""
        self.wanted: list[FieldMap] = [each.own for each in judges]
        others = (each for each in Afferent if each is not classes[0])
        self.unwanted: list[FieldMap] = [
            field
            for afferent, field in zip(others, judges[0].others, strict=True)
            if afferent not in classes
        ]

    @cached_property
    def full_ma(self) -> Array:
        """Largest current of each electrode at intensity 1, (E,) mA in whole µA, 0 where masked."""
        limits = self.profile.limits
        most = np.minimum(np.asarray(self.profile.full_ma, np.float64), limits.current_ma)
        if limits.electrode_ma is not None:
            most = np.minimum(most, np.asarray(limits.electrode_ma))
        most = np.floor(1000 * most + 1e-6) / 1000
        return np.where(np.isin(np.arange(len(most)), self.profile.driven), most, 0.0)

    def reached(self, current: Array) -> list[Single]:
        """Return the AF, V/mm², of each class that is not to fire, then of those that are, for
        currents (E,) or (S, E) mA."""
        current = np.asarray(current)
        many = np.atleast_2d(current)
        fields = [*self.unwanted, *self.wanted]
        return [field(many).reshape(*current.shape[:-1], -1) for field in fields]

    def limits(self, active: NDArray[np.intp], bounds: FrameBounds, aimed: float) -> list[Bounded]:
        """Return the bound of each field of `reached` if points (A,) get `aimed` of a wish."""
        owner, site = np.divmod(active, self.full_ma.size)
        smallest = np.full(len(self.judges), np.inf)
        np.minimum.at(smallest, owner, aimed * self.wish_af[active])
        rest = bounds.other * float(smallest.min())
        found: list[Bounded] = [(field, rest, None) for field in self.unwanted]
        for index, judge in enumerate(self.judges):
            beside = bounds.other * float(np.delete(smallest, index).min(initial=np.inf))
            if np.isinf(smallest[index]):
                found.append((judge.own, beside, None))
            else:
                most = min(beside, bounds.spill * float(smallest[index]))
                found.append((judge.own, most, judge.far(site[owner == index])))
        return found

    def judge(
        self, current: Array, level: Array, reached: Sequence[Single] | None = None
    ) -> FrameFigures:
        """Return the figures of currents (E,) mA that are to activate points with level (P,) > 0.

        Ratios are infinite if a target is not activated at all. No active point is a DesignError.
        What `reached` returned for the currents is used if given.
        """
        if not level.any():
            message = "a frame without an active site has no figures: leave its slot out"
            raise DesignError(message, about="slot")
        fields = self.reached(current) if reached is None else reached
        others, own = fields[: len(self.unwanted)], fields[len(self.unwanted) :]
        rest = max((float(field.max()) for field in others), default=-np.inf)
        far, found = np.empty(len(own)), []
        for index, (judge, mine) in enumerate(
            zip(self.judges, level.reshape(len(own), -1), strict=True)
        ):
            active = np.flatnonzero(mine)
            far[index] = max(judge.strongest_far(own[index], active), 0.0)
            if len(active):
                found.append((index, *judge.reference(current, mine)))
        other = spill = -np.inf
        for index, smallest, _ in found:
            if smallest <= 0:
                other = spill = np.inf
                break
            beside = max(rest, np.delete(far, index).max(initial=-np.inf))
            other = max(other, float(beside / smallest))
            spill = max(spill, float(far[index] / smallest))
        ratio = np.concatenate([each for *_, each in found])
        total, most = float(np.abs(current).sum() / 2), float(np.abs(current).max())
        return FrameFigures(other, spill, float(ratio.min()), float(ratio.max()), total, most)


def judge_all(judge: SlotJudge, current: Array, level: Array) -> list[FrameFigures]:
    """Return the figures of slots with currents (S, E) mA and levels (S, P), computed together."""
    if not len(current):
        return []
    fields = judge.reached(current)
    return [
        judge.judge(current[slot], level[slot], [field[slot] for field in fields])
        for slot in range(len(current))
    ]


class FrameJudge(SlotJudge):
    """Judge of currents that are to fire one class, on the nodes of one skin.

    A level of 1 requests activation `wish_af`, (E,) V/mm², at each target. `vary` replaces sets of
    nodes, by other directions say; `others` are fields of the other classes computed already.
    """

    def __init__(
        self,
        profile: Profile,
        afferent: Afferent,
        wish_af: Array,
        skin: Skin | None = None,
        vary: Callable[[Afferents], Afferents] = lambda one: one,
        others: list[FieldMap] | None = None,
    ) -> None:
        if skin is not None:
            profile = profile.model_copy(update={"skin": skin})
        if np.shape(wish_af) != (len(profile.electrodes),):
            raise DesignError(
                f"wish_af has {np.size(wish_af)} values, the array {len(profile.electrodes)} "
                "electrodes: give one for each",
                about="wish_af",
            )
        self.profile = profile
        self.afferent: Afferent = afferent
        self.wish_af = np.asarray(wish_af, np.float64)
        self.target = af_matrix(profile, vary(targets(profile, afferent)))
        self.others: list[FieldMap] = others or [
            FieldMap(profile, vary(everywhere(profile, each)))
            for each in Afferent
            if each is not afferent
        ]
        place = vary(everywhere(profile, afferent))
        self.own: FieldMap = FieldMap(profile, place)
        self._near = _near(place.position_mm, profile)
        super().__init__([self])

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

    def strongest_far(self, own: Single, active: NDArray[np.intp]) -> float:
        """Return the largest activation of the own class far from all active targets."""
        away = np.empty(self.own.places_n + 1, own.dtype)
        np.maximum.reduce(own.reshape(self.own.directions_n, -1), axis=0, out=away[:-1])
        # The last one is padding; near places are excluded.
        away[-1] = -np.inf
        away[self._near[active]] = -np.inf
        return float(away.max())

    def reference(self, current: Array, level: Array) -> tuple[float, Array]:
        """Return the weakest target's activation scaled to level 1, and all over wishes, (A,)."""
        active = np.flatnonzero(level)
        reached = self.target[active] @ current / level[active]
        return float(reached.min()), reached / self.wish_af[active]


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
