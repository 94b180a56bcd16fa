"""The limits of a single sequence, judged number by number in plain Python."""

import math
from dataclasses import dataclass
from fractions import Fraction

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
"""Type and axes of every array: slots and electrodes."""


@dataclass(frozen=True)
class Plain:
    """A sequence of the right types, as lists and whole numbers.

    ``intensity_ppb`` is the intensity in parts per billion, rounded up.
    """

    current_ua: list
    width_us: list
    discharge_us: list
    period_us: int
    intensity: Fraction
    intensity_ppb: int
    time_ns: int
    vibration: list | None
    recharge_ua: list | None
    recharge_us: int

    def through(self, electrode):
        """Return the currents through one electrode, slot by slot."""
        return [row[electrode] for row in self.current_ua]


def wrong_types(sequence, bounds):
    """Return "types" or "range" if a sequence cannot be judged further, else nothing."""
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
        and all(site < bounds.electrodes for site in sequence.site.tolist())
    )
    return [] if in_range else ["range"]


def plain(sequence):
    """Return a sequence of the right types as lists and whole numbers."""
    vibration = sequence.vibration
    recharge = sequence.recharge_ua
    intensity = exact(sequence.intensity)
    return Plain(
        sequence.current_ua.tolist(), sequence.width_us.tolist(), sequence.discharge_us.tolist(),
        int(sequence.period_us), intensity, math.ceil(intensity * WHOLE), int(sequence.time_ns),
        None if vibration is None else vibration.tolist(),
        None if recharge is None else recharge.tolist(), int(sequence.recharge_us),
    )  # fmt: skip


def strong_pulses(scan, bounds):
    """Return how many strong pulses each electrode gets."""
    if bounds.strong_ua is None:
        return [0] * bounds.electrodes
    return [
        sum(abs(current) >= bounds.strong_ua[electrode] for current in scan.through(electrode))
        for electrode in range(bounds.electrodes)
    ]


def charge_through_pc(scan, bounds):
    """Return the charge of both signs that passes each electrode, the recharge phase included."""
    recharge = scan.recharge_ua or [0] * bounds.electrodes
    return [
        sum(
            abs(current) * width
            for current, width in zip(scan.through(electrode), scan.width_us, strict=True)
        )
        + abs(recharge[electrode]) * scan.recharge_us
        for electrode in range(bounds.electrodes)
    ]


def slots_through_pc(scan, bounds):
    """Return the charge of the slots through each electrode, with its sign."""
    return [
        sum(c * width for c, width in zip(scan.through(electrode), scan.width_us, strict=True))
        for electrode in range(bounds.electrodes)
    ]


def keeps_rate(scan, bounds):
    return scan.period_us * bounds.rate_hz >= 10**6


def keeps_period(scan, bounds):
    short_us = 0 if scan.recharge_ua is None else LEAST_DISCHARGE_US
    busy_us = sum(scan.width_us) + sum(scan.discharge_us) + scan.recharge_us
    return busy_us + short_us <= scan.period_us


def keeps_duty(scan, bounds):
    return sum(scan.width_us) + scan.recharge_us <= bounds.duty * scan.period_us


def keeps_balance(scan, bounds):
    return all(sum(row) == 0 for row in scan.current_ua)


def keeps_width(scan, bounds):
    return all(1 <= width <= bounds.pulse_us for width in scan.width_us)


def keeps_current(scan, bounds):
    return all(
        abs(current) <= most
        for row in scan.current_ua
        for current, most in zip(row, bounds.electrode_ua, strict=True)
    )


def keeps_total(scan, bounds):
    return all(sum(each for each in row if each > 0) <= bounds.total_ua for row in scan.current_ua)


def keeps_charge(scan, bounds):
    return all(
        abs(current) * width <= bounds.charge_pc
        for row, width in zip(scan.current_ua, scan.width_us, strict=True)
        for current in row
    ) and all(
        bounds.source_pc is None or sum(abs(each) for each in row) * width <= 2 * bounds.source_pc
        for row, width in zip(scan.current_ua, scan.width_us, strict=True)
    )


def keeps_discharge(scan, bounds):
    return all(each >= LEAST_DISCHARGE_US for each in scan.discharge_us)


def keeps_intensity(scan, bounds):
    share = Fraction(scan.intensity_ppb, WHOLE)
    if bounds.full_us is None:
        most_ua = share * bounds.full_ua + bounds.rounding_ua
        return all(abs(current) <= most_ua for row in scan.current_ua for current in row)
    most_ua = bounds.full_ua + bounds.rounding_ua
    most_pc = share * most_ua * bounds.full_us * Fraction(1001, 1000)
    return all(
        abs(current) <= most_ua and abs(current) * width <= most_pc
        for row, width in zip(scan.current_ua, scan.width_us, strict=True)
        for current in row
    )


def keeps_strong(scan, bounds):
    share_us = min(scan.period_us, LONGEST_SHARE_US)
    return all(count * 10**6 <= STRONG_A_SECOND * share_us for count in strong_pulses(scan, bounds))


def keeps_mean(scan, bounds):
    share_us = min(scan.period_us, LONGEST_SHARE_US)
    return all(charge <= MEAN_UA * share_us for charge in charge_through_pc(scan, bounds))


def keeps_vibration(scan, bounds):
    if scan.vibration is None:
        return True
    most = scan.intensity + Fraction(1, 10**6)
    return all(math.isfinite(each) and 0 <= exact(each) <= most for each in scan.vibration)


def keeps_recharge(scan, bounds):
    if scan.recharge_ua is None:
        return scan.recharge_us == 0
    magnitudes = [abs(current) for current in scan.recharge_ua]
    weak = bounds.recharge_ua is None or all(
        each <= most for each, most in zip(magnitudes, bounds.recharge_ua, strict=True)
    )
    return (
        weak
        and len(scan.width_us) > 0
        and sum(scan.recharge_ua) == 0
        and sum(magnitudes) <= 2 * bounds.total_ua
        and scan.recharge_us >= 1
        and all(each * scan.recharge_us <= RECHARGE_PC for each in magnitudes)
    )


RULES = {
    "rate": keeps_rate, "period": keeps_period, "duty": keeps_duty, "balance": keeps_balance,
    "width": keeps_width, "current": keeps_current, "total": keeps_total, "charge": keeps_charge,
    "discharge": keeps_discharge, "intensity": keeps_intensity, "strong pulses": keeps_strong,
    "mean current": keeps_mean, "vibration": keeps_vibration, "recharge": keeps_recharge,
}  # fmt: skip
"""The limits of a single sequence, by name."""


@dataclass(frozen=True)
class Judged:
    """Broken rules of a single sequence, and its dose for each electrode if it may be sent."""

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
    """Return what a sequence breaks by itself, with the names of all rules that it breaks."""
    if wrong := wrong_types(sequence, bounds):
        return Judged(wrong)
    scan = plain(sequence)
    return Judged(
        [name for name, keeps in RULES.items() if not keeps(scan, bounds)],
        scan.intensity_ppb,
        scan.time_ns,
        scan.period_us,
        len(scan.width_us),
        strong_pulses(scan, bounds),
        charge_through_pc(scan, bounds),
        slots_through_pc(scan, bounds),
        [each * scan.recharge_us for each in scan.recharge_ua or [0] * bounds.electrodes],
        sum(scan.width_us) + sum(scan.discharge_us) + scan.recharge_us,
        max(
            (
                abs(current) * width
                for row, width in zip(scan.current_ua, scan.width_us, strict=True)
                for current in row
            ),
            default=0,
        ),
    )


def _is_whole(value):
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def _is_real(value):
    return isinstance(value, int | float | np.floating) and not isinstance(value, bool)


def _is_share(value):
    """Return whether a number, read as a float, lies from 0 to 1."""
    try:
        return 0 <= float(value) <= 1
    except OverflowError:
        return False
