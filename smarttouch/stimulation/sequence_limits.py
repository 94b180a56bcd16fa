"""Limits of a single scan sequence, checked in whole numbers on its frozen copy."""

import math
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import SafetyError
from smarttouch.profile.ceilings import (
    BURST_S,
    CEILING_MEAN_MA,
    CEILING_NET_MA,
    CEILING_PULSES_HZ,
    LEAST_DISCHARGE_US,
)
from smarttouch.stimulation.ramp import PPB
from smarttouch.stimulation.safety_limits import SafetyLimits, decimal, parts_per_billion
from smarttouch.stimulation.scan_sequence import ScanSequence

LONGEST_PERIOD_US = 60_000_000
LARGEST_TIME_NS = 2**62
MOST_RECHARGE_US = 20_000  # one period of the usual 50 scans a second. Ours
MOST_RECHARGE_PC = 2_000_000  # of one electrode: four of the strongest pulses. Ours
BURST_US = round(1e6 * BURST_S)
PER_PULSE = 1_000_000
PER_PC = round(1000 * CEILING_PULSES_HZ / (1e6 * CEILING_MEAN_MA))
"""Weights that give felt pulses and charge one limit, in whole numbers: 3 of it for 1 pC, a
million for a pulse, and `MOST_PER_US` of either for each microsecond."""
MOST_PER_US = round(CEILING_PULSES_HZ)
NET_PC = round(1e9 * CEILING_NET_MA)  # largest net charge of an electrode in a second
PLANNED = 0.9
"""Part of the limit used by schedules, so that jittered steps keep the window of a second."""
_WIDTH_LEEWAY = Fraction(1001, 1000)
"""Tolerance of pulse widths: whole microseconds, rounded down in single precision."""

Sums = NDArray[np.float64]
"""Felt pulses × `PER_PULSE`, charge in pC × `PER_PC`, and charge with its sign, positive cathodic,
pC, of each electrode, (3, E): whole numbers, all far below 2^53, where doubles are exact."""


class SlotSums(NamedTuple):
    """Exact sums over the currents of S slots."""

    net_ua: NDArray[np.float64]  # (S,) zero where a slot is in balance
    total_ua: NDArray[np.float64]  # (S,) sum of magnitudes
    highest_ua: NDArray[np.float64]  # (E,) largest magnitude of each electrode
    sums: Sums


def add_up(
    current_ua: NDArray[np.int16], width_us: NDArray[np.uint16], felt_ua: NDArray[np.float32]
) -> SlotSums:
    """Return the sums of slots, currents (S, E) and widths (S,), S > 0; pulses are felt from
    ``felt_ua``, (E,), on."""
    currents, widths = current_ua.astype(np.float64), width_us.astype(np.float64)
    magnitudes = np.abs(currents)
    felt = PER_PULSE * np.count_nonzero(magnitudes >= felt_ua, axis=0)
    sums = np.stack([felt, PER_PC * (widths @ magnitudes), widths @ currents])
    return SlotSums(currents.sum(axis=1), magnitudes.sum(axis=1), magnitudes.max(axis=0), sums)


class PassLoad(NamedTuple):
    """Load of one pass of a sequence on each electrode."""

    sums: Sums  # with its recharge phase
    recharge_pc: NDArray[np.float64] | None  # (E,), of its recharge phase, positive cathodic
    busy_us: int  # time of its slots and its recharge phase
    peak_pc: int  # largest charge of one pulse of its slots; 0 if none has current


_SENTENCES = {
    "electrodes": "currents are of {value} electrodes, must be of {allowed}",
    "intensity": "intensity {value} must lie between 0 and {allowed}",
    "time_ns": "time {value} ns must be from 0 to below {allowed}",
    "vibration": "vibration is of {value} electrodes, must be of {allowed}",
    "vibrates": "vibration of {value:g} is not between 0 and the intensity {allowed:.3f} that was "
    "stated",
    "rate_hz": "a period of {value} µs is not from {allowed} µs, by the rate, to a minute",
    "period_us": "slots and recharge phase take {value} µs, longer than the period of {allowed} "
    "µs: lower the rate",
    "duty": "current flows {value:.0%} of the time, above the limit of {allowed:.0%}: lower the "
    "rate",
    "pulse_us": "a pulse width of {value} µs must be above 0 and at most {allowed:g} µs",
    "discharge_us": "slot {slot}: a discharge of {value} µs is below {allowed} µs, and its charge "
    "would add to that of the next pulse",
    "site": "site {value} is not an electrode: the last one is {allowed}",
    "balance": "slot {slot} is out of balance by {value} µA: currents must sum to {allowed}",
    "current_ma": "slot {slot}, electrode {electrode}: {value:.3f} mA is above the limit of "
    "{allowed:g} mA",
    "charge_uc": "slot {slot}, electrode {electrode}: {value:.3f} µC is above the limit of "
    "{allowed:g} µC",
    "total_ma": "slot {slot}: {value:.3f} mA flow in all, above the limit of {allowed:g} mA",
    "source": "slot {slot}: {value:.3f} µC from one source are above the {allowed:g} µC of a "
    "single electrode: lower the current or the pulse width",
    "claimed_ma": "{value:.3f} mA is more than the intensity allows, {allowed:.3f} mA",
    "claimed_uc": "{value:.3f} µC is more than the intensity allows, {allowed:.3f} µC",
    "recharge": "a recharge phase needs slots whose charge it brings back, the currents of "
    "{allowed} electrodes and a width: leave it out",
    "recharge_us": "the recharge phase takes {value} µs, must be from 1 to {allowed}",
    "recharge_balance": "the recharge phase is out of balance by {value} µA: currents must sum to "
    "{allowed}",
    "recharge_ua": "the recharge phase has {value} µA at electrode {electrode}: at most {allowed} "
    "µA are allowed for its width",
    "recharge_ma": "the recharge phase has {value:.3f} mA in all, above the limit of {allowed:g} "
    "mA",
    "takes_back": "electrode {electrode}: the recharge phase passes {value:g} µC, and may take "
    "back {allowed:g} µC and nothing else",
    "passes": "{value} sequences within a second or waiting are above the {allowed} that the rate "
    "allows: send less often",
    "pulses_hz": "electrode {electrode}: {value:g} felt pulses are above the {allowed:g} of this "
    "time: lower the rate",
    "mean_ma": "electrode {electrode}: {value:g} µC are above the {allowed:g} µC of this time: "
    "lower the rate",
    "net_ma": "electrode {electrode}: {value:g} µC of one sign would be left within a second, more "
    "than {allowed:g}: lower the rate, or recharge",
    "session_s": "the session would have {value:.0f} s of current, limits.session_s is "
    "{allowed:g}: take the finger off, look at the skin, and continue later",
    "session_mc": "electrode {electrode}: the session would pass {value:.0f} mC, limits.session_mc "
    "is {allowed:g}: take the finger off, look at the skin, and continue later",
}
_LIMITS = {
    "vibrates": "vibration", "source": "charge_uc", "claimed_ma": "intensity",
    "claimed_uc": "intensity", "recharge": "recharge_ua", "recharge_balance": "balance",
    "recharge_ma": "total_ma", "takes_back": "recharge_ua", "passes": "rate_hz",
}  # fmt: skip
"""Limits of sentences that have another name."""


def refusal(
    sentence: str,
    value: float,
    allowed: float,
    slot: int | None = None,
    electrode: int | None = None,
) -> SafetyError:
    """Return the error of a broken limit, by the name of its sentence."""
    words = _SENTENCES[sentence].format(
        value=value, allowed=allowed, slot=slot, electrode=electrode
    )
    return SafetyError(
        words, limit=_LIMITS.get(sentence, sentence), value=value, allowed=allowed,
        slot=slot, electrode=electrode,
    )  # fmt: skip


def prove_sequence(sequence: ScanSequence, limits: SafetyLimits) -> PassLoad:
    """Return the load of a frozen sequence on each electrode; raise a SafetyError that names the
    limit, slot and electrode, and by how much."""
    _prove_fields(sequence, limits)
    longest_us, pulses_us, busy_us = _prove_times(sequence, limits)
    if not busy_us:
        return PassLoad(np.zeros((3, limits.electrodes)), None, 0, peak_pc=0)
    current_ua, width_us = sequence.current_ua, sequence.width_us
    net_ua, total_ua, highest_ua, sums = add_up(current_ua, width_us, limits.felt_ua)
    if net_ua.any():
        slot = int(np.abs(net_ua).argmax())
        raise refusal("balance", int(net_ua[slot]), 0, slot)
    if (highest_ua > limits.current_ua).any():
        _prove_each("current_ma", np.abs(current_ua.astype(np.float64)), limits.current_ua, 1000)
    # In balance: what flows in is half of all that flows.
    if total_ua.max() > 2 * limits.total_ua:
        slot = int(total_ua.argmax())
        raise refusal("total_ma", total_ua[slot] / 2000, limits.total_ma, slot)
    highest_pc = int(highest_ua.max()) * longest_us
    if (highest_ua * longest_us > limits.charge_pc).any() or pulses_us < len(width_us) * longest_us:
        charge_pc = np.abs(current_ua.astype(np.float64)) * width_us.astype(np.float64)[:, None]
        _prove_each("charge_uc", charge_pc, limits.charge_pc, 1_000_000)
        highest_pc = int(charge_pc.max())
    if limits.one_source:
        # One electrode alone may have to carry each slot's charge.
        source_pc = total_ua / 2 * width_us
        if source_pc.max() > float(decimal(limits.charge_uc) * 10**6):
            slot = int(source_pc.argmax())
            raise refusal("source", source_pc[slot] / 1e6, limits.charge_uc, slot)
    _prove_intensity(
        limits, parts_per_billion(sequence.intensity), int(highest_ua.max()), highest_pc
    )
    recharge_pc = None
    if sequence.recharge_ua is not None:
        recharge_pc = sequence.recharge_ua.astype(np.float64) * sequence.recharge_us
        sums[1] += PER_PC * np.abs(recharge_pc)
        sums[2] += recharge_pc
    return PassLoad(sums, recharge_pc, busy_us, highest_pc)


def _prove_fields(sequence: ScanSequence, limits: SafetyLimits) -> None:
    """Raise unless numbers are in their ranges and arrays have the right length."""
    electrodes, given = limits.electrodes, sequence.current_ua.shape[1]
    if given != electrodes:
        raise refusal("electrodes", given, electrodes)
    if not 0 <= sequence.intensity <= 1:
        raise refusal("intensity", sequence.intensity, 1)
    if not 0 <= sequence.time_ns < LARGEST_TIME_NS:
        raise refusal("time_ns", sequence.time_ns, LARGEST_TIME_NS)
    if len(sequence.site) and (site := int(np.maximum.reduce(sequence.site))) >= electrodes:
        raise refusal("site", site, electrodes - 1)
    if sequence.recharge_ua is not None or sequence.recharge_us:
        _prove_recharge(sequence, limits)
    if (vibration := sequence.vibration) is None:
        return
    if vibration.shape != (electrodes,):
        raise refusal("vibration", len(vibration), electrodes)
    # In double precision, as the intensity is. Every comparison with NaN is false.
    wide = vibration.astype(np.float64)
    if not ((wide >= 0) & (wide <= sequence.intensity + 1e-6)).all():
        worst = wide[np.abs(wide - sequence.intensity / 2).argmax()]
        raise refusal("vibrates", worst, sequence.intensity)


def _prove_recharge(sequence: ScanSequence, limits: SafetyLimits) -> None:
    """Raise if the recharge phase breaks a limit; `Exposure` checks that it returns charge."""
    current_ua, width_us, most_ua = sequence.recharge_ua, sequence.recharge_us, limits.faint_ua
    if current_ua is None or current_ua.shape != most_ua.shape or not sequence.slots:
        raise refusal("recharge", np.nan, limits.electrodes)
    if not 1 <= width_us <= MOST_RECHARGE_US:
        raise refusal("recharge_us", width_us, MOST_RECHARGE_US)
    wide_ua = current_ua.astype(np.int64)
    if left_ua := int(wide_ua.sum()):
        raise refusal("recharge_balance", left_ua, 0)
    strongest_ua = np.abs(wide_ua)
    allowed_ua = np.minimum(most_ua, MOST_RECHARGE_PC // width_us)
    if (strongest_ua > allowed_ua).any():
        at = int((strongest_ua - allowed_ua).argmax())
        raise refusal("recharge_ua", strongest_ua[at], allowed_ua[at], electrode=at)
    if (all_ua := int(strongest_ua.sum()) // 2) > limits.total_ua:
        raise refusal("recharge_ma", all_ua / 1000, limits.total_ua / 1000)


def _prove_times(sequence: ScanSequence, limits: SafetyLimits) -> tuple[int, int, int]:
    """Return the longest and the total pulse width, and the time of slots and recharge phase, µs.

    Raise if a time breaks its limits.
    """
    period_us, recharge_us = sequence.period_us, sequence.recharge_us
    if not limits.period_us <= period_us <= LONGEST_PERIOD_US:
        raise refusal("rate_hz", period_us, limits.period_us)
    widths_us, rests_us = sequence.width_us.tolist(), sequence.discharge_us.tolist()
    if not widths_us:
        return 0, 0, 0
    longest_us, pulses_us = max(widths_us), sum(widths_us)
    busy_us = pulses_us + sum(rests_us) + recharge_us
    needed_us = busy_us + LEAST_DISCHARGE_US * (recharge_us > 0)
    if needed_us > period_us:
        raise refusal("period_us", needed_us, period_us)
    part, whole = limits.duty_ratio
    flowing_us = pulses_us + recharge_us
    if flowing_us * whole > part * period_us:
        raise refusal("duty", flowing_us / period_us, limits.duty)
    if longest_us > limits.pulse_whole_us or 0 in widths_us:
        raise refusal("pulse_us", 0 if 0 in widths_us else longest_us, limits.pulse_us)
    if (least_us := min(rests_us)) < LEAST_DISCHARGE_US:
        raise refusal("discharge_us", least_us, LEAST_DISCHARGE_US, rests_us.index(least_us))
    return longest_us, pulses_us, busy_us


def _prove_each(
    limit: str, values: NDArray[np.float64], allowed: NDArray[np.float64], unit: int
) -> None:
    """Raise if a value (S, E) is above what its electrode allows, (E,)."""
    if (values > allowed).any():
        slot, at = divmod(int((values - allowed).argmax()), values.shape[1])
        raise refusal(limit, values[slot, at] / unit, allowed[at] / unit, slot, at)


def _prove_intensity(limits: SafetyLimits, ppb: int, peak_ua: int, charge_pc: int) -> None:
    """Raise unless current, or charge where width carries intensity, is proportional to it."""
    if limits.full_us is not None:
        full = limits.full_ua + limits.rounding_ua
        most_pc = full * round(limits.full_us) * _WIDTH_LEEWAY * ppb / PPB
        if charge_pc > most_pc:
            raise refusal("claimed_uc", charge_pc / 1e6, float(most_pc) / 1e6)
        ppb = PPB
    highest_ua = math.floor(limits.full_ua * ppb / PPB + limits.rounding_ua)
    if peak_ua > highest_ua:
        raise refusal("claimed_ma", peak_ua / 1000, highest_ua / 1000)
