"""Slots with several points each, of one afferent class: the same frame in fewer slots."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ScheduleError
from smarttouch.kernels.bank import KernelBank
from smarttouch.kernels.frame_fields import FrameBounds
from smarttouch.kernels.frame_judges import FrameJudge, full_wish
from smarttouch.kernels.frame_operator import AIM, FrameOperator
from smarttouch.kernels.proved_sets import proved_sets
from smarttouch.profile import Profile
from smarttouch.stimulation.kernel_sums import KernelSums, SummedSlots
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


_JUDGED_MM = 0.5
"""Least distance of places at which frames are judged, 25 times as fast as .1 mm, where what is
proved of all frames of a shipped array is no larger (tests/kernels/test_proved_sets.py)."""

_ROUNDING = 0.99
"""Part of a bound that proofs keep, so that whole µA keep all of it down to a third of full
intensity. Nothing is felt below, and what breaks a bound there is shown point by point."""


@dataclass(frozen=True, eq=False)
class SlotAllocation:
    """Slots at full intensity: N that several points share, then those of M points alone."""

    found: SummedSlots  # the first N
    alone: NDArray[np.intp]  # (M,) points that have a slot by themselves, with their own kernels
    alone_level: Array  # (M,) requested level at each of them
    points: NDArray[np.uint16]  # (N + M,) number of points of each slot


class FrameSlots:
    """Slots of one class; points whose currents do not interfere share one.

    A slot is a sum of kernels of which no subset breaks the profile's bounds on what it does to
    other classes, and to its own class elsewhere; a point of which nothing is proved has a slot of
    its own. `table`, if set, makes slots sums of kernels in whole numbers. `most_ua`, (E,), is the
    largest sum of magnitudes at an electrode over a frame. A board without a current of its own for
    every electrode, or a profile where pulse width carries intensity or total current is not
    limited, raises a ScheduleError.
    """

    def __init__(self, profile: Profile, bank: KernelBank, afferent: Afferent) -> None:
        if (why := unsupported_reason(profile)) is not None:
            raise ScheduleError(f"points cannot share slots: {why}: choose points")
        # Matrices are small: with other work on the machine, a second thread costs a hundredfold.
        self._blas = ThreadpoolController()
        kernels = np.asarray(bank.kernels(afferent), np.float64)
        wish = full_wish(profile, kernels, bank.receptor[afferent])
        self._judge = judge = FrameJudge(_coarse(profile), afferent, wish)
        full_ma = np.minimum(profile.full_ma, judge.full_ma)
        self._points_ma = kernels * full_ma[:, None]
        self._peaks_ma = np.abs(self._points_ma).max(axis=1)
        self._driven = np.isin(np.arange(len(full_ma)), profile.driven)
        self._points_do = np.stack([bank.off_target[afferent], bank.spill[afferent]])
        self._points_do[:, ~self._driven] = np.nan
        frames = profile.frames
        self._bounds = FrameBounds(frames.other, frames.spill, frames.uneven)
        self._limit_ma = profile.total_ma
        self._perceived_at = perceived_at(profile, afferent)
        self._faintest = profile.threshold_ma / profile.full_ma
        self._range = 1 - self._faintest
        self._widths_us = constant_us(len(self._points_ma), profile.pulse.width_us)
        self._last: tuple[bytes, SlotAllocation] | None = None
        self._afferent = afferent
        self.table: KernelTable | None = None
        self._sums = KernelSums(
            proved_sets(
                FrameOperator(judge),
                FrameBounds(_ROUNDING * frames.other, _ROUNDING * frames.spill, frames.uneven),
            ),
            len(self._points_ma),
            1 - AIM * self._bounds.uneven,
            # Less what rounding hardly ever adds; where it does, a slot is shown point by point.
            self._limit_ma - 0.002 * np.sqrt(len(full_ma)),
            self._bounds,
            float(self._faintest[self._driven].min()),
        )
        # In each slot rounding adds less than a whole µA.
        self.most_ua: NDArray[np.float64] = 1000 * self._sums.most_ma(self._points_ma) + len(
            self._points_ma
        )

    def kernels(self) -> tuple[Array, NDArray[np.intp]]:
        """Return the kernels by which slots are shared, (A, E) mA, and their sites (A,)."""
        return self._sums.kernels_ma, self._sums.points

    def slots(self, activation: NDArray[np.float32], intensity: float) -> Slots:
        """Return slots, with proof, of one class's activation (E,) at an intensity.

        An active point is activated as its own kernel would, with its threshold current times
        intensity at the faintest activation and its strongest comfortable current times intensity
        at full activation, but for the unevenness that the profile allows. Currents are whole µA
        that sum to zero in every slot. A masked electrode has no slot.
        """
        asked = activation if intensity > 0 else 0 * activation
        key = asked.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = key, self._plan(asked)
        plan = self._last[1]
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

        The effects of single points are those of their kernels, as designed; of sums of kernels
        `Certainty` bounds them, or they are judged.
        """
        found, own = plan.found, self._sums
        sums = self._whole_sums(plan, intensity)
        if sums is not None:
            current_ua = sums.current_ua
        else:
            current_ua = round_charge_balanced(1000 * intensity * self._current_ma(plan))
        shared = len(found.points)
        do = np.empty((2, len(plan.points)), np.float32)
        # A faint point does so much less: figures are scaled to level 1.
        np.multiply(self._points_do[:, plan.alone], plan.alone_level, out=do[:, shared:])
        proof = SelectivityReport(plan.points, *do)
        if intensity >= own.certain_from:
            do[:, :shared] = own.figures(intensity).take(found.owner, axis=1)
            most_ua = 1000 * intensity * found.most_ma + own.rounding_ua
            return current_ua, sums, proof, most_ua < 1000 * self._limit_ma
        with self._blas.limit(limits=1, user_api="blas"):
            do[:, :shared] = _selectivity(self._judge, current_ua[:shared] / 1000, found.level)
        return current_ua, sums, proof, False

    def _current_ma(self, plan: SlotAllocation) -> Array:
        """Return the currents of a plan's slots at full intensity, (N + M, E)."""
        if not len(plan.alone):
            return plan.found.current_ma
        alone_ma = plan.alone_level[:, None] * self._points_ma[plan.alone]
        return np.concatenate([plan.found.current_ma, alone_ma])

    def _strongest(self, plan: SlotAllocation) -> NDArray[np.uint16]:
        """Return the electrode of each slot's strongest point, (N + M,)."""
        return np.concatenate([plan.found.level.argmax(axis=1), plan.alone]).astype(np.uint16)

    def _whole_sums(self, plan: SlotAllocation, intensity: float) -> KernelLists | None:
        """Return a plan's slots as sums of the table's kernels; None without one."""
        found, table = plan.found, self.table
        if table is None:
            return None
        first = found.first
        kernel = table.shared[self._afferent] + found.kernel
        peak_ma = self._sums.peaks_ma.take(found.kernel) * found.share
        if alone := len(plan.alone):
            first = np.concatenate([first, first[-1] + 1 + np.arange(alone)])
            kernel = np.concatenate([kernel, table.points[self._afferent] + plan.alone])
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
            asked = np.append(activation, np.float32(0))[self._perceived_at]
        level = self._range * asked
        level += self._faintest
        level *= (asked > 0) & self._driven
        # Slots aim a little low, which saves current; the faintest would not be felt then.
        level /= 1 - AIM * self._bounds.uneven
        level = np.minimum(level, 1.0, out=level)
        found = self._sums.add_up(level)
        left = found.left(level)
        alone = left.nonzero()[0]
        return _completed(found, alone, left.take(alone))

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


def _completed(found: SummedSlots, alone: NDArray[np.intp], level: Array) -> SlotAllocation:
    """Return a plan with one slot more for each of some points, by its own kernel."""
    points = np.ones(len(found.points) + len(alone), np.uint16)
    points[: len(found.points)] = found.points
    return SlotAllocation(found, alone, level, points)


def _selectivity(judge: FrameJudge, current_ma: Array, level: Array) -> Array:
    """Return worst other and worst spill of many slots, (2, S)."""
    found = [(each.off_target, each.spill) for each in judge.judge(current_ma, level)]
    return np.array(found, np.float64).reshape(len(found), 2).T
