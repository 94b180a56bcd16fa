"""Tactile image times kernels times intensity: the slots of one frame."""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from smarttouch.errors import ScheduleError
from smarttouch.imaging.tactile_image import TactileImage
from smarttouch.modes.bank import KernelBank
from smarttouch.primary import Primary
from smarttouch.profile import Profile
from smarttouch.scan.sequence import ScanSequence


class PointScan:
    """Schedules one slot for each active point (paper, Section IV-A, Fig. 19).

    Parameters
    ----------
    profile : Profile
        Pulse, limits and thresholds.
    bank : KernelBank
        Kernels of the profile's array.
    primary : Primary
        Which of them to use.
    rate_hz : float, Hz
        Sequences a second asked for.

    Raises
    ------
    ScheduleError
        If the rate is impossible.
    """

    def __init__(
        self, profile: Profile, bank: KernelBank, primary: Primary, rate_hz: float
    ) -> None:
        if not 0 < rate_hz <= profile.limits.rate_hz:
            raise ScheduleError(
                f"a rate of {rate_hz:g} Hz is not possible: it must be above 0 and at most the "
                f"profile's limit of {profile.limits.rate_hz:g} Hz"
            )
        weights = np.asarray(bank.kernels(primary), np.float32)
        full_ua = profile.threshold_ma * profile.perception.comfort_ratio * 1000
        self._primary = primary
        self._kernels_ua = weights * full_ua[:, None]
        self._strongest = np.abs(weights).argmax(axis=1)
        self._faintest = 1 / profile.perception.comfort_ratio
        self._weakest_level = self._weakest_that_switches(profile.output.kind)
        self._currents = np.empty_like(weights)
        self._width_us = profile.pulse.width_us
        self._discharge_us = profile.pulse.discharge_us
        self._rate_period_us = math.ceil(1e6 / rate_hz)
        slot_us = self._width_us + self._discharge_us
        self._slot_us = max(slot_us, math.ceil(self._width_us / profile.limits.duty))

    def _weakest_that_switches(self, kind: str) -> NDArray[np.float32]:
        """Level per site below which a switched electrode would round to insulated."""
        if kind == "weighted":
            return np.zeros(len(self._kernels_ua), np.float32)
        magnitude = np.abs(self._kernels_ua)
        return np.asarray(1 / np.where(magnitude > 0, magnitude, np.inf).min(axis=1))

    def schedule(self, image: TactileImage, intensity: float) -> ScanSequence:
        """Return the sequence for one tactile image.

        An active point gets its threshold current times intensity at the
        faintest activation and its strongest comfortable current times
        intensity at full activation. Currents are whole µA that sum to zero
        in every slot: what rounding leaves over goes to the strongest
        electrode of the kernel. Where the slots do not fit the period asked
        for, the period grows.
        """
        activation = image.activation[self._primary]
        site = np.flatnonzero(activation) if intensity > 0 else np.empty(0, np.intp)
        site = site[spread_order(len(site))]
        level = activation[site]
        level *= 1 - self._faintest
        level += self._faintest
        level *= intensity
        felt = level >= self._weakest_level[site]
        if not felt.all():
            site, level = site[felt], level[felt]
        slots = len(site)
        currents = self._currents[:slots]
        np.take(self._kernels_ua, site, axis=0, out=currents)
        currents *= level[:, None]
        np.rint(currents, out=currents)
        current_ua = currents.astype(np.int16)
        surplus = current_ua.sum(axis=1, dtype=np.int16)
        current_ua[np.arange(slots), self._strongest[site]] -= surplus
        return ScanSequence(
            current_ua=current_ua,
            width_us=np.full(slots, self._width_us, np.uint16),
            discharge_us=np.full(slots, self._discharge_us, np.uint16),
            site=site.astype(np.uint16),
            period_us=max(self._rate_period_us, slots * self._slot_us),
            intensity=float(intensity),
            time_ns=image.time_ns,
        )


@lru_cache(maxsize=4096)
def spread_order(count: int) -> NDArray[np.intp]:
    """Return an order of ``count`` points that keeps successive ones apart.

    Steps through the row-by-row list by about the golden section of its
    length, the stride whose neighbors in time are evenly far in the list.
    """
    stride = round(count * 0.382)
    while stride > 1 and math.gcd(stride, count) > 1:
        stride += 1
    return np.asarray(np.arange(count) * max(1, stride) % max(1, count), np.intp)
