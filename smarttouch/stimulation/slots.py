"""Slots of an afferent class: one or several kernels per slot, each scaled by activation."""

import math
from functools import lru_cache
from itertools import accumulate, chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ScheduleError
from smarttouch.kernels.bank import KernelBank
from smarttouch.kernels.slot_selectivity import (
    AIM,
    Certainty,
    FrameBounds,
    FrameJudge,
    full_wish,
    proved_sets,
)
from smarttouch.profile import Profile
from smarttouch.stimulation.scan_sequence import (
    PER_UA,
    KernelLists,
    KernelTable,
    SelectivityReport,
    largest_amplitude,
    round_charge_balanced,
    unsupported_reason,
)

Array = NDArray[np.float64]


class Slots(NamedTuple):
    """Slots of a scan sequence, of one or several classes."""

    site: NDArray[np.uint16]  # (S,)
    current_ua: NDArray[np.int16]  # (S, E)
    width_us: NDArray[np.uint16]  # (S,)
    proof: SelectivityReport | None = None  # selectivity of shared slots
    sums: KernelLists | None = None  # kernels that add up to the currents


_PROOF_SPACING_MM = 0.5
"""The proofs that sites are independent use a skin model with at least this node spacing. At 0.1 mm
instead, the proofs take 25 times as long, with the same results for the shipped arrays."""

_NONE = np.empty(0, np.intp)
_ROUNDING = 0.99
"""Proofs use this share of each selectivity bound. The rest is a margin for rounding. This margin
is large enough at intensities of `FrameSlots.certain_from` or more."""


class FrameSlots:
    """Maker of slots that stimulate several independent sites at once.

    A shared slot is a sum of kernels. Each subset of its kernels is proved to keep the profile's
    bounds on off-target and spill. Points without a proof get separate slots. Below the intensity
    `certain_from`, rounding could exceed a bound, so all points get separate slots. Such
    intensities cannot be felt. Raises ScheduleError if the board has a single source, or if the
    profile does not limit total current.
    """

    def __init__(self, profile: Profile, bank: KernelBank, afferent: Afferent) -> None:
        if (why := unsupported_reason(profile)) is not None:
            raise ScheduleError(f"points cannot share slots: {why}: set scan=points")
        kernels = np.asarray(bank.kernels(afferent), np.float64)
        judge = FrameJudge(
            _coarse(profile), afferent, full_wish(profile, kernels, bank.receptor[afferent])
        )
        frames, count = profile.frames, len(kernels)
        # Shared slots aim at slightly less activation than requested, to save current.
        self._aim = 1 - AIM * frames.uneven
        faintest = profile.threshold_ma / profile.full_ma
        sets = proved_sets(
            judge,
            FrameBounds(_ROUNDING * frames.other, _ROUNDING * frames.spill, frames.uneven),
        )
        driven = np.isin(np.arange(count), profile.driven)
        least = float(faintest[driven].min())
        self._certain = Certainty.of(sets, self._aim, least, profile.total_ma)
        self.certain_from: float = self._certain.least(
            FrameBounds(frames.other, frames.spill, frames.uneven)
        )
        """Lowest intensity at which rounded currents of all shared slots keep the bounds."""
        self._figures = lru_cache(maxsize=1)(self._certain.figures)
        self._most_ma = profile.total_ma - self._certain.total_ua / 1000
        self._shared_ma = np.concatenate(
            [np.empty((0, count)), *(proved.kernels for proved in sets)]
        )
        self._sites = np.concatenate([_NONE, *(proved.sites for proved in sets)])
        self._owner = np.repeat(np.arange(len(sets)), [len(proved.sites) for proved in sets])
        self._totals_ma = np.concatenate([np.empty(0), *(proved.totals_ma for proved in sets)])
        points_ma = kernels * np.minimum(profile.full_ma, judge.full_ma)[:, None]
        # kernels for shared slots, then kernels for single points
        self._kernels_ma = np.concatenate([self._shared_ma, points_ma])
        self._kernel_sites = np.concatenate([self._sites, np.arange(count)])
        self._peaks_ma = np.abs(self._kernels_ma).max(axis=1)
        self._points_do = np.stack([bank.off_target[afferent], bank.spill[afferent]])
        self._points_do[:, ~driven] = np.nan
        self._perceived_at = perceived_at(profile, afferent)
        self._faintest = np.where(driven, faintest, 0.0)
        self._range = np.where(driven, 1 - faintest, 0.0)
        self._widths_us = constant_us(count, profile.pulse.width_us)
        self._afferent = afferent
        self._table: KernelTable | None = None

    def kernels(self) -> tuple[Array, NDArray[np.intp]]:
        """Return the kernels for shared slots, (A, E) mA, and their sites, (A,)."""
        return self._shared_ma, self._sites

    def use_table(self, table: KernelTable) -> None:
        """Use the quantized kernels of a table from now on."""
        shared = table.shared[self._afferent] + np.arange(len(self._sites))
        points = table.points[self._afferent] + np.arange(len(self._widths_us))
        self._table, self._rows = table, np.concatenate([shared, points]).astype(np.uint16)

    def slots(self, activation: NDArray[np.float32], intensity: float) -> Slots:
        """Return slots and their selectivity, for the activation of a class, (E,), at an intensity.

        The faintest activation gives the threshold current times intensity. Full activation gives
        the comfort level times intensity. In a shared slot, the relative error of a point's
        activation is at most ``frames.uneven``. Currents are integer µA that sum to zero in each
        slot. Masked electrodes have no slot.
        """
        asked = activation if intensity > 0 else 0 * activation
        if self._perceived_at is not None:
            asked = np.append(asked, np.float32(0))[self._perceived_at]
        # Currents of shared slots are multiplied by `_aim` below. Divide levels by `_aim` here, so
        # that faint points are still felt.
        level = (self._range * asked + self._faintest) * (asked > 0) / self._aim
        level = np.minimum(level, 1.0, out=level)
        kernel, points = self._shared(level) if intensity >= self.certain_from else (_NONE, [])
        sites = self._sites.take(kernel)
        wanted = level.take(sites)
        level[sites] = 0
        alone = level.nonzero()[0]
        alone_level = level.take(alone)
        scale = np.concatenate([self._aim * wanted, alone_level])
        shared, count = len(points), len(points) + len(alone)
        points += [1] * len(alone)
        first = np.array([0, *accumulate(points)], np.intp)
        kernel = np.concatenate([kernel, len(self._sites) + alone])
        sums = None
        if self._table is not None:
            amplitude = np.rint(1000 * PER_UA * intensity * self._peaks_ma.take(kernel) * scale)
            sums = KernelLists(
                self._table, first, self._rows.take(kernel), amplitude.astype(np.uint16)
            )
            current_ua = sums.current_ua
        elif count:
            scaled_ua = self._kernels_ma.take(kernel, axis=0) * (1000 * intensity * scale)[:, None]
            current_ua = round_charge_balanced(np.add.reduceat(scaled_ua, first[:-1], axis=0))
        else:
            current_ua = np.empty((0, len(level)), np.int16)
        do = np.empty((2, count), np.float32)
        owner = self._owner.take(kernel.take(first[:shared]))
        do[:, :shared] = self._figures(intensity).take(owner, axis=1)
        # A report is relative to a target at level 1. The target of a slot with one point can have
        # a lower level, so multiply its values by this level.
        np.multiply(self._points_do.take(alone, axis=1), alone_level, out=do[:, shared:])
        site = self._kernel_sites.take(kernel.take(first[:-1])).astype(np.uint16)
        proof = SelectivityReport(np.array(points, np.uint16), *do)
        return Slots(site, current_ua, self._widths_us[:count], proof, sums)

    def _shared(self, level: Array) -> tuple[NDArray[np.intp], list[int]]:
        """Return the kernels of shared slots, ordered by slot, and the number of kernels in each
        slot. In each set of independent sites, begin with the strongest kernel. Put each kernel
        into the first slot whose total current stays within the limit."""
        wanted = level.take(self._sites)
        active = wanted.nonzero()[0]
        below_zero_ma = -self._aim * wanted.take(active) * self._totals_ma.take(active)
        columns = self._owner.take(active), below_zero_ma, active
        slots: list[list[int]] = []
        sums_ma: list[float] = []
        first, before = 0, -1
        for owner, minus_ma, kernel in sorted(zip(*map(np.ndarray.tolist, columns), strict=True)):
            total_ma = -minus_ma
            if owner != before:
                first, before = len(slots), owner
            for slot in range(first, len(slots)):
                if sums_ma[slot] + total_ma <= self._most_ma:
                    slots[slot].append(kernel)
                    sums_ma[slot] += total_ma
                    break
            else:
                slots.append([kernel])
                sums_ma.append(total_ma)
        shared = [kernels for kernels in slots if len(kernels) > 1]
        return np.array([*chain.from_iterable(shared)], np.intp), [*map(len, shared)]


def _coarse(profile: Profile) -> Profile:
    """Return a profile with a node spacing of at least `_PROOF_SPACING_MM`."""
    if profile.skin.node_spacing_mm >= _PROOF_SPACING_MM:
        return profile
    skin = profile.skin.model_copy(update={"node_spacing_mm": _PROOF_SPACING_MM})
    return profile.model_copy(update={"skin": skin})


class PointSlots:
    """Maker of slots with one kernel each. If `table` is given, its quantized kernels are used."""

    def __init__(
        self,
        profile: Profile,
        bank: KernelBank,
        afferent: Afferent,
        table: KernelTable | None = None,
        in_index_order: bool = False,
    ) -> None:
        weights, masked = np.asarray(bank.kernels(afferent), np.float32), profile.output.masked
        if weights[:, masked].any():
            raise ScheduleError(
                f"the kernels drive a masked electrode (output.masked is {list(masked)}): design "
                "kernels for this profile"
            )
        count = len(weights)
        self._kernels_ua = weights * (profile.full_ma * 1000)[:, None]
        magnitude = np.abs(self._kernels_ua)
        total_ma = magnitude.sum(axis=1) / 2000
        # Tolerate errors of single precision; the gate checks exact values.
        if total_ma.max() > profile.total_ma * (1 + 1e-6):
            site = int(total_ma.argmax())
            raise ScheduleError(
                f"the kernel of electrode {site} has a total current of {total_ma[site]:.2f} mA at "
                f"full strength, above the limit of {profile.total_ma:g} mA for a slot: lower "
                "perception.comfort_ratio, or set a lower limits.total_ma that new kernels keep",
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
            # All kernels of a table have the same peak weight.
            self._full = np.asarray(PER_UA * magnitude.max(axis=1), np.float32)
        self._faintest = np.asarray(profile.threshold_ma / profile.full_ma, np.float32)
        self._range = 1 - self._faintest
        # Sites below this level get no slot: with one source, their currents could round to zero.
        self._weakest_level = np.zeros(count, np.float32)
        if profile.output.kind != "weighted":
            least_ua = np.where(magnitude > 0, magnitude, np.inf).min(axis=1)
            self._weakest_level = np.asarray(1 / least_ua, np.float32)
        self._weakest_level[list(masked)] = np.inf
        self._widths_all_us = constant_us(count, self._pulse.width_us)
        self._single = afferent in bank.discs
        self._perceived_at = None if self._single else perceived_at(profile, afferent)
        self._in_index_order = in_index_order

    def slots(self, activation: NDArray[np.float32], intensity: float) -> Slots:
        """Return the slots of a class for its activation, (E,), at an intensity, both in [0, 1].

        The faintest activation gives the threshold current times intensity. Full activation gives
        the comfort level times intensity. Currents are integer µA that sum to zero in each slot.
        The strongest electrode takes the rounding remainder, if its limit allows this. Masked
        electrodes have no slot.
        """
        if self._perceived_at is not None:
            # Append a zero: the activation of points that are perceived outside of the array.
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
        """Return kernels times levels in integer µA, (S, E); the strongest electrode takes the
        remainder."""
        # Integers far below 2^24 are exact in single precision.
        whole_ua = np.rint(self._kernels_ua[site] * level[:, None])
        current_ua: NDArray[np.int16] = whole_ua.astype(np.int16)
        rows = np.arange(len(site)), self._strongest.take(site)
        current_ua[rows] -= whole_ua.sum(axis=1).astype(np.int16)
        if self._tight and (over := np.abs(current_ua[rows]) > self._most_ua[site]).any():
            current_ua[over] = self._carried(site[over], level[over])
        return current_ua

    def _carried(self, site: NDArray[np.intp], level: NDArray[np.float32]) -> NDArray[np.int16]:
        """Return kernels times levels in integer µA, (S, E), with errors below 1 µA each."""
        exact_ua = self._kernels_ua[site].astype(np.float64) * level[:, None]
        # Stay slightly below the integer limit, so that rounding cannot exceed it.
        peak_ua = np.abs(exact_ua).max(axis=1)
        exact_ua *= np.minimum(1, (self._most_ua[site] - 1e-3) / peak_ua)[:, None]
        return round_charge_balanced(exact_ua)


@lru_cache(maxsize=4096)
def spread_order(count: int) -> NDArray[np.intp]:
    """Return an order of ``count`` points in which successive points are far apart. The stride
    is about 0.38 times ``count`` (golden section)."""
    stride = round(count * 0.382)
    while stride > 1 and math.gcd(stride, count) > 1:
        stride += 1
    return np.asarray(np.arange(count) * max(1, stride) % max(1, count), np.intp)


def perceived_at(profile: Profile, afferent: Afferent) -> NDArray[np.intp] | None:
    """Return the electrode at which each point of a class is perceived, (E,). The value is E if a
    point is perceived outside of the array. Return None if the profile does not shift the class
    (paper, Section III-B.4)."""
    shifts = profile.perception
    shift_mm = (shifts.ra_shift_mm, shifts.sai_shift_mm, shifts.pc_shift_mm)[afferent]
    if not any(shift_mm):
        return None
    place_mm = profile.electrodes.position_mm
    away_mm = np.abs(place_mm[:, None] + shift_mm - place_mm)
    nearest = np.hypot(*away_mm.transpose(2, 0, 1)).argmin(axis=1)
    # A shifted point belongs to an electrode if it is at most half a cell away.
    half_mm = np.array(profile.electrodes.cell_mm) / 2 + 1e-9
    here = (away_mm[np.arange(len(nearest)), nearest] <= half_mm).all(axis=1)
    return np.asarray(np.where(here, nearest, len(nearest)), np.intp)


def constant_us(count: int, time_us: int) -> NDArray[np.uint16]:
    """Return a read-only array of ``count`` equal times, µs, for use by many sequences."""
    times = np.full(count, time_us, np.uint16)
    times.setflags(write=False)
    return times


def joined(parts: list[Slots]) -> Slots:
    site, current_ua, width_us = (
        np.concatenate([part[index] for part in parts]) for index in range(3)
    )
    proof, sums = None, None
    if any(part.proof is not None for part in parts):
        proofs = [part.proof or SelectivityReport.of_nothing(len(part.site)) for part in parts]
        proof = SelectivityReport(
            np.concatenate([part.points for part in proofs]),
            np.concatenate([part.off_target for part in proofs]),
            np.concatenate([part.spill for part in proofs]),
        )
    lists = [part.sums for part in parts if part.sums is not None]
    if len(lists) == len(parts):
        begins = np.cumsum([0, *(len(part.kernel) for part in lists)])
        ends = [part.first[1:] + begin for part, begin in zip(lists, begins, strict=False)]
        sums = KernelLists(
            lists[0].table,
            np.concatenate([begins[:1], *ends]),
            np.concatenate([part.kernel for part in lists]),
            np.concatenate([part.amplitude for part in lists]),
        )
    return Slots(site, current_ua, width_us, proof, sums)
