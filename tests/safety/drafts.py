"""Random sequences that keep most limits, from which attacks start."""

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from smarttouch.stimulation.scan_sequence import ScanSequence

from .bounds import LATE_NS, NS, TIMES_ITS_SHARE, WHOLE, exact


@dataclass
class Draft:
    """Sequence that attacks can modify, with the clock time of sending and the number of passes.

    Its arrays have 64 bits, so that attacks can set too large values. `made` wraps them to 16 bits.
    """

    current_ua: np.ndarray
    width_us: np.ndarray
    discharge_us: np.ndarray
    site: np.ndarray
    period_us: int
    intensity: float
    time_ns: int
    clock_ns: int
    times: int = 1
    vibration: np.ndarray | None = None
    recharge_ua: np.ndarray | None = None
    recharge_us: int = 0

    @property
    def slots(self):
        return len(self.width_us)

    @property
    def busy_us(self):
        return int(self.width_us.sum() + self.discharge_us.sum()) + self.recharge_us

    def made(self, **other):
        """Return the sequence, with the fields in ``other`` replaced."""
        values = {
            "current_ua": self.current_ua.astype(np.int16),
            "width_us": self.width_us.astype(np.uint16),
            "discharge_us": self.discharge_us.astype(np.uint16),
            "site": self.site.astype(np.uint16), "period_us": self.period_us,
            "intensity": self.intensity, "time_ns": self.time_ns, "vibration": self.vibration,
            "recharge_ua": self.recharge_ua, "recharge_us": self.recharge_us,
        }  # fmt: skip
        return ScanSequence(**values | other)

    def resize(self, slots):
        """Replace the slots by a number of short slots without current."""
        self.current_ua = np.zeros((slots, self.current_ua.shape[1]), np.int64)
        self.width_us = np.full(slots, 50)
        self.discharge_us = np.full(slots, 20)
        self.site = np.zeros(slots, np.int64)

    def drive(self, slots, site, level_ua, rng):
        """Drive one electrode in some slots, in a random polarity, against all others."""
        others = self.current_ua.shape[1] - 1
        row = np.full(others + 1, -(level_ua // others))
        row[np.delete(np.arange(others + 1), site)[: level_ua % others]] -= 1
        row[site] = level_ua
        self.site[slots] = site
        self.current_ua[slots] = row if rng.random() < 0.5 else -row

    def fit(self, bounds, spare_us=0):
        """Set the period to the shortest that slots, rate and duty allow, plus ``spare_us``."""
        self.period_us = spare_us + max(
            math.ceil(10**6 / bounds.rate_hz),
            math.ceil(int(self.width_us.sum()) / bounds.duty),
            self.busy_us,
        )


def intensity_of(ppb):
    """Return an intensity whose value in parts per billion, rounded up, is ``ppb``."""
    value = max(0, min(ppb, WHOLE)) / WHOLE
    while value and math.ceil(exact(value) * WHOLE) > ppb:
        value = math.nextafter(value, 0)
    return value


def level_at(bounds, intensity):
    """Return the largest current at an intensity, µA, without the tolerance for rounding."""
    return math.floor(exact(intensity) * bounds.full_ua)


def ordinary(oracle, rng, clock_ns, time_ns, full=False):
    """Draw a sequence that keeps most limits.

    Usually, and always if ``full``, its intensity is the largest that the ramp allows.
    """
    bounds = oracle.bounds
    most = min(oracle.most(clock_ns), WHOLE)
    ppb = max(most, 0) if full or rng.random() < 0.8 else rng.randint(0, max(most, 0))
    intensity = 1.0 if ppb == WHOLE else intensity_of(ppb)
    slots = rng.choice((0, 1, 1, 1, 2, 2, 3, 4, 6))
    count = bounds.electrodes
    draft = Draft(
        np.zeros((slots, count), np.int64), np.zeros(slots, np.int64), np.zeros(slots, np.int64),
        np.zeros(slots, np.int64), 0, intensity, time_ns, clock_ns,
    )  # fmt: skip
    level = level_at(bounds, intensity)
    for slot in range(slots):
        site = rng.randrange(count)
        width = rng.randint(1, bounds.pulse_us)
        draft.width_us[slot] = width
        draft.discharge_us[slot] = rng.randint(20, 150)
        top = min(level, bounds.electrode_ua[site], bounds.charge_pc // width, bounds.total_ua)
        draft.drive(slot, site, rng.randint(0, top), rng)
    draft.fit(bounds, rng.choice((0, 0, 100, 3_000, 20_000, 500_000)))
    if rng.random() < 0.1:
        draft.vibration = np.full(count, intensity * rng.random(), np.float32)
    return draft


def opening(oracle, clock_ns, time_ns):
    """Return the weakest pulse of the largest allowed strength; its period is `LATE_NS` or more."""
    bounds = oracle.bounds
    row = np.zeros((1, bounds.electrodes), np.int64)
    able = [site for site, most in enumerate(bounds.electrode_ua) if most]
    most = min(oracle.most(clock_ns), WHOLE)
    weak_ua = math.ceil(Fraction(most, WHOLE) * bounds.full_ua / TIMES_ITS_SHARE)
    row[0, able[0]], row[0, able[-1]] = weak_ua, -weak_ua
    one = np.ones(1, np.int64)
    width_us = bounds.usual_us
    period_us = max(LATE_NS // 1000, math.ceil(10**6 / bounds.rate_hz))
    return Draft(
        row, one * width_us, one * 50, one * 0, period_us, intensity_of(most), time_ns, clock_ns
    )


def later(oracle, rng):
    """Draw how far the clock and the stated time advance, ns: usually equal, sometimes not."""
    if oracle.most(oracle.clock_ns or 0) < WHOLE and rng.random() < 0.3:
        return oracle.bounds.ramp_ns, oracle.bounds.ramp_ns
    step = rng.choice(
        (0, 1, 1_000, 10**6, 5 * 10**6, 20 * 10**6, 20 * 10**6, 10**8, NS, 9 * NS, 16 * NS)
    )
    chance = rng.random()
    if chance < 0.8:
        return step, max(step, 1)
    if chance < 0.9:
        return rng.choice((-NS, -1, 0, step)), rng.randint(1, NS)
    return step, rng.choice((1, step + 10**8, NS))
