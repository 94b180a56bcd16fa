"""Limits of a single scan sequence, checked in whole numbers on its frozen copy."""

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import SafetyError
from smarttouch.profile.ceilings import LEAST_DISCHARGE_US
from smarttouch.stimulation.ramp import PPB
from smarttouch.stimulation.recharge import prove_recharge
from smarttouch.stimulation.safety_limits import SafetyLimits, decimal
from smarttouch.stimulation.scan_sequence import ScanSequence
from smarttouch.stimulation.slot_sums import PER_PC, Load, PassLoad, SlotAdder, extent_us

LONGEST_PERIOD_US = 60_000_000
LARGEST_TIME_NS = 2**62
_WIDTH_LEEWAY = Fraction(1001, 1000)
"""Tolerance of pulse widths: whole microseconds, rounded down in single precision."""


def prove_fields(sequence: ScanSequence, limits: SafetyLimits) -> None:
    """Raise unless numbers are in their ranges and arrays have the right length."""
    electrodes, given = limits.electrodes, sequence.current_ua.shape[1]
    if given != electrodes:
        raise SafetyError(
            f"currents are of {given} electrodes, must be of {electrodes}",
            limit="electrodes",
            value=given,
            allowed=electrodes,
        )
    if not 0 <= sequence.intensity <= 1:
        raise SafetyError(
            f"intensity {sequence.intensity} must lie between 0 and 1",
            limit="intensity",
            value=sequence.intensity,
            allowed=1,
        )
    if not 0 <= sequence.time_ns < LARGEST_TIME_NS:
        raise SafetyError(
            f"time {sequence.time_ns} ns must be from 0 to below 2^62",
            limit="time_ns",
            value=sequence.time_ns,
            allowed=LARGEST_TIME_NS,
        )
    vibration = sequence.vibration
    if vibration is None:
        return
    if vibration.shape != (electrodes,):
        raise SafetyError(
            f"vibration is of {len(vibration)} electrodes, must be of {electrodes}",
            limit="vibration",
            value=len(vibration),
            allowed=electrodes,
        )
    # Not "any above": nothing is above NaN. In double precision, as the intensity is.
    wide = vibration.astype(np.float64)
    if not ((wide >= 0) & (wide <= sequence.intensity + 1e-6)).all():
        raise SafetyError(
            f"vibration from {vibration.min():g} to {vibration.max():g} is not between 0 and "
            f"the intensity {sequence.intensity:.3f} that was stated",
            limit="vibration",
            value=float(vibration.max()),
            allowed=sequence.intensity,
        )


def prove_slots(
    sequence: ScanSequence, limits: SafetyLimits, ppb: int, adder: SlotAdder
) -> PassLoad:
    """Return the load of a sequence on each electrode, or raise if a limit is broken.

    Parameters
    ----------
    sequence : ScanSequence
        Frozen.
    limits : SafetyLimits
    ppb : int
        Its intensity, parts per billion.
    adder : SlotAdder
        Of the limits' `felt_ua`.

    Raises
    ------
    SafetyError
        Naming the limit, the slot and electrode, and by how much.
    """
    slots = len(sequence.width_us)
    if sequence.recharge_ua is not None or sequence.recharge_us:
        prove_recharge(sequence, limits.faint_ua, limits.total_ua)
    longest_us, pulses_us, busy_us = _prove_times(sequence, limits)
    if not slots:
        return PassLoad(np.zeros((3, limits.electrodes)), None, 0, peak_pc=0)
    net_ua, total_ua, highest_ua, sums = adder.add_up(sequence.current_ua, sequence.width_us)
    # Whole numbers: their squares add up to zero only where all of them are.
    if net_ua.dot(net_ua):
        slot = int(np.abs(net_ua).argmax())
        raise SafetyError(
            f"slot {slot} is out of balance by {int(net_ua[slot])} µA: currents must sum to zero",
            limit="balance",
            value=int(net_ua[slot]),
            allowed=0,
            slot=slot,
        )
    if highest_ua > limits.least_current_ua or (
        limits.masked and sequence.current_ua[:, limits.masked].any()
    ):
        magnitude = _magnitude(sequence)
        if (magnitude > limits.current_ua).any():
            raise _above("current_ma", magnitude, limits.current_ua, 1000, "mA")
    # In balance: what flows in is half of all that flows.
    if np.maximum.reduce(total_ua) > 2 * limits.total_ua:
        slot = int(total_ua.argmax())
        raise SafetyError(
            f"slot {slot}: {total_ua[slot] / 2000:.3f} mA flow in all, above the limit of "
            f"{limits.total_ma:g} mA",
            limit="total_ma",
            value=total_ua[slot] / 2000,
            allowed=limits.total_ma,
            slot=slot,
        )
    highest_pc = highest_ua * longest_us
    if highest_pc > limits.least_charge_pc or pulses_us != slots * longest_us:
        charge_pc = _magnitude(sequence) * sequence.width_us[:, None]
        if (charge_pc > limits.charge_pc).any():
            raise _above("charge_uc", charge_pc, limits.charge_pc, 1_000_000, "µC")
        highest_pc = int(charge_pc.max())
    if limits.one_source:
        _prove_one_source(limits, total_ua, sequence.width_us)
    _prove_intensity(limits, ppb, highest_ua, highest_pc)
    recharge_pc = None
    if sequence.recharge_ua is not None:
        recharge_pc = sequence.recharge_ua.astype(np.float64) * sequence.recharge_us
        sums[1] += PER_PC * np.abs(recharge_pc)
        sums[2] += recharge_pc
    return PassLoad(sums, recharge_pc, busy_us, highest_pc)


def _prove_one_source(
    limits: SafetyLimits, total_ua: NDArray[np.floating], width_us: NDArray[np.uint16]
) -> None:
    """Raise unless one electrode alone may carry each slot's charge."""
    charge_pc = total_ua.astype(np.float64) / 2 * width_us
    most_pc = float(decimal(limits.charge_uc) * 10**6)
    if charge_pc.max() > most_pc:
        slot = int(charge_pc.argmax())
        raise SafetyError(
            f"slot {slot}: {charge_pc[slot] / 1e6:.3f} µC from one source are above the "
            f"{limits.charge_uc:g} µC of a single electrode: lower the current or the pulse width",
            limit="charge_uc",
            value=charge_pc[slot] / 1e6,
            allowed=limits.charge_uc,
            slot=slot,
        )


def _prove_times(sequence: ScanSequence, limits: SafetyLimits) -> tuple[int, int, int]:
    """Return the longest and the total pulse width, and the time of slots and recharge phase, µs.

    Raise if a time breaks its limits.
    """
    period_us, slots = sequence.period_us, len(sequence.width_us)
    if not limits.period_us <= period_us <= LONGEST_PERIOD_US:
        raise SafetyError(
            f"a period of {period_us} µs is not from {limits.period_us} µs, for the limit of "
            f"{limits.rate_hz:g} Hz, to a minute",
            limit="rate_hz",
            value=period_us,
            allowed=limits.period_us,
        )
    if not slots:
        return 0, 0, 0
    shortest_us, longest_us, pulses_us = extent_us(sequence.width_us.tobytes())
    least_us, _, rests_us = extent_us(sequence.discharge_us.tobytes())
    if pulses_us + rests_us > period_us:
        raise SafetyError(
            f"{slots} slots take {pulses_us + rests_us} µs, longer than the period of "
            f"{period_us} µs: lower the rate",
            limit="period_us",
            value=pulses_us + rests_us,
            allowed=period_us,
        )
    part, whole = limits.duty_ratio
    flowing_us = pulses_us + sequence.recharge_us
    if flowing_us * whole > part * period_us:
        raise SafetyError(
            f"current flows {flowing_us / period_us:.0%} of the time, above the limit of "
            f"{limits.duty:.0%}: lower the rate",
            limit="duty",
            value=flowing_us / period_us,
            allowed=limits.duty,
        )
    if longest_us > limits.pulse_whole_us or shortest_us == 0:
        raise SafetyError(
            f"pulse widths run from {shortest_us} to {longest_us} µs: they must be above 0 "
            f"and at most {limits.pulse_us:g} µs",
            limit="pulse_us",
            value=longest_us,
            allowed=limits.pulse_us,
        )
    if least_us < LEAST_DISCHARGE_US:
        slot = int(sequence.discharge_us.argmin())
        raise SafetyError(
            f"slot {slot}: a discharge of {least_us} µs is below {LEAST_DISCHARGE_US} µs, and its "
            "charge would add to that of the next pulse",
            limit="discharge_us",
            value=least_us,
            allowed=LEAST_DISCHARGE_US,
            slot=slot,
        )
    if (site := int(np.maximum.reduce(sequence.site))) >= limits.electrodes:
        raise SafetyError(
            f"site {site} is none of {limits.electrodes} electrodes",
            limit="site",
            value=site,
            allowed=limits.electrodes - 1,
        )
    return longest_us, pulses_us, pulses_us + rests_us + sequence.recharge_us


def _magnitude(sequence: ScanSequence) -> NDArray[np.float64]:
    """Return all magnitudes, (S, E) µA, for checks that sums do not cover."""
    return np.abs(sequence.current_ua.astype(np.float64))


def _above(
    limit: str, each: Load, allowed: NDArray[np.float64], unit: int, symbol: str
) -> SafetyError:
    slot, electrode = divmod(int((each - allowed).argmax()), each.shape[1])
    value, most = each[slot, electrode] / unit, allowed[electrode] / unit
    return SafetyError(
        f"slot {slot}, electrode {electrode}: {value:.3f} {symbol} is above the limit of "
        f"{most:g} {symbol}",
        limit=limit,
        value=value,
        allowed=most,
        slot=slot,
        electrode=electrode,
    )


def _prove_intensity(limits: SafetyLimits, ppb: int, peak_ua: int, charge_pc: int) -> None:
    """Raise unless current, or charge where width carries intensity, is proportional to it."""
    per_ppb, rounding, whole = limits.most_ua_line
    highest = (per_ppb * (ppb if limits.full_us is None else PPB) + rounding) // whole
    if limits.full_us is not None:
        full = limits.full_ua + limits.rounding_ua
        most_pc = full * round(limits.full_us) * _WIDTH_LEEWAY * ppb / PPB
        if charge_pc > most_pc:
            raise SafetyError(
                f"{charge_pc / 1e6:.3f} µC is more than intensity {ppb / PPB:.3f} allows, "
                f"{float(most_pc) / 1e6:.3f} µC",
                limit="intensity",
                value=charge_pc / 1e6,
                allowed=float(most_pc) / 1e6,
            )
    if peak_ua > highest:
        raise SafetyError(
            f"{peak_ua / 1000:.3f} mA is more than intensity {ppb / PPB:.3f} allows, "
            f"{highest / 1000:.3f} mA",
            limit="intensity",
            value=peak_ua / 1000,
            allowed=highest / 1000,
        )
