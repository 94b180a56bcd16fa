"""Slots of one afferent class: a scaled kernel at each active point."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ScheduleError
from smarttouch.kernels.bank import KernelBank
from smarttouch.profile import Profile
from smarttouch.stimulation.pulse_rates import ScanTiming
from smarttouch.stimulation.scan_sequence import (
    PER_UA,
    KernelLists,
    KernelTable,
    SelectivityReport,
    largest_amplitude,
    round_charge_balanced,
)


class Slots(NamedTuple):
    """Slots of one class."""

    site: NDArray[np.uint16]  # (S,)
    current_ua: NDArray[np.int16]  # (S, E)
    width_us: NDArray[np.uint16]  # (S,)
    proof: SelectivityReport | None = None  # of shared slots
    sums: KernelLists | None = None  # kernels that the currents are sums of


class PointSlots:
    """Factory of the slots of one class, one kernel each; with a `table` in whole numbers."""

    def __init__(
        self,
        profile: Profile,
        bank: KernelBank,
        afferent: Afferent,
        timing: ScanTiming,
        table: KernelTable | None = None,
    ) -> None:
        weights, masked = np.asarray(bank.kernels(afferent), np.float32), profile.output.masked
        if weights[:, masked].any():
            raise ScheduleError(
                f"the kernels drive an electrode that output.masked {list(masked)} lists: design "
                "the bank for this profile"
            )
        count = len(weights)
        self._kernels_ua = weights * (profile.full_ma * 1000)[:, None]
        magnitude = np.abs(self._kernels_ua)
        total_ma = magnitude.sum(axis=1) / 2000
        # In single precision; the gate proves what is sent in whole numbers.
        if total_ma.max() > profile.total_ma * (1 + 1e-6):
            site = int(total_ma.argmax())
            raise ScheduleError(
                f"the kernel of electrode {site} carries {total_ma[site]:.2f} mA in all at full "
                f"strength, above the {profile.total_ma:g} mA of a slot: lower "
                "perception.comfort_ratio, or design kernels within a lower limits.total_ma",
                electrode=site,
            )
        self._strongest = np.abs(weights).argmax(axis=1)
        limits, self._pulse = profile.limits, profile.pulse
        highest_ma = min(limits.current_ma, 1000 * limits.charge_uc / self._pulse.width_us)
        most_ma = np.full(count, highest_ma)
        if limits.electrode_ma is not None:
            most_ma = np.minimum(most_ma, limits.electrode_ma)
        self._most_ua = np.floor(1000 * most_ma[self._strongest] + 1e-6)
        self._tight = bool((1000 * profile.full_ma + count / 2 > self._most_ua).any())
        self._table = table
        if table is not None:
            self._base = table.points[afferent]
            site_weights = table.weights[self._base : self._base + count]
            self._largest = largest_amplitude(site_weights, np.floor(1000 * most_ma + 1e-6))
            # The table's rows all have the same peak.
            self._full = np.asarray(PER_UA * magnitude.max(axis=1), np.float32)
        self._faintest = np.asarray(profile.threshold_ma / profile.full_ma, np.float32)
        self._range = 1 - self._faintest
        # Level of each site below which a switched electrode would round to insulated.
        self._weakest_level = np.zeros(count, np.float32)
        if profile.output.kind != "weighted":
            least_ua = np.where(magnitude > 0, magnitude, np.inf).min(axis=1)
            self._weakest_level = np.asarray(1 / least_ua, np.float32)
        self._weakest_level[list(masked)] = np.inf
        self._widths_all_us = constant_us(count, self._pulse.width_us)
        self._single = afferent in bank.discs
        self._perceived_at = None if self._single else perceived_at(profile, afferent)
        self._in_index_order = timing.in_index_order

    def slots(self, activation: NDArray[np.float32], intensity: float) -> Slots:
        """Return the slots of a row (E,) of a tactile image, in [0, 1], at an intensity in [0, 1].

        An active point gets its threshold current times intensity at the faintest activation and
        its strongest comfortable current times intensity at full activation. Currents are whole µA
        that sum to zero in every slot: the remainder of rounding goes to the strongest electrode of
        the kernel, or is carried on from electrode to electrode where that would be above its
        limit. A masked electrode has no slot.
        """
        if self._perceived_at is not None:
            # The last one stands for nowhere.
            activation = np.append(activation, np.float32(0))[self._perceived_at]
        site = activation.nonzero()[0] if intensity > 0 else np.empty(0, np.intp)
        if not self._in_index_order:
            site = site.take(spread_order(len(site)))
        level = activation.take(site)
        level *= self._range.take(site)
        level += self._faintest.take(site)
        level *= intensity
        width_us = self._widths_all_us[: len(site)]
        is_felt = level >= self._weakest_level.take(site)
        if not is_felt.all():
            site, level, width_us = site[is_felt], level[is_felt], width_us[: is_felt.sum()]
        sums = None
        if self._table is not None:
            amplitude = np.minimum(np.rint(level * self._full[site]), self._largest[site])
            kernel = (self._base + site).astype(np.uint16)
            starts = np.arange(len(site) + 1)
            sums = KernelLists(self._table, starts, kernel, amplitude.astype(np.uint16))
            current_ua = sums.current_ua
        elif self._single:
            full_ua = np.abs(self._kernels_ua[site]).max(axis=1)
            current_ua = self._carried(site, np.rint(level * full_ua) / full_ua)
        else:
            current_ua = self._rounded(site, level)
        return Slots(site.astype(np.uint16), current_ua, width_us, None, sums)

    def _rounded(self, site: NDArray[np.intp], level: NDArray[np.float32]) -> NDArray[np.int16]:
        """Return each kernel times its level in whole µA, (S, E); the strongest takes the rest."""
        # Whole numbers far below 2^24: exact in single precision.
        whole_ua = np.rint(self._kernels_ua[site] * level[:, None])
        current_ua: NDArray[np.int16] = whole_ua.astype(np.int16)
        rows = np.arange(len(site)), self._strongest.take(site)
        current_ua[rows] -= whole_ua.sum(axis=1).astype(np.int16)
        if self._tight and (over := np.abs(current_ua[rows]) > self._most_ua[site]).any():
            current_ua[over] = self._carried(site[over], level[over])
        return current_ua

    def _carried(self, site: NDArray[np.intp], level: NDArray[np.float32]) -> NDArray[np.int16]:
        """Return slots with the imbalance spread: each under a µA, within its limit, (S, E)."""
        exact_ua = self._kernels_ua[site].astype(np.float64) * level[:, None]
        # A little below the limit, which is whole: what is carried cannot lift it above.
        peak_ua = np.abs(exact_ua).max(axis=1)
        exact_ua *= np.minimum(1, (self._most_ua[site] - 1e-3) / peak_ua)[:, None]
        return round_charge_balanced(exact_ua)


def perceived_at(profile: Profile, afferent: Afferent) -> NDArray[np.intp] | None:
    """Return the electrode at which each electrode's point is perceived, (E,), E if at none; None
    without ``perception.pc_shift_mm`` and the like (paper, Section III-B.4)."""
    shifts = profile.perception
    shift_mm = (shifts.ra_shift_mm, shifts.sai_shift_mm, shifts.pc_shift_mm)[afferent]
    if not any(shift_mm):
        return None
    place_mm = profile.electrodes.position_mm
    away_mm = np.abs(place_mm[:, None] + shift_mm - place_mm)
    nearest = np.hypot(*away_mm.transpose(2, 0, 1)).argmin(axis=1)
    # Half a cell away it is still that electrode's.
    half_mm = np.array(profile.electrodes.cell_mm) / 2 + 1e-9
    here = (away_mm[np.arange(len(nearest)), nearest] <= half_mm).all(axis=1)
    return np.asarray(np.where(here, nearest, len(nearest)), np.intp)


def constant_us(count: int, time_us: int) -> NDArray[np.uint16]:
    """Return the same time for many slots, (count,): frames use the first of it unchanged."""
    times = np.full(count, time_us, np.uint16)
    times.setflags(write=False)
    return times


@lru_cache(maxsize=4096)
def spread_order(count: int) -> NDArray[np.intp]:
    """Return an order of ``count`` points that keeps successive ones apart.

    It steps through the row-by-row list by about the golden section of its length, the stride whose
    neighbors in time are evenly far in the list.
    """
    stride = round(count * 0.382)
    while stride > 1 and math.gcd(stride, count) > 1:
        stride += 1
    return np.asarray(np.arange(count) * max(1, stride) % max(1, count), np.intp)


def joined(parts: list[Slots]) -> Slots:
    """Return the slots of several classes one after another."""
    site, current_ua, width_us = (
        np.concatenate([part[index] for part in parts]) for index in range(3)
    )
    proof, sums = None, parts[0].sums
    if any(part.proof is not None for part in parts):
        proofs = [part.proof or SelectivityReport.of_nothing(len(part.site)) for part in parts]
        proof = SelectivityReport(
            np.concatenate([part.points for part in proofs]),
            np.concatenate([part.off_target for part in proofs]),
            np.concatenate([part.spill for part in proofs]),
        )
    for part in parts[1:]:
        sums = None if sums is None or part.sums is None else sums.joined(part.sums)
    return Slots(site, current_ua, width_us, proof, sums)
