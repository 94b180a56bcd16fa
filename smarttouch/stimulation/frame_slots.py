"""Slots with many points each, of one afferent class or two: the same frame in fewer slots."""

from collections import OrderedDict
from dataclasses import dataclass
from importlib import import_module

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ScheduleError
from smarttouch.kernels.bank import KernelBank
from smarttouch.kernels.frame_fields import FrameBounds
from smarttouch.kernels.frame_judges import FrameJudge, SlotJudge, full_wish, judge_all
from smarttouch.kernels.frame_operator import AIM, FrameOperator
from smarttouch.kernels.proved_sets import proved_sets
from smarttouch.kernels.slot_plans import plan_slots
from smarttouch.profile import Profile
from smarttouch.stimulation.kernel_sums import KernelSums, SharedSlots, SummedSlots
from smarttouch.stimulation.point_slots import Slots, constant_us, perceived_at
from smarttouch.stimulation.scan_sequence import (
    PER_UA,
    KernelLists,
    KernelTable,
    SelectivityReport,
    unsupported_reason,
)
from smarttouch.stimulation.slot_sums import round_charge_balanced

Array = NDArray[np.float64]


REMEMBERED = 256
"""Number of plans kept of computed frames: a finger that rests, or comes back, needs no new one.

Where kernels are added up the last one will do: others take longer to fetch than to make."""

_JUDGED_MM = 0.5
"""Least distance of places at which frames are judged, 25 times as fast as .1 mm, where what is
proved of all frames of a shipped array is no larger (tests/kernels/test_proved_sets.py)."""

_ROUNDING = 0.99
"""Part of a bound that plans keep, so that whole µA keep all of it down to a third of full
intensity. Nothing is felt below, and what breaks a bound there is shown point by point."""


@dataclass(frozen=True, eq=False)
class SlotAllocation:
    """Slots at full intensity: N found for the frame, then those of M points alone."""

    found: SharedSlots | SummedSlots  # the first N
    alone: NDArray[np.intp]  # (M,) points that have a slot by themselves, with their own kernels
    alone_level: Array  # (M,) requested level at each of them
    points: NDArray[np.uint16]  # (N + M,) number of points of each slot


class FrameSlots:
    """Slots of K classes; points whose currents do not interfere share one.

    Every slot keeps the profile's bounds on what it does to other classes, and to its own class
    elsewhere, and its limits of current, by the finished currents; a point that fits with no other
    has a slot of its own. With `planned` (see `SlotPolicy`) slots are searched for in each frame;
    else `table`, if set, makes them sums of kernels in whole numbers, and points of a class of
    which nothing is proved are shown one by one. `most_ua`, (E,), is the largest sum of magnitudes
    at an electrode over a frame, infinite if planned. A board without a current of its own for
    every electrode, or a profile where pulse width carries intensity or total current is not
    limited, raises a ScheduleError.
    """

    def __init__(
        self,
        profile: Profile,
        bank: KernelBank,
        afferents: tuple[Afferent, ...],
        planned: bool = True,
    ) -> None:
        if (why := unsupported_reason(profile)) is not None:
            key, reason = why
            raise ScheduleError(
                f"a whole frame cannot be shown at once: {reason}: choose points", about=key
            )
        # Matrices are small: with other work on the machine, a second thread costs a hundredfold.
        self._blas = ThreadpoolController()
        kernels = [np.asarray(bank.kernels(each), np.float64) for each in afferents]
        coarse = _coarse(profile)
        judges = [
            FrameJudge(coarse, each, full_wish(profile, own, bank.receptor[each]))
            for each, own in zip(afferents, kernels, strict=True)
        ]
        self._judge = judge = SlotJudge(judges)
        self._operator = FrameOperator(judge) if planned else None
        if planned:
            # Not by the first frame that breaks a bound: that takes longer than ten frames.
            import_module("scipy.optimize")
        full_ma = np.minimum(profile.full_ma, judge.full_ma)
        self._points_ma = np.concatenate([own * full_ma[:, None] for own in kernels])
        self._peaks_ma = np.abs(self._points_ma).max(axis=1)
        self._driven = np.isin(np.arange(len(full_ma)), profile.driven)
        each = np.flatnonzero(np.tile(self._driven, len(afferents)))
        self._points_do = np.full((2, len(self._points_ma)), np.nan)
        for row, column in zip(self._points_do, (bank.off_target, bank.spill), strict=True):
            row[each] = np.concatenate([column[mode] for mode in afferents])[each]
        frames = profile.frames
        self._bounds = FrameBounds(frames.other, frames.spill, frames.uneven)
        self._planned_bounds = FrameBounds(
            _ROUNDING * frames.other, _ROUNDING * frames.spill, frames.uneven
        )
        self._limit_ma = profile.total_ma
        # Less what rounding hardly ever adds; where it does, a slot is shown point by point.
        self._planned_ma = self._limit_ma - 0.002 * np.sqrt(len(full_ma))
        places = [perceived_at(profile, each) for each in afferents]
        self._perceived_at = places if any(each is not None for each in places) else None
        self._faintest = profile.threshold_ma / profile.full_ma
        self._range = 1 - self._faintest
        self._widths_us = constant_us(len(self._points_ma), profile.pulse.width_us)
        self._plans: OrderedDict[bytes, SlotAllocation] = OrderedDict()
        self._most_plans = REMEMBERED if planned else 1
        self._sums: KernelSums | None = None
        self._afferents = afferents
        self.table: KernelTable | None = None
        self.most_ua: NDArray[np.float64] = np.full(len(full_ma), np.inf)
        if not planned:
            self._sums = self._proved_sums(judges)
            # In each slot rounding adds less than a whole µA.
            self.most_ua = 1000 * self._sums.most_ma(self._points_ma) + len(self._points_ma)

    def _proved_sums(self, judges: list[FrameJudge]) -> KernelSums:
        """Return the sums of kernels of which no subset breaks a bound."""
        return KernelSums(
            [proved_sets(FrameOperator(each), self._planned_bounds) for each in judges],
            len(self._points_ma),
            1 - AIM * self._bounds.uneven,
            self._planned_ma,
            self._bounds,
            float(self._faintest[self._driven].min()),
        )

    def kernels(self) -> tuple[Array, NDArray[np.intp]]:
        """Return the kernels by which slots are shared, (A, E) mA, and their sites (A,)."""
        if self._sums is None:
            return np.empty((0, len(self._driven))), np.empty(0, np.intp)
        return self._sums.kernels_ma, self._sums.sites

    def slots(self, activation: NDArray[np.float32], intensity: float) -> Slots:
        """Return slots, with proof, of the classes' rows (K, E) of a tactile image at an intensity.

        An active point is activated as its own kernel would, with its threshold current times
        intensity at the faintest activation and its strongest comfortable current times intensity
        at full activation, but for the unevenness that the profile allows. Currents are whole µA
        that sum to zero in every slot. A masked electrode has no slot.
        """
        asked = activation if intensity > 0 else 0 * activation
        if (plan := self._plans.get(key := asked.tobytes())) is None:
            plan = self._plans[key] = self._plan(asked)
            if len(self._plans) > self._most_plans:
                self._plans.popitem(last=False)
        else:
            self._plans.move_to_end(key)
        current_ua, sums, proof, certain = self._finished(plan, intensity)
        if not certain:
            broken = self._broken(current_ua, proof)
            if broken.any():
                plan = self._one_by_one(plan, broken)
                current_ua, sums, proof, _ = self._finished(plan, intensity)
        site = self._strongest(plan) if sums is None else sums.site
        return Slots(site, current_ua, self._widths_us[: len(site)], proof, sums)

    def _finished(
        self, plan: SlotAllocation, intensity: float
    ) -> tuple[NDArray[np.int16], KernelLists | None, SelectivityReport, bool]:
        """Return the currents as sent, their effects, and whether all bounds are certainly kept.

        The effects of single points are those of their kernels, as designed; of kernels that are
        added up `Certainty` bounds them.
        """
        found, own = plan.found, self._sums
        sums = self._whole_sums(plan, intensity)
        if sums is not None:
            current_ua = sums.current_ua()
        else:
            current_ua = round_charge_balanced(1000 * intensity * self._current_ma(plan))
        shared = len(found.points)
        do = np.empty((2, len(plan.points)), np.float32)
        # A faint point does so much less: figures are scaled to level 1.
        np.multiply(self._points_do[:, plan.alone], plan.alone_level, out=do[:, shared:])
        proof = SelectivityReport(plan.points, *do)
        if isinstance(found, SummedSlots) and own is not None and intensity >= own.certain_from:
            do[:, :shared] = own.figures(intensity).take(found.owner, axis=1)
            most_ua = 1000 * intensity * found.most_ma + own.rounding_ua
            return current_ua, sums, proof, most_ua < 1000 * self._limit_ma
        do[:, :shared] = found.do
        several = np.flatnonzero(plan.points > 1)
        with self._blas.limit(limits=1, user_api="blas"):
            do[:, several] = _selectivity(
                self._judge, current_ua[several] / 1000, found.level[several]
            )
        return current_ua, sums, proof, False

    def _current_ma(self, plan: SlotAllocation) -> Array:
        """Return the currents of a plan's slots at full intensity, (N + M, E)."""
        if not len(plan.alone):
            return plan.found.current_ma
        alone_ma = plan.alone_level[:, None] * self._points_ma[plan.alone]
        return np.concatenate([plan.found.current_ma, alone_ma])

    def _strongest(self, plan: SlotAllocation) -> NDArray[np.uint16]:
        """Return the electrode of each slot's strongest point, (N + M,)."""
        strongest = np.concatenate([plan.found.level.argmax(axis=1), plan.alone])
        return (strongest % len(self._driven)).astype(np.uint16)

    def _whole_sums(self, plan: SlotAllocation, intensity: float) -> KernelLists | None:
        """Return a plan's slots as sums of the table's kernels; None without one."""
        found, table = plan.found, self.table
        if table is None or self._sums is None or not isinstance(found, SummedSlots):
            return None
        (afferent, *_), first = self._afferents, found.first
        kernel = table.shared[afferent] + found.kernel
        peak_ma = self._sums.peaks_ma.take(found.kernel) * found.share
        if alone := len(plan.alone):
            first = np.concatenate([first, first[-1] + 1 + np.arange(alone)])
            kernel = np.concatenate([kernel, table.points[afferent] + plan.alone])
            alone_ma = self._peaks_ma.take(plan.alone) * plan.alone_level
            peak_ma = np.concatenate([peak_ma, alone_ma])
        amplitude = np.rint(1000 * PER_UA * intensity * peak_ma)
        return KernelLists(table, first, kernel.astype(np.uint16), amplitude.astype(np.uint16))

    def _broken(self, current_ua: NDArray[np.int16], proof: SelectivityReport) -> NDArray[np.bool_]:
        """Return which slots of several points break a bound or the limit of total current."""
        # In balance: what flows in is half of all that flows.
        total_ua = np.abs(current_ua).sum(axis=1, dtype=np.int64)
        broken = np.asarray(proof.off_target > self._bounds.other)
        broken |= proof.spill > self._bounds.spill
        broken |= total_ua > 2000 * self._limit_ma
        broken &= proof.points > 1
        return broken

    def _plan(self, activation: NDArray[np.float32]) -> SlotAllocation:
        asked = activation
        if self._perceived_at is not None:
            asked = np.array(
                [
                    row if places is None else np.append(row, np.float32(0))[places]
                    for row, places in zip(activation, self._perceived_at, strict=True)
                ]
            )
        level = self._range * asked
        level += self._faintest
        level *= (asked > 0) & self._driven
        # Slots aim a little low, which saves current; the faintest would not be felt then.
        level /= 1 - AIM * self._bounds.uneven
        level = np.minimum(level, 1.0, out=level).ravel()
        found: SharedSlots | SummedSlots
        if self._sums is not None:
            found = self._sums.add_up(level)
        else:
            with self._blas.limit(limits=1, user_api="blas"):
                found = self._found(level)
        left = found.left(level)
        alone = left.nonzero()[0]
        return _completed(found, alone, left.take(alone))

    def _found(self, level: Array) -> SharedSlots:
        """Return slots with currents computed for this frame."""
        assert self._operator is not None
        slots = plan_slots(
            self._operator, level, self._planned_bounds, self._planned_ma, self._points_ma
        )
        levels = np.zeros((len(slots), len(level)))
        currents_ma = np.zeros((len(slots), self._points_ma.shape[1]))
        for row, current_ma, slot in zip(levels, currents_ma, slots, strict=True):
            row[slot.sites], current_ma[:] = level[slot.sites], slot.current
        do = [[each.figures.off_target, each.figures.spill] for each in slots]
        points = np.array([len(each.sites) for each in slots], np.intp)
        return SharedSlots(levels, currents_ma, points, np.array(do, np.float32).reshape(-1, 2).T)

    def _one_by_one(self, plan: SlotAllocation, broken: NDArray[np.bool_]) -> SlotAllocation:
        """Return a plan in which the points of some slots have slots of their own."""
        broken = broken[: len(plan.found.points)]
        level = plan.found.level[broken].sum(axis=0)
        added = np.flatnonzero(level)
        return _completed(
            plan.found.without(broken),
            np.concatenate([plan.alone, added]),
            np.concatenate([plan.alone_level, level[added]]),
        )


def _coarse(profile: Profile) -> Profile:
    """Return a profile with places at `_JUDGED_MM` or farther apart."""
    if profile.skin.node_spacing_mm >= _JUDGED_MM:
        return profile
    skin = profile.skin.model_copy(update={"node_spacing_mm": _JUDGED_MM})
    return profile.model_copy(update={"skin": skin})


def _completed(
    found: SharedSlots | SummedSlots, alone: NDArray[np.intp], level: Array
) -> SlotAllocation:
    """Return a plan with one slot more for each of some points, by its own kernel."""
    points = np.ones(len(found.points) + len(alone), np.uint16)
    points[: len(found.points)] = found.points
    return SlotAllocation(found, alone, level, points)


def _selectivity(judge: SlotJudge, current_ma: Array, level: Array) -> Array:
    """Return worst other and worst spill of many slots, (2, S)."""
    figures = judge_all(judge, current_ma, level)
    found = [(each.off_target, each.spill) for each in figures]
    return np.array(found, np.float64).reshape(len(found), 2).T
