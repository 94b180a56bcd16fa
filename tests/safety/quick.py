"""The limits of a single sequence in whole arrays at once: `rules`, a hundred times as fast.

A test holds it equal to the plain form; end-to-end tests and long runs judge with it.
"""

import math
from fractions import Fraction
from functools import cache

import numpy as np

from .bounds import (
    LEAST_DISCHARGE_US,
    LONGEST_SHARE_US,
    MEAN_UA,
    RECHARGE_PC,
    STRONG_A_SECOND,
    WHOLE,
    exact,
)
from .rules import Judged, wrong_types


@cache
def _arrays(bounds):
    """Return the limits of each electrode as arrays: current, strong pulse, recharge."""
    never = np.iinfo(np.int64).max
    each = (bounds.electrode_ua, bounds.strong_ua, bounds.recharge_ua)
    return [
        np.full(bounds.electrodes, never) if limit is None else np.array(limit, np.int64)
        for limit in each
    ]


def judge_alone_quickly(sequence, bounds):
    """Return what `rules.judge_alone` does."""
    if wrong := wrong_types(sequence, bounds):
        return Judged(wrong)
    most_ua, strong_ua, recharge_most_ua = _arrays(bounds)
    signed = sequence.current_ua.astype(np.int64)
    current, width = np.abs(signed), sequence.width_us.astype(np.int64)
    charge = current * width[:, None]
    period_us, recharge_us = int(sequence.period_us), int(sequence.recharge_us)
    recharge = sequence.recharge_ua
    intensity = exact(sequence.intensity)
    ppb = math.ceil(intensity * WHOLE)
    peak_ua, peak_pc = int(current.max(initial=0)), int(charge.max(initial=0))
    strong, through_pc = (current >= strong_ua).sum(axis=0), charge.sum(axis=0)
    keeps_recharge, short_us = recharge_us == 0, 0
    recharge_pc = np.zeros(bounds.electrodes, np.int64)
    if recharge is not None:
        short_us = LEAST_DISCHARGE_US
        recharge_pc = recharge.astype(np.int64) * recharge_us
        weak = np.abs(recharge.astype(np.int64))
        through_pc = through_pc + weak * recharge_us
        keeps_recharge = (
            len(width) > 0
            and recharge_us >= 1
            and int(recharge.sum(dtype=np.int64)) == 0
            and int(weak.sum()) <= 2 * bounds.total_ua
            and bool((weak <= recharge_most_ua).all())
            and int(weak.max()) * recharge_us <= RECHARGE_PC
        )
    spent_us = int(width.sum()) + int(sequence.discharge_us.sum(dtype=np.int64)) + recharge_us
    share_us = min(period_us, LONGEST_SHARE_US)
    through = current.sum(axis=1) * width
    kept = {
        "rate": period_us * bounds.rate_hz >= 10**6,
        "period": spent_us + short_us <= period_us,
        "duty": int(width.sum()) + recharge_us <= bounds.duty * period_us,
        "balance": not signed.sum(axis=1).any(),
        "width": bool(((width >= 1) & (width <= bounds.pulse_us)).all()),
        "current": bool((current <= most_ua).all()),
        "total": int(np.maximum(signed, 0).sum(axis=1).max(initial=0)) <= bounds.total_ua,
        "charge": peak_pc <= bounds.charge_pc
        and (bounds.source_pc is None or int(through.max(initial=0)) <= 2 * bounds.source_pc),
        "discharge": bool((sequence.discharge_us >= LEAST_DISCHARGE_US).all()),
        "intensity": _keeps_intensity(peak_ua, peak_pc, Fraction(ppb, WHOLE), bounds),
        "strong pulses": int(strong.max()) * 10**6 <= STRONG_A_SECOND * share_us,
        "mean current": int(through_pc.max()) <= MEAN_UA * share_us,
        "vibration": _keeps_vibration(sequence.vibration, intensity),
        "recharge": keeps_recharge,
    }
    return Judged(
        [name for name, keeps in kept.items() if not keeps], ppb, int(sequence.time_ns), period_us,
        len(width), strong, through_pc, (signed * width[:, None]).sum(axis=0), recharge_pc,
        spent_us, peak_pc,
    )  # fmt: skip


def _keeps_intensity(peak_ua, peak_pc, share, bounds):
    if bounds.full_us is None:
        return peak_ua <= share * bounds.full_ua + bounds.rounding_ua
    most_ua = bounds.full_ua + bounds.rounding_ua
    return peak_ua <= most_ua and peak_pc <= share * most_ua * bounds.full_us * Fraction(1001, 1000)


def _keeps_vibration(vibration, intensity):
    if vibration is None:
        return True
    least, most = float(vibration.min()), float(vibration.max())
    # Where one is no number, so are both.
    return least >= 0 and math.isfinite(most) and exact(most) <= intensity + Fraction(1, 10**6)
