"""The slots of one afferent class with many points each: the same frame in fewer slots."""

from collections import OrderedDict

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from smarttouch.errors import ScheduleError
from smarttouch.modes.bank import KernelBank
from smarttouch.modes.frames.judge import FrameBounds, FrameJudge, full_wish
from smarttouch.modes.frames.operator import AIM, FrameOperator
from smarttouch.modes.frames.slots import plan_slots
from smarttouch.primary import Primary
from smarttouch.profile import Profile
from smarttouch.scan.points import Slots, felt_at

REMEMBERED = 256
"""Frames whose plan is kept: a finger that rests, or comes back, is not planned for anew."""

MOST_IN_TIME = 150
"""Electrodes: RA is planned in 1 to 20 ms there (``tests/benchmarks/test_frames.py``)."""

Plan = tuple[NDArray[np.uint16], NDArray[np.float32]]
"""The first site of each slot (S,), and its currents at full intensity (S, E) mA."""


class FrameSlots:
    """Makes the slots of one primary; points whose currents leave one another alone share one.

    Every slot keeps the profile's bounds on what it does to other classes, and to
    its own class elsewhere, and its limits of current; a point that no other goes
    with has a slot of its own.

    Parameters
    ----------
    profile : Profile
        Skin, pulse, limits, bounds and thresholds.
    bank : KernelBank
        Kernels of single points.
    primary : Primary
        Which of them to use.

    Raises
    ------
    ScheduleError
        If the board cannot give every electrode its own current, or pulse width
        carries intensity.
    """

    def __init__(self, profile: Profile, bank: KernelBank, primary: Primary) -> None:
        reason = why_not(profile)
        if reason is not None:
            raise ScheduleError(f"a whole frame cannot be shown at once: {reason}: choose points")
        # Matrices are small: with other work on the machine, a second thread costs a hundredfold.
        self._blas = ThreadpoolController()
        kernels = np.asarray(bank.kernels(primary), np.float64)
        wish_af = full_wish(profile, primary, kernels, bank.receptor[primary])
        self._operator = FrameOperator(FrameJudge(profile, primary, wish_af))
        self._points_ma = kernels * profile.full_ma[:, None]
        frames = profile.frames
        self._bounds = FrameBounds(frames.other, frames.spill, frames.uneven)
        self._felt_at = felt_at(profile, primary)
        self._faintest = profile.threshold_ma / profile.full_ma
        self._driven = np.isin(np.arange(len(kernels)), profile.driven)
        self._width_us = profile.pulse.width_us
        self._plans: OrderedDict[bytes, Plan] = OrderedDict()

    def slots(self, activation: NDArray[np.float32], intensity: float) -> Slots:
        """Return the slots of one row of a tactile image.

        An active point is activated as its own kernel would, with its threshold
        current times intensity at the faintest activation and its strongest
        comfortable current times intensity at full activation, but for the
        unevenness that the profile allows. Currents are whole µA that sum to zero
        in every slot: what rounding leaves over is taken off the strongest
        electrode of its sign. A masked electrode has no slot.

        Parameters
        ----------
        activation : ndarray, (E,) float32, in [0, 1]
            What should be felt at each electrode.
        intensity : float, in [0, 1]
            What all currents are scaled with.
        """
        site, current_ma = self._planned(activation if intensity > 0 else 0 * activation)
        current_ua = np.rint(current_ma * np.float32(1000 * intensity)).astype(np.int16)
        surplus = current_ua.sum(axis=1, dtype=np.int16)
        highest, lowest = current_ua.argmax(axis=1), current_ua.argmin(axis=1)
        current_ua[np.arange(len(site)), np.where(surplus > 0, highest, lowest)] -= surplus
        return site, current_ua, np.full(len(site), self._width_us, np.uint16)

    def _planned(self, activation: NDArray[np.float32]) -> Plan:
        key = activation.tobytes()
        if key not in self._plans:
            self._plans[key] = self._plan(activation)
            if len(self._plans) > REMEMBERED:
                self._plans.popitem(last=False)
        self._plans.move_to_end(key)
        return self._plans[key]

    def _plan(self, activation: NDArray[np.float32]) -> Plan:
        if self._felt_at is not None:
            activation = np.append(activation, np.float32(0))[self._felt_at]
        active = (activation > 0) & self._driven
        level = np.where(active, self._faintest + (1 - self._faintest) * activation, 0.0)
        # Plans aim a little low, which saves current; the faintest would not be felt then.
        level = np.minimum(level / (1 - AIM * self._bounds.uneven), 1.0)
        with self._blas.limit(limits=1, user_api="blas"):
            slots = plan_slots(self._operator, level, self._bounds, None, self._points_ma)
        site = np.array([each.sites[level[each.sites].argmax()] for each in slots], np.uint16)
        current_ma = np.array([each.current for each in slots], np.float32)
        return site, current_ma.reshape(len(slots), len(level))


def in_time(profile: Profile) -> tuple[Primary, ...]:
    """Return the classes that a profile's frames can be planned for between two pulses.

    RA on arrays of up to `MOST_IN_TIME` electrodes; plans of SAI take up to some 100 ms.
    """
    fits = len(profile.electrodes) <= MOST_IN_TIME and why_not(profile) is None
    return (Primary.RA,) if fits else ()


def why_not(profile: Profile) -> str | None:
    """Return why a profile's board can show points only one by one; None if it need not."""
    if profile.output.kind != "weighted":
        return f"the board is {profile.output.kind}, with one source for all electrodes"
    if profile.pulse.carrier == "width":
        return "pulse.carrier is 'width', one for all points of a slot"
    return None
