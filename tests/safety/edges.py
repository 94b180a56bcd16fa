"""Attacks on each limit, with sequences just inside it, exactly at it, and just beyond it."""

import math
from fractions import Fraction
from functools import cache

import numpy as np

from .bounds import (
    LONGEST_SHARE_US,
    MEAN_UA,
    NET_PC,
    RECHARGE_PC,
    RECHARGE_US,
    STRONG_A_SECOND,
    TIMES_ITS_SHARE,
    WHOLE,
)
from .drafts import intensity_of, level_at

MOST_SLOTS = 130
"""Largest number of slots of an attack. No attack needs more, and judging more takes long."""


def _site(draft, bounds, rng):
    """Replace all slots by a single one without current; return a random electrode."""
    draft.resize(1)
    return rng.randrange(bounds.electrodes)


def rate(draft, oracle, rng, beyond):
    draft.resize(1)
    draft.period_us = math.ceil(10**6 / oracle.bounds.rate_hz) - beyond


def period(draft, oracle, rng, beyond):
    draft.resize(1)
    draft.fit(oracle.bounds, 1_000)
    draft.discharge_us[0] += draft.period_us - draft.busy_us + beyond


def duty(draft, oracle, rng, beyond):
    bounds = oracle.bounds
    period_us = math.ceil(10**6 / bounds.rate_hz)
    most_us = math.floor(bounds.duty * period_us) + beyond
    slots = math.ceil(most_us / bounds.pulse_us)
    draft.resize(slots)
    draft.width_us[:] = most_us // slots
    draft.width_us[: most_us % slots] += 1
    draft.period_us = period_us


def balance(draft, oracle, rng, beyond):
    if draft.slots:
        draft.current_ua[rng.randrange(draft.slots), rng.randrange(oracle.bounds.electrodes)] += (
            beyond
        )


def width(draft, oracle, rng, beyond):
    draft.resize(2)
    draft.width_us[0] = rng.choice((oracle.bounds.pulse_us + beyond, 1 - max(beyond, 0)))
    draft.fit(oracle.bounds)


def current(draft, oracle, rng, beyond):
    bounds = oracle.bounds
    draft.resize(1)
    site = min(range(bounds.electrodes), key=lambda each: (bounds.electrode_ua[each], rng.random()))
    level = bounds.electrode_ua[site] + beyond
    draft.drive(0, site, level, rng)
    draft.width_us[0] = max(1, min(bounds.pulse_us, 100, bounds.charge_pc // level))
    draft.fit(bounds, 3_000)


def total(draft, oracle, rng, beyond):
    bounds = oracle.bounds
    draft.resize(1)
    draft.width_us[0] = 20
    wanted = bounds.total_ua + beyond
    level = max(1, min(level_at(bounds, draft.intensity), min(bounds.electrode_ua)))
    row = draft.current_ua[0]
    each = math.ceil(wanted / level)
    if 2 * each > len(row):
        # The array has too few electrodes for this level: use all, with a higher current.
        each, level = len(row) // 2, math.ceil(2 * wanted / len(row))
    for pole, first in ((1, 0), (-1, each)):
        row[first : first + each] = pole * (wanted // each)
        row[first : first + wanted % each] += pole
    rng.shuffle(row)
    draft.fit(bounds, 3_000)


def charge(draft, oracle, rng, beyond):
    bounds = oracle.bounds
    site = _site(draft, bounds, rng)
    least_us = math.ceil(bounds.charge_pc / max(1, level_at(bounds, draft.intensity)))
    draft.width_us[0] = rng.randint(min(least_us, bounds.pulse_us), bounds.pulse_us)
    level = bounds.charge_pc // int(draft.width_us[0]) + max(beyond, 0)
    draft.drive(0, site, level, rng)
    draft.fit(bounds, 3_000)


def discharge(draft, oracle, rng, beyond):
    if draft.slots:
        draft.discharge_us[rng.randrange(draft.slots)] = rng.choice((20 - beyond, 0, 21))


def intensity(draft, oracle, rng, beyond):
    bounds = oracle.bounds
    site = _site(draft, bounds, rng)
    highest = min(oracle.most(draft.clock_ns), WHOLE)
    ppb = rng.randint(0, max(0, highest // 2))
    draft.intensity = intensity_of(ppb)
    level = math.floor(Fraction(ppb, WHOLE) * bounds.full_ua + bounds.rounding_ua) + beyond
    draft.drive(0, site, min(level, 32_000), rng)
    draft.fit(bounds, 3_000)


def strong_pulses(draft, oracle, rng, beyond):
    bounds = oracle.bounds
    period_us = math.ceil(10**6 / bounds.rate_hz) + rng.choice((0, 0, 1_000, 50_000))
    count = STRONG_A_SECOND * min(period_us, LONGEST_SHARE_US) // 10**6 + max(beyond, 0)
    _strong(draft, oracle, rng.randrange(bounds.electrodes), count, rng)
    draft.period_us = max(period_us, draft.period_us)


def _strong(draft, oracle, site, count, rng):
    """Drive one electrode with pulses of its smallest perceptible current, or 1 µA less."""
    level = oracle.bounds.strong_ua[site] - (rng.random() < 0.2)
    draft.resize(min(count, MOST_SLOTS))
    draft.drive(slice(None), site, level, rng)
    draft.width_us[:] = rng.choice((1, 20, 50))
    draft.fit(oracle.bounds)


def mean_current(draft, oracle, rng, beyond):
    bounds = oracle.bounds
    period_us = math.ceil(10**6 / bounds.rate_hz) + rng.choice((0, 1_000, 50_000, 50_000))
    charge_pc = MEAN_UA * min(period_us, LONGEST_SHARE_US) + beyond
    _charged(draft, oracle, rng.randrange(bounds.electrodes), charge_pc, rng)
    draft.period_us = max(period_us, draft.period_us)


def _charged(draft, oracle, site, charge_pc, rng, sign=None):
    """Pass a charge through one electrode, in the largest allowed pulses; smaller pulses carry the
    rest. The net charge has the sign ``sign``. If ``sign`` is None, polarity alternates."""
    bounds = oracle.bounds
    level = max(1, min(level_at(bounds, draft.intensity), bounds.electrode_ua[site]))
    width_us = max(1, min(bounds.pulse_us, bounds.charge_pc // level))
    slots, rest_pc = divmod(charge_pc, level * width_us)
    if slots > MOST_SLOTS:
        return
    long, short = divmod(rest_pc, level)
    draft.resize(slots + 2)
    draft.drive(slice(slots + (long > 0)), site, level, rng)
    draft.drive(slots + 1, site, short, rng)
    draft.width_us[:slots] = width_us
    draft.width_us[slots:] = max(1, long), 1
    if sign is None:
        draft.current_ua[1::2] *= -1
    elif (draft.current_ua[:, site] * sign).sum() < 0:
        draft.current_ua *= -1
    draft.fit(bounds)


def vibration(draft, oracle, rng, beyond):
    draft.vibration = np.full(oracle.bounds.electrodes, draft.intensity / 2, np.float32)
    draft.vibration[rng.randrange(oracle.bounds.electrodes)] = rng.choice(
        (draft.intensity + 1e-6 + 2e-7 * beyond, -1e-7, -0.0, math.nan, math.inf, 0.0)
    )


def recharge(draft, oracle, rng, beyond):
    bounds = oracle.bounds
    phase = np.zeros(bounds.electrodes, np.int16)
    able = [site for site in range(bounds.electrodes) if bounds.recharge_ua[site]]
    sites = rng.sample(able, 2)
    level = min(bounds.recharge_ua[site] for site in sites)
    phase[sites] = [level, -level]
    draft.recharge_us = rng.randint(1, min(RECHARGE_US, RECHARGE_PC // level))
    if len(sites) == 2 and rng.random() < 0.9:
        # First charge these electrodes, because a recharge phase may only remove charge.
        draft.resize(1)
        most = min(
            level_at(bounds, draft.intensity), *(bounds.electrode_ua[each] for each in sites)
        )
        draft.current_ua[0, sites] = [-most, most]
        draft.width_us[0] = max(1, min(bounds.pulse_us, bounds.charge_pc // max(1, most)))
        q_pc = int(most * draft.width_us[0])
        carried = oracle.carried(draft.clock_ns)
        most_pc = min(q_pc - int(carried[sites[0]]), q_pc + int(carried[sites[1]]))
        level = max(1, min(level, most_pc))
        draft.recharge_us = max(1, min(RECHARGE_US, most_pc // level))
        phase[sites] = [level, -level]
    attack = rng.randrange(8)
    if attack == 0:
        phase[sites] = [level + beyond, -level - beyond]
    elif attack == 1:
        draft.recharge_us = rng.choice((0, 1, RECHARGE_US, RECHARGE_US + 1))
    elif attack == 2:
        phase[sites[0]] += beyond
    elif attack == 3:
        draft.recharge_us = min(RECHARGE_US, RECHARGE_PC // level + max(beyond, 0))
    elif attack == 5:
        phase = -phase
    draft.recharge_ua = None if attack == 4 else phase
    draft.fit(bounds, rng.choice((0, 20_000, 40_000)))
    if attack == 6 and draft.slots:
        draft.period_us = max(draft.busy_us + 20 - beyond, math.ceil(10**6 / bounds.rate_hz))


def time(draft, oracle, rng, beyond):
    last_ns = oracle.time_ns or 0
    draft.time_ns = max(0, last_ns + rng.choice((-beyond, -beyond, -(10**6))))
    draft.resize(0)
    draft.vibration = None


def _weak(draft, oracle, rng):
    """Replace all slots by a single one of 1 µA and 1 µs."""
    draft.resize(1)
    able = [site for site, most in enumerate(oracle.bounds.electrode_ua) if most]
    draft.current_ua[0, rng.sample(able, 2)] = 1, -1
    draft.width_us[0] = 1
    draft.vibration = None
    draft.fit(oracle.bounds, rng.choice((0, 20_000, 200_000)))


def _of_strength(draft, oracle, rng, most, beyond):
    """Replace all slots by one of strength ``most``. Randomly, intensity or charge limits it."""
    bounds = oracle.bounds
    _weak(draft, oracle, rng)
    whole_pc = bounds.full_pc * most / (TIMES_ITS_SHARE * WHOLE)
    peak_pc = math.ceil(whole_pc) if rng.random() < 0.5 else math.floor(whole_pc) + beyond
    if peak_pc == math.ceil(whole_pc):
        draft.intensity = intensity_of(most + beyond)
    else:
        draft.intensity = intensity_of(rng.randint(min(most, WHOLE), WHOLE))
    usual_us = bounds.usual_us if rng.random() < 0.8 else rng.randint(1, bounds.pulse_us)
    draft.width_us[0] = usual_us
    draft.current_ua[0] *= max(1, -(-peak_pc // usual_us))
    draft.fit(bounds, rng.choice((0, 20_000, 200_000)))


def ramp(draft, oracle, rng, beyond):
    _of_strength(draft, oracle, rng, oracle.most(draft.clock_ns), beyond)


def strength(draft, oracle, rng, beyond):
    """State full intensity for 1 µA, or reach or exceed the strength that the ramp allows."""
    most = oracle.most(draft.clock_ns)
    if most < WHOLE and rng.random() < 0.5:
        _weak(draft, oracle, rng)
        draft.intensity = 1.0
        draft.period_us = max(draft.period_us, rng.choice((0, oracle.bounds.ramp_ns // 1000)))
    else:
        _of_strength(draft, oracle, rng, most + rng.choice((0, 0, WHOLE // 10)), beyond)


def strong_in_a_second(draft, oracle, rng, beyond):
    used = oracle.in_the_second_before(draft.clock_ns)[0]
    most = STRONG_A_SECOND * LONGEST_SHARE_US // 10**6
    count = min(most, STRONG_A_SECOND - int(used.max()) + beyond)
    _strong(draft, oracle, int(used.argmax()), max(1, count), rng)
    draft.width_us[:] = 1
    draft.fit(oracle.bounds, LONGEST_SHARE_US)


def mean_in_a_second(draft, oracle, rng, beyond):
    used = oracle.in_the_second_before(draft.clock_ns)[1]
    left_pc = MEAN_UA * 10**6 - int(used.max()) + beyond
    charge_pc = max(1, min(MEAN_UA * LONGEST_SHARE_US, left_pc))
    _charged(draft, oracle, int(used.argmax()), charge_pc, rng)
    draft.fit(oracle.bounds, LONGEST_SHARE_US)


def net_in_a_second(draft, oracle, rng, beyond):
    high, low = oracle.most_net_before(draft.clock_ns)
    sign = rng.choice((1, -1))
    most_pc = high if sign == 1 else -low
    site = int(most_pc.argmax())
    left_pc = NET_PC - int(most_pc[site]) + beyond
    _charged(draft, oracle, site, max(1, min(MEAN_UA * LONGEST_SHARE_US, left_pc)), rng, sign)
    draft.fit(oracle.bounds, LONGEST_SHARE_US)


def sequences_in_a_second(draft, oracle, rng, beyond):
    draft.resize(rng.choice((0, 1)))
    draft.fit(oracle.bounds)


def session_time(draft, oracle, rng, beyond):
    left_us, _ = oracle.session_left(draft.clock_ns)
    draft.resize(1)
    draft.period_us = rng.choice((60_000_000, 1_000_000, 20_000))
    draft.times = max(1, min(65_535, left_us // draft.period_us + beyond))


def session_charge(draft, oracle, rng, beyond):
    bounds = oracle.bounds
    if rng.random() < 0.7:
        # Alternate signs, and repeat slowly, so that no other limit binds first.
        _charged(draft, oracle, rng.randrange(bounds.electrodes), 2 * bounds.charge_pc, rng)
        draft.period_us = max(20_000, draft.period_us)
    if not draft.slots:
        return
    _, left_pc = oracle.session_left(draft.clock_ns)
    charge_pc = (np.abs(draft.current_ua) * draft.width_us[:, None]).sum(axis=0)
    if charge_pc.any():
        times = int((left_pc // np.maximum(charge_pc, 1))[charge_pc > 0].min())
        draft.times = max(1, min(65_535, times + beyond))


EDGES = {
    "rate": rate, "period": period, "duty": duty, "balance": balance, "width": width,
    "current": current, "total": total, "charge": charge, "discharge": discharge,
    "intensity": intensity, "strong pulses": strong_pulses, "mean current": mean_current,
    "vibration": vibration, "recharge": recharge, "time": time, "ramp": ramp,
    "strength": strength, "strong in a second": strong_in_a_second,
    "mean in a second": mean_in_a_second, "net in a second": net_in_a_second,
    "sequences in a second": sequences_in_a_second, "reduces charge": recharge,
    "session time": session_time, "session charge": session_charge,
}  # fmt: skip
"""Attack functions by rule. The last argument is −1, 0 or 1: inside, at or beyond the limit."""


@cache
def attacks(bounds):
    """Return the names of a display's attacks. Names are repeated to make rare attacks likelier."""
    full_ua = bounds.full_ua + bounds.rounding_ua
    often = ["current"] * (min(bounds.electrode_ua) < full_ua)
    often += ["charge"] * (full_ua * bounds.pulse_us > bounds.charge_pc)
    ramps = ("ramp", *("strength",) * 3)
    return (*EDGES, *ramps, *("mean current", "total") * 2, *often * 12)
