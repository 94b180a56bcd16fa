"""Integer checks of the limits of a single sequence."""

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import cache

import numpy as np

from .bounds import (
    LATEST_NS,
    LEAST_DISCHARGE_US,
    LONGEST_PERIOD_US,
    LONGEST_SHARE_US,
    MEAN_UA,
    RECHARGE_PC,
    RECHARGE_US,
    STRONG_A_SECOND,
    WHOLE,
    exact,
)

ARRAYS = {
    "current_ua": ("int16", "SE"), "width_us": ("uint16", "S"), "discharge_us": ("uint16", "S"),
    "site": ("uint16", "S"), "vibration": ("float32", "E"), "recharge_ua": ("int16", "E"),
}  # fmt: skip
"""Type and axes of each array: S slots, E electrodes."""
RULES = (
    "rate", "period", "duty", "balance", "width", "current", "total", "charge", "discharge",
    "intensity", "strong pulses", "mean current", "vibration", "recharge",
)  # fmt: skip
"""Names of the rules for a single sequence."""


@dataclass(frozen=True)
class Judged:
    """Rules that a single sequence breaks, and the load of one pass on each electrode.

    ``intensity_ppb`` is in parts per billion, rounded up. Arrays are (E,) int64; they are None if a
    type or a range is wrong."""

    broken: list
    intensity_ppb: int = 0
    time_ns: int = 0
    period_us: int = 0
    slots: int = 0
    strong: object = None
    charge_pc: object = None
    slots_pc: object = None
    recharge_pc: object = None
    busy_us: int = 0
    peak_pc: int = 0


def judge_alone(sequence, bounds):
    """Judge a sequence without regard to other sequences."""
    if wrong := _wrong_types(sequence, bounds):
        return Judged(wrong)
    most_ua, strong_ua, recharge_most_ua = _limits(bounds)
    signed = sequence.current_ua.astype(np.int64)
    current, width = np.abs(signed), sequence.width_us.astype(np.int64)
    charge = current * width[:, None]
    period_us, recharge_us = int(sequence.period_us), int(sequence.recharge_us)
    intensity = exact(sequence.intensity)
    ppb = math.ceil(intensity * WHOLE)
    peak_ua, peak_pc = int(current.max(initial=0)), int(charge.max(initial=0))
    strong, through_pc = (current >= strong_ua).sum(axis=0), charge.sum(axis=0)
    keeps_recharge, short_us = recharge_us == 0, 0
    recharge_pc = np.zeros(bounds.electrodes, np.int64)
    if sequence.recharge_ua is not None:
        short_us = LEAST_DISCHARGE_US
        recharge = sequence.recharge_ua.astype(np.int64)
        weak, recharge_pc = np.abs(recharge), recharge * recharge_us
        through_pc = through_pc + weak * recharge_us
        keeps_recharge = (
            len(width) > 0
            and recharge_us >= 1
            and int(recharge.sum()) == 0
            and int(weak.sum()) <= 2 * bounds.total_ua
            and bool((weak <= recharge_most_ua).all())
            and int(weak.max()) * recharge_us <= RECHARGE_PC
        )
    busy_us = int(width.sum()) + int(sequence.discharge_us.sum(dtype=np.int64)) + recharge_us
    share_us = min(period_us, LONGEST_SHARE_US)
    through = current.sum(axis=1) * width
    kept = {
        "rate": period_us * bounds.rate_hz >= 10**6,
        "period": busy_us + short_us <= period_us,
        "duty": int(width.sum()) + recharge_us <= bounds.duty * period_us,
        "balance": not signed.sum(axis=1).any(),
        "width": bool(((width >= 1) & (width <= bounds.pulse_us)).all()),
        "current": bool((current <= most_ua).all()),
        "total": int(np.maximum(signed, 0).sum(axis=1).max(initial=0)) <= bounds.total_ua,
        "charge": peak_pc <= bounds.charge_pc
        and (bounds.source_pc is None or int(through.max(initial=0)) <= 2 * bounds.source_pc),
        "discharge": bool((sequence.discharge_us >= LEAST_DISCHARGE_US).all()),
        "intensity": peak_ua <= Fraction(ppb, WHOLE) * bounds.full_ua + bounds.rounding_ua,
        "strong pulses": int(strong.max()) * 10**6 <= STRONG_A_SECOND * share_us,
        "mean current": int(through_pc.max()) <= MEAN_UA * share_us,
        "vibration": _keeps_vibration(sequence.vibration, intensity),
        "recharge": keeps_recharge,
    }
    return Judged(
        [name for name, keeps in kept.items() if not keeps], ppb,
        int(sequence.time_ns), period_us, len(width), strong, through_pc,
        (signed * width[:, None]).sum(axis=0), recharge_pc, busy_us, peak_pc,
    )  # fmt: skip


def _wrong_types(sequence, bounds):
    """Return ["types"] or ["range"] if further rules cannot be checked, otherwise []."""
    whole = [sequence.period_us, sequence.time_ns, sequence.recharge_us]
    if not all(map(_is_whole, whole)) or not _is_real(sequence.intensity):
        return ["types"]
    slots = np.size(sequence.width_us)
    sizes = {"SE": (slots, bounds.electrodes), "S": (slots,), "E": (bounds.electrodes,)}
    for name, (kind, axes) in ARRAYS.items():
        array = getattr(sequence, name, None)
        if array is None and name in ("vibration", "recharge_ua"):
            continue
        if not isinstance(array, np.ndarray) or array.dtype != np.dtype(kind):
            return ["types"]
        if array.shape != sizes[axes]:
            return ["types"]
    in_range = (
        1 <= int(sequence.period_us) <= LONGEST_PERIOD_US
        and 0 <= int(sequence.time_ns) < LATEST_NS
        and _is_share(sequence.intensity)
        and 0 <= int(sequence.recharge_us) <= RECHARGE_US
        and bool((sequence.site < bounds.electrodes).all())
    )
    return [] if in_range else ["range"]


@cache
def _limits(bounds):
    """Return limits as arrays, (E,) µA: current, smallest perceptible current, recharge current."""
    never = np.iinfo(np.int64).max
    each = (bounds.electrode_ua, bounds.strong_ua, bounds.recharge_ua)
    return [
        np.full(bounds.electrodes, never) if limit is None else np.array(limit, np.int64)
        for limit in each
    ]


def _keeps_vibration(vibration, intensity):
    if vibration is None:
        return True
    least, most = float(vibration.min()), float(vibration.max())
    # If a value is NaN, minimum and maximum are NaN, and comparisons are false.
    return least >= 0 and math.isfinite(most) and exact(most) <= intensity + Fraction(1, 10**6)


def _is_whole(value):
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def _is_real(value):
    return isinstance(value, int | float | np.floating) and not isinstance(value, bool)


def _is_share(value):
    """Return whether a number, converted to float, is in [0, 1]."""
    try:
        return 0 <= float(value) <= 1
    except OverflowError:
        return False
