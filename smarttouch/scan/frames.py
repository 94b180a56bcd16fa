"""Slots with many points each, of one afferent class or two: the same frame in fewer slots."""

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from smarttouch.errors import ScheduleError
from smarttouch.modes.bank import KernelBank
from smarttouch.modes.frames.figures import FrameBounds, SlotJudge, judge_all
from smarttouch.modes.frames.judge import FrameJudge, full_wish
from smarttouch.modes.frames.mixed import MixedJudge
from smarttouch.modes.frames.operator import AIM, FrameOperator
from smarttouch.modes.frames.slots import plan_slots
from smarttouch.primary import Primary
from smarttouch.profile import Profile
from smarttouch.scan.points import Slots, felt_at
from smarttouch.scan.sequence import Proof, whole_ua

Array = NDArray[np.float64]

REMEMBERED = 256
"""Frames whose plan is kept: a finger that rests, or comes back, is not planned for anew."""

MOST_IN_TIME = {Primary.RA: 150, Primary.SAI: 80}
"""Electrodes on which frames are planned in 1 to 20 ms (``tests/benchmarks/test_frames.py``)."""

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
    """

    level: Array
    current_ma: Array


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

    Raises
    ------
    ScheduleError
        If the board cannot give every electrode its own current, pulse width
        carries intensity, or the profile does not limit total current.
    """

    def __init__(self, profile: Profile, bank: KernelBank, primaries: tuple[Primary, ...]) -> None:
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
        self._operator = FrameOperator(judge)
        full_ma = np.minimum(profile.full_ma, judge.full_ma)
        self._points_ma = np.concatenate([own * full_ma[:, None] for own in kernels])
        frames = profile.frames
        self._bounds = FrameBounds(frames.other, frames.spill, frames.uneven)
        self._planned_bounds = FrameBounds(
            _ROUNDING * frames.other, _ROUNDING * frames.spill, frames.uneven
        )
        self._limit_ma = profile.limits.total_ma or 0.0
        # Less what rounding hardly ever adds; where it does, a slot is shown point by point.
        self._planned_ma = self._limit_ma - 0.002 * np.sqrt(len(full_ma))
        self._felt_at = [felt_at(profile, each) for each in primaries]
        self._faintest = profile.threshold_ma / profile.full_ma
        self._driven = np.isin(np.arange(len(full_ma)), profile.driven)
        self._width_us = profile.pulse.width_us
        self._plans: OrderedDict[bytes, Plan] = OrderedDict()

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
        """Return currents as they are sent, and what these do."""
        current_ua = whole_ua(1000 * intensity * plan.current_ma)
        figures = judge_all(self._operator.judge, current_ua / 1000, plan.level)
        proof = Proof(
            np.count_nonzero(plan.level, axis=1).astype(np.uint16),
            np.array([each.worst_other for each in figures], np.float32),
            np.array([each.worst_spill for each in figures], np.float32),
        )
        return current_ua, proof

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
        # Plans aim a little low, which saves current; the faintest would not be felt then.
        level = np.minimum(level / (1 - AIM * self._bounds.uneven), 1.0)
        slots = plan_slots(
            self._operator, level, self._planned_bounds, self._planned_ma, self._points_ma
        )
        levels = np.zeros((len(slots), len(level)))
        currents_ma = np.zeros((len(slots), activation.shape[1]))
        for row, current_ma, slot in zip(levels, currents_ma, slots, strict=True):
            row[slot.sites], current_ma[:] = level[slot.sites], slot.current
        return Plan(levels, currents_ma)

    def _one_by_one(self, plan: Plan, broken: NDArray[np.bool_]) -> Plan:
        """Return a plan in which the points of some slots have slots of their own."""
        level = plan.level[broken].sum(axis=0)
        site = np.flatnonzero(level)
        alone = np.zeros((len(site), len(level)))
        alone[np.arange(len(site)), site] = level[site]
        currents_ma = level[site, None] * self._points_ma[site]
        return Plan(
            np.concatenate([plan.level[~broken], alone]),
            np.concatenate([plan.current_ma[~broken], currents_ma]),
        )


def in_time(profile: Profile) -> tuple[Primary, ...]:
    """Return the classes that a profile's frames can be planned for between two pulses."""
    if why_not(profile) is not None:
        return ()
    count = len(profile.electrodes)
    return tuple(each for each, most in MOST_IN_TIME.items() if count <= most)


def why_not(profile: Profile) -> str | None:
    """Return why a profile's board can show points only one by one; None if it need not."""
    if profile.output.kind != "weighted":
        return f"the board is {profile.output.kind}, with one source for all electrodes"
    if profile.pulse.carrier == "width":
        return "pulse.carrier is 'width', one for all points of a slot"
    if profile.limits.total_ma is None:
        return "limits.total_ma is not set, and nothing else bounds what many points carry"
    return None
