"""Slots with several points each, of one afferent class: the same frame in fewer slots."""

from functools import lru_cache
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ScheduleError
from smarttouch.kernels.bank import KernelBank
from smarttouch.kernels.selectivity import (
    AIM,
    Certainty,
    FrameBounds,
    FrameJudge,
    full_wish,
    proved_sets,
)
from smarttouch.profile import Profile
from smarttouch.stimulation.point_slots import Slots, constant_us, perceived_at
from smarttouch.stimulation.scan_sequence import (
    PER_UA,
    KernelLists,
    KernelTable,
    SelectivityReport,
    round_charge_balanced,
    unsupported_reason,
)

Array = NDArray[np.float64]

_JUDGED_MM = 0.5
"""Least distance of places at which sets are proved, 25 times as fast as .1 mm, where what is
proved of all frames of a shipped array is no larger (tests/kernels/test_proved_sets.py)."""

_ROUNDING = 0.99
"""Part of a bound that proofs keep, so that whole µA keep all of it down to `certain_from`."""


class FrameSlots:
    """Slots of one class; points whose currents do not interfere share one.

    A slot is a sum of kernels of which no subset breaks the profile's bounds on what it does to
    other classes, and to its own class elsewhere; a point of which nothing is proved has a slot of
    its own. So has each at intensities below `certain_from`, where nothing is felt and rounding may
    break a bound. A board without a current of its own for every electrode, or a profile where
    total current is not limited, raises a ScheduleError.
    """

    def __init__(self, profile: Profile, bank: KernelBank, afferent: Afferent) -> None:
        if (why := unsupported_reason(profile)) is not None:
            raise ScheduleError(f"points cannot share slots: {why}: choose points")
        kernels = np.asarray(bank.kernels(afferent), np.float64)
        judge = FrameJudge(
            _coarse(profile), afferent, full_wish(profile, kernels, bank.receptor[afferent])
        )
        frames, count = profile.frames, len(kernels)
        # Slots aim a little low, which saves current.
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
        """Intensity from which no sum breaks a bound, whatever rounding to whole numbers does."""
        self._figures = lru_cache(maxsize=1)(self._certain.figures)
        self._most_ma = profile.total_ma - self._certain.total_ua / 1000
        self._shared_ma = np.concatenate(
            [np.empty((0, count)), *(proved.kernels for proved in sets)]
        )
        self._sites = np.concatenate([np.empty(0, np.intp), *(proved.sites for proved in sets)])
        self._owner = np.repeat(np.arange(len(sets)), [len(proved.sites) for proved in sets])
        self._totals_ma = np.concatenate([np.empty(0), *(proved.totals_ma for proved in sets)])
        points_ma = kernels * np.minimum(profile.full_ma, judge.full_ma)[:, None]
        # Kernels that share slots, and then each point's own.
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
        """Return the kernels by which slots are shared, (A, E) mA, and their sites (A,)."""
        return self._shared_ma, self._sites

    def use_table(self, table: KernelTable) -> None:
        """Make slots as sums of kernels in whole numbers from now on."""
        shared = table.shared[self._afferent] + np.arange(len(self._sites))
        points = table.points[self._afferent] + np.arange(len(self._widths_us))
        self._table, self._rows = table, np.concatenate([shared, points]).astype(np.uint16)

    def slots(self, activation: NDArray[np.float32], intensity: float) -> Slots:
        """Return slots, with proof, of one class's activation (E,) at an intensity.

        An active point is activated as its own kernel would, with its threshold current times
        intensity at the faintest activation and its strongest comfortable current times intensity
        at full activation, but for the unevenness that the profile allows. Currents are whole µA
        that sum to zero in every slot. A masked electrode has no slot.
        """
        asked = activation if intensity > 0 else 0 * activation
        if self._perceived_at is not None:
            asked = np.append(asked, np.float32(0))[self._perceived_at]
        # The faintest would not be felt at the aim.
        level = (self._range * asked + self._faintest) * (asked > 0) / self._aim
        level = np.minimum(level, 1.0, out=level)
        parts = self._parts(level) if intensity >= self.certain_from else []
        kernel = np.fromiter(chain.from_iterable(parts), np.intp)
        points = np.fromiter(map(len, parts), np.intp, len(parts))
        wanted = level.take(self._sites.take(kernel))
        level[self._sites.take(kernel)] = 0
        alone = level.nonzero()[0]
        alone_level = level.take(alone)
        scale = np.concatenate([self._aim * wanted, alone_level])
        shared, count = len(parts), len(parts) + len(alone)
        points = np.concatenate([points, np.ones(len(alone), np.intp)])
        first = np.zeros(count + 1, np.intp)
        points.cumsum(out=first[1:])
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
        # A faint point does so much less: figures are scaled to level 1.
        np.multiply(self._points_do[:, alone], alone_level, out=do[:, shared:])
        site = self._kernel_sites.take(kernel.take(first[:-1])).astype(np.uint16)
        proof = SelectivityReport(points.astype(np.uint16), *do)
        return Slots(site, current_ua, self._widths_us[:count], proof, sums)

    def _parts(self, level: Array) -> list[list[int]]:
        """Return the shared kernels of each slot of several points, set after set, each slot filled
        in the order of strength as far as total current allows."""
        wanted = level.take(self._sites)
        active = wanted.nonzero()[0]
        totals_ma = self._aim * wanted.take(active) * self._totals_ma.take(active)
        owners = self._owner.take(active)
        order = np.lexsort((-totals_ma, owners))
        parts: list[list[int]] = []
        sums_ma: list[float] = []
        first, before = 0, -1
        indexes, totals = active.take(order).tolist(), totals_ma.take(order).tolist()
        for index, total_ma, owner in zip(
            indexes, totals, owners.take(order).tolist(), strict=True
        ):
            if owner != before:
                first, before = len(parts), owner
            for part in range(first, len(parts)):
                if sums_ma[part] + total_ma <= self._most_ma:
                    parts[part].append(index)
                    sums_ma[part] += total_ma
                    break
            else:
                parts.append([index])
                sums_ma.append(total_ma)
        return [part for part in parts if len(part) > 1]


def _coarse(profile: Profile) -> Profile:
    """Return a profile with places at `_JUDGED_MM` or farther apart."""
    if profile.skin.node_spacing_mm >= _JUDGED_MM:
        return profile
    skin = profile.skin.model_copy(update={"node_spacing_mm": _JUDGED_MM})
    return profile.model_copy(update={"skin": skin})
