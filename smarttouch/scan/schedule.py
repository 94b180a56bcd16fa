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
from smarttouch.scan.timing import ScanTiming


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
    timing : ScanTiming, optional
        What the board fixes; nothing if not given.

    Raises
    ------
    ScheduleError
        If the rate is impossible, the board has other pulses than the profile,
        or the bank drives a masked electrode.
    """

    def __init__(
        self,
        profile: Profile,
        bank: KernelBank,
        primary: Primary,
        rate_hz: float,
        timing: ScanTiming | None = None,
    ) -> None:
        if not 0 < rate_hz <= profile.limits.rate_hz:
            raise ScheduleError(
                f"a rate of {rate_hz:g} Hz is not possible: it must be above 0 and at most the "
                f"profile's limit of {profile.limits.rate_hz:g} Hz"
            )
        timing = ScanTiming() if timing is None else timing
        timing.check(profile)
        weights = np.asarray(bank.kernels(primary), np.float32)
        masked = list(profile.output.masked)
        if weights[:, masked].any():
            raise ScheduleError(
                f"the kernels drive an electrode that output.masked {masked} lists: design the "
                "bank of this very profile"
            )
        full_ua = profile.threshold_ma * profile.perception.comfort_ratio * 1000
        self._primary = primary
        self._kernels_ua = weights * full_ua[:, None]
        self._strongest = np.abs(weights).argmax(axis=1)
        self._faintest = 1 / profile.perception.comfort_ratio
        self._weakest_level = self._weakest_that_switches(profile.output.kind)
        self._weakest_level[masked] = np.inf
        self._currents = np.empty_like(weights)
        self._width_us = profile.pulse.width_us
        self._discharge_us = profile.pulse.discharge_us
        self._duty_slot_us = math.ceil(self._width_us / profile.limits.duty)
        self._timing = timing
        self._rate_period_us = timing.possible_period_us(1e6 / rate_hz)
        # Before anything is sent: the longest scan must be possible too.
        self._period_us(len(weights))

    def _weakest_that_switches(self, kind: str) -> NDArray[np.float32]:
        """Level per site below which a switched electrode would round to insulated."""
        if kind == "weighted":
            return np.zeros(len(self._kernels_ua), np.float32)
        magnitude = np.abs(self._kernels_ua)
        return np.asarray(1 / np.where(magnitude > 0, magnitude, np.inf).min(axis=1))

    def _period_us(self, slots: int) -> int:
        """Return the shortest period for so many slots, no shorter than asked for, µs."""
        timing = self._timing
        shortest = timing.shortest_period_us(
            slots, len(self._kernels_ua), self._width_us, self._discharge_us
        )
        within_duty = timing.possible_period_us(slots * self._duty_slot_us)
        return max(self._rate_period_us, shortest, within_duty)

    def schedule(self, image: TactileImage, intensity: float) -> ScanSequence:
        """Return the sequence for one tactile image.

        An active point gets its threshold current times intensity at the
        faintest activation and its strongest comfortable current times
        intensity at full activation. Currents are whole µA that sum to zero
        in every slot: what rounding leaves over goes to the strongest
        electrode of the kernel. Where the slots do not fit the period asked
        for, the period grows. A masked electrode has no slot.
        """
        activation = image.activation[self._primary]
        site = np.flatnonzero(activation) if intensity > 0 else np.empty(0, np.intp)
        if not self._timing.in_index_order:
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
            period_us=self._period_us(slots),
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
