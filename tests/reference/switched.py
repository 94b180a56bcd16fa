"""Slots shared by points on boards with one source for all electrodes.

Every electrode is a cathode, an anode or insulated, and the source's current
divides among the electrodes of a pole by their admittance (paper, Fig. 19). A
slot's only freedom is which electrode is what, and one current: all targets
rise and fall together. They are even where all their electrodes need the same
voltage, and where what they do to one another is alike, or can be made so by
what is connected around them. There are 3^E assignments: a few obvious ones are
tried and the best is improved one electrode at a time. A slot that is found is
proven by the judge; one that is not might still exist.
"""

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import DesignError
from smarttouch.kernels.frame_fields import FrameBounds, masked_point
from smarttouch.kernels.frame_judges import FrameJudge
from smarttouch.kernels.frame_operator import keeps
from smarttouch.kernels.slot_plans import FrameSlot
from smarttouch.kernels.switched_design import polarity, pole_shares

Array = NDArray[np.float64]
States = NDArray[np.int8]

STEPS = 40
"""Electrodes that a search turns at most. With none a plan takes a tenth of the time, and mostly as
many slots, at worst five for three (``tests/benchmarks/test_switched_frames.py``)."""
_PROGRESS = 1e-4
_ENOUGH = -0.01
"""Excess at which a search ends: all bounds are kept with a margin of 1 %."""
_INSIDE = 1 - 1e-6
"""Part of a limit used by the source, so that rounding keeps it."""
_RINGS = (1.1, 1.5, 2.3, 3.2)
"""Radii, in pitches, within which electrodes around a target are tried as its other pole."""
_TRIES = 3
"""Slots to try for a point, the farthest first."""
_SLACK = 1.05
"""Factor by which needs may exceed the allowed ones, as neighbors may compensate."""


class SwitchedSearch:
    """Search over the states of one slot.

    Parameters
    ----------
    judge : FrameJudge
        Of a profile whose board switches one source. A one-against-all board
        insulates none: points are then several against all others.
    level : ndarray, (E,) in [0, 1]
        Requested level at each site; those above zero share the slot.
    bounds : FrameBounds
    total_ma : float, optional
        Limit of the source; by default the profile's.

    Raises
    ------
    DesignError
        If the board weights electrodes, a site is masked, or none is active.
    """

    def __init__(
        self, judge: FrameJudge, level: Array, bounds: FrameBounds, total_ma: float | None = None
    ) -> None:
        profile, self.sites = judge.profile, np.flatnonzero(level)
        if profile.output.kind == "weighted":
            message = "the board has a source for every electrode: use FrameOperator"
            raise DesignError(message, about="output.kind")
        masked = np.setdiff1d(self.sites, profile.driven)
        if len(masked):
            raise masked_point(int(masked[0]))
        if not len(self.sites):
            message = "a slot without an active site has no states: leave it out"
            raise DesignError(message, about="slot")
        self._judge, self._level, self._bounds = judge, level, bounds
        limit = profile.limits.total_ma if total_ma is None else total_ma
        self._total_ma = np.inf if limit is None else limit
        self._pole = -1 if polarity(profile, judge.afferent) == "anodic" else 1
        self._insulates = profile.output.kind == "three-state"
        self._free = np.setdiff1d(profile.driven, self.sites)
        self._far = judge.far(self.sites)
        self._rows = judge.target[self.sites] / level[self.sites][:, None]

    def best(self, steps: int = STEPS) -> FrameSlot:
        """Return the slot found with the least excess over its bounds.

        Its currents are the source's shares: zero where an electrode is insulated.
        """
        states, least, source_ma = self._least(self._starts())
        for _ in range(steps):
            if least <= _ENOUGH or not len(self._free):
                break
            turned, excess, turned_ma = self._least(self._around(states))
            if excess > least - _PROGRESS:
                break
            states, least, source_ma = turned, excess, turned_ma
        return self.slot(source_ma * self._shares(states[None])[0])

    def slot(self, current: Array) -> FrameSlot:
        """Return the slot of these currents, (E,) mA, with its figures."""
        figures = self._judge.judge(current, self._level)
        kept = keeps(self._judge, figures, self._bounds, current, self._total_ma)
        return FrameSlot(self.sites, current, figures, kept)

    def excess(self, states: States) -> tuple[Array, Array]:
        """Return the relative excess over the worst bound, (P,), and the source's current, (P,) mA.

        The current brings all targets as near to their wish as limits allow.
        Excess is infinite where a pole has no electrode, or a target is not
        activated at all.

        Parameters
        ----------
        states : ndarray, (P, E) int8
        """
        judge, bounds, driven = self._judge, self._bounds, self._judge.profile.driven
        shares = self._shares(states)
        reached = shares @ self._rows.T
        both = (states == 1).any(axis=1) & (states == -1).any(axis=1)
        fires = both & (reached.min(axis=1) > 0)
        found, source = np.full(len(states), np.inf), np.zeros(len(states))
        if not fires.any():
            return found, source
        shares, reached = shares[fires], reached[fires]
        ratio, smallest = reached / judge.wish_af[self.sites], reached.min(axis=1)
        weakest, strongest = ratio.min(axis=1), ratio.max(axis=1)
        carried = np.maximum(np.abs(shares[:, driven]), 1e-12)
        limit_ma = np.minimum((judge.full_ma[driven] / carried).min(axis=1), self._total_ma)
        given = np.minimum(2 / (weakest + strongest), _INSIDE * limit_ma)
        other = np.max([field(shares).max(axis=1) for field in judge.others], axis=0)
        spill = judge.own(shares)[:, self._far].max(axis=1, initial=0.0)
        # The strongest target is no farther above its wish than the weakest is below.
        parts = [
            other / smallest / bounds.other,
            spill / smallest / bounds.spill,
            (1 - weakest * given) / bounds.uneven,
        ]
        found[fires], source[fires] = np.max(parts, axis=0) - 1, given
        return found, source

    def _shares(self, states: States) -> Array:
        return pole_shares(states, self._judge.profile.admittance)

    def _least(self, states: States) -> tuple[States, float, float]:
        """Return the assignment of the least excess, the excess, and the source's current."""
        excess, source_ma = self.excess(states)
        chosen = int(excess.argmin())
        return states[chosen], float(excess[chosen]), float(source_ma[chosen])

    def _starts(self) -> States:
        """Return initial assignments, (P, E): all others, or rings, against the targets."""
        array = self._judge.profile.electrodes
        pitches = array.distance_mm[self.sites].min(axis=0) / array.pitch_mm
        within = (np.inf, *_RINGS) if self._insulates else (np.inf,)
        states = np.zeros((len(within), len(array)), np.int8)
        for row, most in zip(states, within, strict=True):
            row[self._free] = np.where(pitches[self._free] <= most, -self._pole, 0)
        states[:, self.sites] = self._pole
        return states

    def _around(self, states: States) -> States:
        """Return the assignments with one electrode in another state, (P, E)."""
        values = np.array((-1, 0, 1) if self._insulates else (-1, 1), np.int8)
        around = np.repeat(states[None], len(values) * len(self._free), axis=0)
        index = np.repeat(self._free, len(values))
        around[np.arange(len(around)), index] = np.tile(values, len(self._free))
        return np.asarray(around[(around != states).any(axis=1)])


def plan_switched_slots(
    judge: FrameJudge,
    level: Array,
    bounds: FrameBounds,
    total_ma: float | None = None,
    points_ma: Array | None = None,
    steps: int = STEPS,
) -> list[FrameSlot]:
    """Return few slots that together activate every site with a level above zero, each once.

    Each point joins the slot whose points are farthest from it, or another one,
    if states for all of them together are found that keep the bounds, else it
    begins a slot. That is done again with as many slots to begin with as it
    needed but one, so that points are dealt out more evenly, while it succeeds.

    Parameters
    ----------
    judge : FrameJudge
        Of a profile whose board switches one source.
    level : ndarray, (E,) in [0, 1]
        Requested level at each site.
    bounds : FrameBounds
    total_ma : float, optional
        Limit of the source; by default the profile's.
    points_ma : ndarray, (E, E) mA, optional
        Currents of each site alone at level 1 (rows), positive cathodic, for
        points for which nothing within the bounds is found.
    steps : int
        Of each search.
    """
    planner = _Planner(judge, level, bounds, total_ma, points_ma, steps)
    best = planner.plan(0, len(level))
    while best:
        fewer = planner.plan(len(best) - 1, len(best) - 1)
        if fewer is None:
            break
        best = fewer
    return best or []


class _Planner:
    def __init__(
        self,
        judge: FrameJudge,
        level: Array,
        bounds: FrameBounds,
        total_ma: float | None,
        points_ma: Array | None,
        steps: int,
    ) -> None:
        self._judge, self._level, self._bounds = judge, level, bounds
        limit = judge.profile.limits.total_ma if total_ma is None else total_ma
        self._total_ma = np.inf if limit is None else limit
        self._points_ma, self._steps = points_ma, steps
        self._apart = judge.profile.electrodes.distance_mm
        sites = np.flatnonzero(level)
        own = np.abs(np.diag(judge.target))
        self._least_ma = (1 - bounds.uneven) * level * judge.wish_af / own
        self._need = self._least_ma / judge.profile.admittance
        """Voltage that a site alone needs at its pole, relative."""
        # The most crowded first, of those that need the same: they have the fewest choices.
        crowd = (1 / (1 + self._apart[np.ix_(sites, sites)] ** 2)).sum(axis=1)
        self._order = sites[np.lexsort((-crowd, -np.log(self._need[sites]).round(2)))]

    def plan(self, first: int, most: int) -> list[FrameSlot] | None:
        """Return at most so many slots, the first ones of one point each; None if impossible."""
        slots: list[FrameSlot] = []
        for site in self._order:
            joined = None if len(slots) < first else self._joined(slots, site)
            if joined is not None:
                index, slot = joined
                slots[index] = slot
            elif len(slots) < most:
                slots.append(self._alone(site))
            else:
                return None
        return slots

    def _joined(self, slots: list[FrameSlot], site: np.intp) -> tuple[int, FrameSlot] | None:
        away = np.array([self._apart[site, slot.sites].min() for slot in slots])
        tries = 0
        for index in np.argsort(-away, kind="stable"):
            sites = np.sort(np.append(slots[index].sites, site))
            if tries < _TRIES and self._might_share(sites):
                tries += 1
                slot = self._search(sites).best(self._steps)
                if slot.kept:
                    return int(index), slot
        return None

    def _might_share(self, sites: NDArray[np.intp]) -> bool:
        """Return whether the sites' needs are small and similar enough for a search to pay."""
        need, even = self._need[sites], (1 + self._bounds.uneven) / (1 - self._bounds.uneven)
        alike = need.max() <= _SLACK * even * need.min()
        return bool(alike and self._least_ma[sites].sum() <= _SLACK * self._total_ma)

    def _alone(self, site: np.intp) -> FrameSlot:
        search = self._search(np.array([site]))
        slot = search.best(self._steps)
        if slot.kept or self._points_ma is None:
            return slot
        return search.slot(self._points_ma[site] * self._level[site])

    def _search(self, sites: NDArray[np.intp]) -> SwitchedSearch:
        wanted = np.zeros_like(self._level)
        wanted[sites] = self._level[sites]
        return SwitchedSearch(self._judge, wanted, self._bounds, self._total_ma)
