"""Slots with many points each, of one afferent class or two: the same frame in fewer slots."""

from collections import OrderedDict
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from smarttouch.errors import ScheduleError
from smarttouch.modes.bank import KernelBank
from smarttouch.modes.frames.bound import proved_sets
from smarttouch.modes.frames.figures import FrameBounds, SlotJudge, judge_all
from smarttouch.modes.frames.judge import FrameJudge, full_wish
from smarttouch.modes.frames.mixed import MixedJudge
from smarttouch.modes.frames.operator import AIM, FrameOperator
from smarttouch.modes.frames.slots import plan_slots
from smarttouch.primary import Primary
from smarttouch.profile import Profile
from smarttouch.profile.ceilings import CEILING_TOTAL_MA
from smarttouch.scan.points import Slots, felt_at
from smarttouch.scan.sequence import Proof, whole_ua

Array = NDArray[np.float64]


class Sharing(NamedTuple):
    """Whose points share slots.

    Attributes
    ----------
    primaries : tuple of Primary
    planned : bool
        Whether each frame's currents are found anew, for as few slots as can be, which takes
        milliseconds; else kernels are added up of which no subset breaks a bound.
    """

    primaries: tuple[Primary, ...] = ()
    planned: bool = True


NO_SHARING = Sharing()

REMEMBERED = 256
"""Frames whose plan is kept: a finger that rests, or comes back, is not planned for anew."""

_ROUNDING = 0.99
"""Part of a bound that plans keep, so that whole µA keep all of it down to a third of full
intensity. Nothing is felt below, and what breaks a bound there is shown point by point."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Slots at full intensity.

    Attributes
    ----------
    level : ndarray, (S, K·E)
        What is wished at each point of a slot, 0 at all others.
    current_ma : ndarray, (S, E) mA
    other, spill : ndarray, (S,)
        What the currents do to other classes, and to their own elsewhere.
    """

    level: Array
    current_ma: Array
    other: Array
    spill: Array


class FrameSlots:
    """Makes the slots of K classes; points whose currents leave one another alone share one.

    Every slot keeps the profile's bounds on what it does to other classes, and to
    its own class elsewhere, and its limits of current, by the finished currents; a
    point that no other goes with has a slot of its own.

    Parameters
    ----------
    profile : Profile
        Skin, pulse, limits, bounds and thresholds.
    bank : KernelBank
        Kernels of single points.
    primaries : tuple of Primary
        Which of them to use; points of several may share slots, too.
    planned : bool
        See `Sharing`. Points of a class of which nothing is proved are shown one by one.

    Raises
    ------
    ScheduleError
        If the board cannot give every electrode its own current, pulse width
        carries intensity, or the profile does not limit total current.
    """

    def __init__(
        self,
        profile: Profile,
        bank: KernelBank,
        primaries: tuple[Primary, ...],
        planned: bool = True,
    ) -> None:
        reason = why_not(profile)
        if reason is not None:
            raise ScheduleError(f"a whole frame cannot be shown at once: {reason}: choose points")
        # Matrices are small: with other work on the machine, a second thread costs a hundredfold.
        self._blas = ThreadpoolController()
        kernels = [np.asarray(bank.kernels(each), np.float64) for each in primaries]
        judges = [
            FrameJudge(profile, each, full_wish(profile, each, own, bank.receptor[each]))
            for each, own in zip(primaries, kernels, strict=True)
        ]
        judge: SlotJudge = judges[0] if len(judges) == 1 else MixedJudge(judges)
        self._judge = judge
        self._operator = FrameOperator(judge) if planned else None
        full_ma = np.minimum(profile.full_ma, judge.full_ma)
        self._points_ma = np.concatenate([own * full_ma[:, None] for own in kernels])
        self._driven = np.isin(np.arange(len(full_ma)), profile.driven)
        each = np.flatnonzero(np.tile(self._driven, len(primaries)))
        self._points_do = np.full((2, len(self._points_ma)), np.nan)
        self._points_do[:, each] = _selectivity(
            judge, self._points_ma[each], np.eye(len(self._points_ma))[each]
        )
        frames = profile.frames
        self._bounds = FrameBounds(frames.other, frames.spill, frames.uneven)
        self._planned_bounds = FrameBounds(
            _ROUNDING * frames.other, _ROUNDING * frames.spill, frames.uneven
        )
        self._limit_ma = profile.limits.total_ma or CEILING_TOTAL_MA
        # Less what rounding hardly ever adds; where it does, a slot is shown point by point.
        self._planned_ma = self._limit_ma - 0.002 * np.sqrt(len(full_ma))
        self._felt_at = [felt_at(profile, each) for each in primaries]
        self._faintest = profile.threshold_ma / profile.full_ma
        self._width_us = profile.pulse.width_us
        self._plans: OrderedDict[bytes, Plan] = OrderedDict()
        bounds = self._planned_bounds
        proving = () if planned else judges
        self._sets = [proved_sets(FrameOperator(each), bounds) for each in proving]

    def slots(self, activation: NDArray[np.float32], intensity: float) -> Slots:
        """Return the slots of the classes' rows of a tactile image, with their proof.

        An active point is activated as its own kernel would, with its threshold
        current times intensity at the faintest activation and its strongest
        comfortable current times intensity at full activation, but for the
        unevenness that the profile allows. Currents are whole µA that sum to zero
        in every slot. A masked electrode has no slot.

        Parameters
        ----------
        activation : ndarray, (K, E) float32, in [0, 1]
            What should be felt at each electrode.
        intensity : float, in [0, 1]
            What all currents are scaled with.
        """
        with self._blas.limit(limits=1, user_api="blas"):
            plan = self._planned(activation if intensity > 0 else 0 * activation)
            current_ua, proof = self._finished(plan, intensity)
            broken = (proof.worst_other > self._bounds.other) | (
                proof.worst_spill > self._bounds.spill
            )
            broken |= current_ua.sum(axis=1, where=current_ua > 0) > 1000 * self._limit_ma
            broken &= proof.points > 1
            if broken.any():
                plan = self._one_by_one(plan, broken)
                current_ua, proof = self._finished(plan, intensity)
        site = (plan.level.argmax(axis=1) % activation.shape[1]).astype(np.uint16)
        return Slots(site, current_ua, np.full(len(site), self._width_us, np.uint16), proof)

    def _finished(self, plan: Plan, intensity: float) -> tuple[NDArray[np.int16], Proof]:
        """Return currents as they are sent, and what these do; of single points as designed."""
        current_ua = whole_ua(1000 * intensity * plan.current_ma)
        points = np.count_nonzero(plan.level, axis=1).astype(np.uint16)
        do, shared = np.array([plan.other, plan.spill], np.float32), points > 1
        do[:, shared] = _selectivity(self._judge, current_ua[shared] / 1000, plan.level[shared])
        return current_ua, Proof(points, *do)

    def _planned(self, activation: NDArray[np.float32]) -> Plan:
        key = activation.tobytes()
        if key not in self._plans:
            self._plans[key] = self._plan(activation)
            if len(self._plans) > REMEMBERED:
                self._plans.popitem(last=False)
        self._plans.move_to_end(key)
        return self._plans[key]

    def _plan(self, activation: NDArray[np.float32]) -> Plan:
        asked = np.array(
            [
                row if felt is None else np.append(row, np.float32(0))[felt]
                for row, felt in zip(activation, self._felt_at, strict=True)
            ]
        )
        active = (asked > 0) & self._driven
        level = np.where(active, self._faintest + (1 - self._faintest) * asked, 0.0).ravel()
        # Slots aim a little low, which saves current; the faintest would not be felt then.
        level = np.minimum(level / (1 - AIM * self._bounds.uneven), 1.0)
        plan = self._found(self._operator, level) if self._operator else self._added_up(level)
        return self._with_points(plan, np.where(plan.level.any(axis=0), 0.0, level))

    def _found(self, operator: FrameOperator[SlotJudge], level: Array) -> Plan:
        """Return a plan with currents of this frame's own."""
        slots = plan_slots(operator, level, self._planned_bounds, self._planned_ma, self._points_ma)
        levels = np.zeros((len(slots), len(level)))
        currents_ma = np.zeros((len(slots), self._points_ma.shape[1]))
        for row, current_ma, slot in zip(levels, currents_ma, slots, strict=True):
            row[slot.sites], current_ma[:] = level[slot.sites], slot.current
        other, spill = (
            np.array([getattr(slot.figures, key) for slot in slots], np.float64)
            for key in ("worst_other", "worst_spill")
        )
        return Plan(levels, currents_ma, other, spill)

    def _added_up(self, level: Array) -> Plan:
        """Return a plan with sums of kernels that are proved for all subsets of their sets."""
        levels: list[Array] = []
        currents_ma: list[Array] = []
        aim = 1 - AIM * self._bounds.uneven
        count = self._points_ma.shape[1]
        for index, sets in enumerate(self._sets):
            for kernels in sets:
                points = kernels.sites + index * count
                wanted = level[points]
                parts = _parts(wanted * aim * kernels.totals_ma, self._planned_ma)
                for part in parts:
                    row = np.zeros(len(level))
                    row[points[part]] = wanted[part]
                    levels.append(row)
                    currents_ma.append(aim * wanted[part] @ kernels.kernels[part])
        nothing = np.zeros(len(levels))
        return Plan(
            np.array(levels).reshape(-1, len(level)),
            np.array(currents_ma).reshape(-1, count),
            nothing,
            nothing,
        )

    def _one_by_one(self, plan: Plan, broken: NDArray[np.bool_]) -> Plan:
        """Return a plan in which the points of some slots have slots of their own."""
        kept = Plan(
            plan.level[~broken], plan.current_ma[~broken], plan.other[~broken], plan.spill[~broken]
        )
        return self._with_points(kept, plan.level[broken].sum(axis=0))

    def _with_points(self, plan: Plan, level: Array) -> Plan:
        """Return a plan with a slot more for each point that has a level, by its own kernel."""
        point = np.flatnonzero(level)
        alone = np.zeros((len(point), len(level)))
        alone[np.arange(len(point)), point] = level[point]
        # A faint point does so much less: figures are scaled to level 1.
        other, spill = self._points_do[:, point] * level[point]
        return Plan(
            np.concatenate([plan.level, alone]),
            np.concatenate([plan.current_ma, level[point, None] * self._points_ma[point]]),
            np.concatenate([plan.other, other]),
            np.concatenate([plan.spill, spill]),
        )


def _selectivity(judge: SlotJudge, current_ma: Array, level: Array) -> Array:
    """Return worst other and worst spill of many slots, (2, S)."""
    figures = judge_all(judge, current_ma, level)
    found = [(each.worst_other, each.worst_spill) for each in figures]
    return np.array(found, np.float64).reshape(len(found), 2).T


def _parts(totals_ma: Array, most_ma: float) -> list[NDArray[np.intp]]:
    """Cut those with a current into parts of several that stay below a total.

    The strongest first, each into the first part that has room.
    """
    parts: list[list[int]] = []
    sums_ma: list[float] = []
    order = np.argsort(-totals_ma, kind="stable")
    for index in order[: np.count_nonzero(totals_ma)].tolist():
        total_ma = float(totals_ma[index])
        room = (part for part, sum_ma in enumerate(sums_ma) if sum_ma + total_ma <= most_ma)
        part = next(room, len(parts))
        if part == len(parts):
            parts.append([])
            sums_ma.append(0.0)
        parts[part].append(index)
        sums_ma[part] += total_ma
    return [np.array(part) for part in parts if len(part) > 1]


def why_not(profile: Profile) -> str | None:
    """Return why a profile's board can show points only one by one; None if it need not."""
    if profile.output.kind != "weighted":
        return f"the board is {profile.output.kind}, with one source for all electrodes"
    if profile.pulse.carrier == "width":
        return "pulse.carrier is 'width', one for all points of a slot"
    if not profile.shares:
        return "frames.share is not on, or limits.total_ma is not set, which bounds their current"
    return None
