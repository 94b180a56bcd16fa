"""Rules of the ``link`` board for one sequence, in whole numbers and in the order of the page, with
the limits of a session, those of the firmware, and loads."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.link.protocol import LIMITS, NAK, NOTHING, Output, Refusal, Rule
from smarttouch.emulator.link_packets import (
    MOST_AMPLITUDE,
    KernelStore,
    ReceivedSequence,
    rounded,
)

MAX_CURRENT_UA = 5000
MAX_TOTAL_UA = 10_000
MAX_WIDTH_US = 200
MAX_CHARGE_PC = 500_000
MIN_PERIOD_US = 5000
MAX_SLOTS = 4096
MIN_DISCHARGE_US = 20
MAX_DUTY_PERCENT = 80
MAX_MEAN_UA = 500
MAX_FELT_UA = 2500
MAX_PULSES_HZ = 1500
BURST_US = 40_000
MIN_RAMP_MS, MAX_RAMP_MS = 500, 10_000
MAX_SESSION_S, MAX_SESSION_UC = 3600, 1_800_000
MAX_RECHARGE_UA = 500
"""Limit of a recharge phase, a tenth of the strongest pulse, as the board has no thresholds."""
MAX_RECHARGE_US = 20_000
MAX_RECHARGE_PC = 2_000_000
FULL = 0xFFFF
STRENGTH = 4  # multiple of a pulse's share of a full one that its strength is at most


@dataclass(frozen=True, eq=False)
class SessionLimits:
    """Limits of a session: the host's, or the board's own where these are stricter."""

    period_us: int
    total_ua: int
    width_us: int
    full_ua: int
    rounding_ua: int
    full_us: int
    ramp_ms: int
    session_s: int
    session_uc: int
    duty_percent: int
    full_pc: int
    current_ua: NDArray[np.int64]
    felt_ua: NDArray[np.int64]
    charge_pc: NDArray[np.int64]

    @classmethod
    def of(cls, payload: bytes, electrodes: int, output: Output) -> "SessionLimits | None":
        """Return the limits in a payload; None if it is invalid."""
        if len(payload) != LIMITS.size + 8 * electrodes:
            return None
        (
            period, total, width, full, rounding, full_us, ramp, session_s, session_uc, duty,
            _, usual,
        ) = LIMITS.unpack_from(payload)  # fmt: skip
        current, felt = np.frombuffer(payload, "<u2", 2 * electrodes, LIMITS.size).reshape(2, -1)
        charge = np.frombuffer(payload, "<u4", electrodes, LIMITS.size + 4 * electrodes)
        most = MAX_TOTAL_UA if output == "weighted" else MAX_CURRENT_UA
        return cls(
            max(period, MIN_PERIOD_US), min(total, most), min(width, MAX_WIDTH_US),
            min(full, MAX_CURRENT_UA), min(rounding, -(-electrodes // 2) + 1),
            min(full_us, MAX_WIDTH_US), max(ramp or MAX_RAMP_MS, MIN_RAMP_MS),
            min(session_s, MAX_SESSION_S), min(session_uc, MAX_SESSION_UC),
            min(duty, MAX_DUTY_PERCENT), min(full, MAX_CURRENT_UA) * min(usual, MAX_WIDTH_US),
            np.minimum(current.astype(np.int64), MAX_CURRENT_UA),
            np.minimum(felt.astype(np.int64), MAX_FELT_UA),
            np.minimum(charge.astype(np.int64), MAX_CHARGE_PC),
        )  # fmt: skip

    def strength(self, intensity: int, peak_pc: int) -> int:
        """Return what an intensity amounts to with pulses of such a charge, of `FULL`."""
        share = -(-peak_pc * FULL // self.full_pc) if self.full_pc else FULL * (peak_pc > 0)
        return min(FULL, max(share, min(intensity, STRENGTH * share)))


@dataclass(frozen=True, eq=False)
class Load:
    """What one pass of a sequence, or several, bring to each electrode, (E,) int64."""

    felt: NDArray[np.int64]  # pulses that count as felt
    # charge_pc, net_pc: of either sign, and signed, positive cathodic; with the recharge phase
    charge_pc: NDArray[np.int64]
    net_pc: NDArray[np.int64]
    peak_ua: int = 0  # strongest current, and largest charge of one pulse; 0 if no current flows
    peak_pc: int = 0
    # busy_us, pulses_us: time of its slots and recharge phase, and of their current
    busy_us: int = 0
    pulses_us: int = 0

    @classmethod
    def none(cls, electrodes: int) -> "Load":
        return cls(*np.zeros((3, electrodes), np.int64))

    def __add__(self, other: "Load") -> "Load":
        """Return the load of both one after the other."""
        return Load(
            self.felt + other.felt, self.charge_pc + other.charge_pc, self.net_pc + other.net_pc,
            max(self.peak_ua, other.peak_ua), max(self.peak_pc, other.peak_pc),
            self.busy_us + other.busy_us, self.pulses_us + other.pulses_us,
        )  # fmt: skip


class BrokenRule(NamedTuple):
    """First rule that a sequence breaks."""

    rule: Rule
    slot: int = NOTHING
    electrode: int = NOTHING
    value: int = 0
    allowed: int = 0

    def nak(self, reason: Refusal = Refusal.UNSAFE) -> bytes:
        """Return the payload of NAK."""
        value, allowed = (min(each, 0x7FFFFFFF) for each in self[3:])
        return NAK.pack(reason, *self[:3], value, allowed)


def first_above(
    rule: Rule,
    value: NDArray[np.int64] | int,
    allowed: NDArray[np.int64] | int,
    slot: int = NOTHING,
) -> BrokenRule | None:
    """Return a rule as broken if a value is above the allowed; of electrodes, (E,), at the first
    whose value is."""
    values, most = np.broadcast_arrays(np.atleast_1d(value), allowed)
    if not len(over := np.flatnonzero(values > most)):
        return None
    first = int(over[0])
    electrode = first if isinstance(value, np.ndarray) else NOTHING
    return BrokenRule(rule, slot, electrode, int(values[first]), int(most[first]))


def complaint(
    sequence: ReceivedSequence,
    limits: SessionLimits,
    keep: KernelStore,
    output: Output,
    carried_pc: NDArray[np.int64],
    before: Load,
    most_slots: int,
) -> tuple[BrokenRule | None, Load]:
    """Fill in what kernels make; return the first rule that is broken, if any, and the load.

    ``carried_pc``, (E,) int64, is the net charge of the session so far, positive cathodic;
    ``before`` the load of the parts of the same scan before this one.
    """
    if sequence.slots > most_slots:
        return BrokenRule(Rule.SLOTS, value=sequence.slots, allowed=most_slots), before
    found = _times(sequence, limits, before)
    if found is None:
        found, signed_ua = _slots(sequence, limits, keep, output)
    if found is not None:
        return found, before
    load = _load_of(sequence, signed_ua, limits.felt_ua)
    if sequence.recharge_ua is not None:
        recharge_pc = sequence.recharge_ua * sequence.recharge_us
        if found := _recharged(sequence, limits, carried_pc + load.net_pc, recharge_pc, load):
            return found, load
        load += Load(0 * recharge_pc, np.abs(recharge_pc), recharge_pc)
    burst_us, scan = min(sequence.period_us, BURST_US), before + load
    found = (
        first_above(Rule.MEAN, scan.charge_pc, MAX_MEAN_UA * burst_us)
        or first_above(Rule.FELT, scan.felt, MAX_PULSES_HZ * burst_us // 10**6)
        or _intensity(sequence.intensity, limits, load)
    )
    return found, load


def _times(sequence: ReceivedSequence, limits: SessionLimits, before: Load) -> BrokenRule | None:
    period_us, width_us, rest_us = sequence.period_us, sequence.width_us, sequence.discharge_us
    if period_us < limits.period_us:
        return BrokenRule(Rule.PERIOD, value=period_us, allowed=limits.period_us)
    wide = (width_us < 1) | (width_us > limits.width_us)
    if (wrong := wide | (rest_us < MIN_DISCHARGE_US)).any():
        slot = int(wrong.argmax())
        if wide[slot]:
            value, allowed = int(width_us[slot]), limits.width_us
            return BrokenRule(Rule.WIDTH, slot, value=value, allowed=allowed)
        value, allowed = int(rest_us[slot]), MIN_DISCHARGE_US
        return BrokenRule(Rule.DISCHARGE, slot, value=value, allowed=allowed)
    busy_us, pulses_us = _time_of(sequence)
    pulses_us += before.pulses_us
    return first_above(Rule.FIT, before.busy_us + busy_us, period_us) or first_above(
        Rule.DUTY, pulses_us, limits.duty_percent * period_us // 100
    )


def _time_of(sequence: ReceivedSequence) -> tuple[int, int]:
    """Return the time of slots and recharge phase with the short after it, and of their current."""
    width_us, rest_us = int(sequence.width_us.sum()), int(sequence.discharge_us.sum())
    pulses_us = width_us + sequence.recharge_us
    return pulses_us + rest_us + MIN_DISCHARGE_US * (sequence.recharge_ua is not None), pulses_us


def _slots(
    sequence: ReceivedSequence, limits: SessionLimits, keep: KernelStore, output: Output
) -> tuple[BrokenRule | None, NDArray[np.int64]]:
    """Return the first broken rule of the first slot that breaks one, and the currents, (S, E) µA;
    of one source its shares, rounded away from 0."""
    kind, switched = sequence.kind, output != "weighted"
    missing, amplitude = _fill_in(sequence, keep)
    signed_ua, total_ua, odd = _divided(sequence, output) if switched else _weighted(sequence)
    each_ua = np.abs(signed_ua)
    # Of one source any electrode may be the last that still touches the skin.
    through_ua = np.where(each_ua > 0, total_ua[:, None], 0) if switched else each_ua
    charge_pc = through_ua * sequence.width_us[:, None]
    balance = Rule.STATES if switched else Rule.BALANCE
    broken = {
        Rule.KIND: (kind == 3) != switched,
        Rule.KERNEL: missing >= 0,
        Rule.SUM: amplitude > MOST_AMPLITUDE,
        balance: odd != 0,
        Rule.CURRENT: (each_ua > limits.current_ua).any(axis=1),
        Rule.TOTAL: total_ua > limits.total_ua,
        Rule.CHARGE: (charge_pc > limits.charge_pc).any(axis=1),
    }
    table = np.array([*broken.values()])
    if not table.any():
        return None, signed_ua
    slot = int(table.any(axis=0).argmax())
    rule = [*broken][int(table[:, slot].argmax())]
    if rule == Rule.CURRENT:
        return first_above(rule, each_ua[slot], limits.current_ua, slot), signed_ua
    if rule == Rule.CHARGE:
        return first_above(rule, charge_pc[slot], limits.charge_pc, slot), signed_ua
    value, allowed = {
        Rule.KIND: (kind, 0),
        Rule.KERNEL: (missing, keep.count),
        Rule.SUM: (amplitude, MOST_AMPLITUDE),
        balance: (odd * (not switched), 0),
        Rule.TOTAL: (total_ua, limits.total_ua),
    }[rule]
    return BrokenRule(rule, slot, value=int(value[slot]), allowed=allowed), signed_ua


def _fill_in(
    sequence: ReceivedSequence, keep: KernelStore
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Fill in what kernels make; return of each slot, (S,), the first kernel that is not kept, else
    -1, and the sum of amplitudes."""
    slot, kernel, amplitude = sequence.pairs.T
    missing, sums = np.full((2, sequence.slots), [[-1], [0]], np.int64)
    np.add.at(sums, slot, amplitude)
    unkept = np.flatnonzero(kernel >= keep.count)[::-1]
    missing[slot[unkept]] = kernel[unkept]
    if keep.weights is not None and len(slot):
        kernel = np.minimum(kernel, keep.count - 1)
        first = np.flatnonzero(np.diff(slot, prepend=-1))
        every = keep.weights[kernel] * amplitude[:, None]
        sequence.rows[slot[first]] = rounded(np.add.reduceat(every, first, axis=0))
        sequence.site[slot[first]] = keep.site[kernel[first]]
    return missing, sums


def _weighted(
    sequence: ReceivedSequence,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return currents, what flows in all, and what is not balanced."""
    signed_ua = sequence.rows
    return signed_ua, np.abs(signed_ua).sum(axis=1) // 2, signed_ua.sum(axis=1)


def _divided(
    sequence: ReceivedSequence, output: Output
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Return equal shares of the source, its currents, and which slots make no circuit."""
    state, source = sequence.rows, sequence.source_ua
    cathodes, anodes = ((state == pole).sum(axis=1) for pole in (1, -1))
    odd = (state == 2).any(axis=1) | (cathodes == 0) | (anodes == 0)
    if output == "one-against-all":
        odd |= (state == 0).any(axis=1) | (np.minimum(cathodes, anodes) != 1)
    shares = [-(-source // np.maximum(poles, 1))[:, None] for poles in (cathodes, anodes)]
    return np.where(state == 1, shares[0], -shares[1] * (state == -1)), source, odd


def _load_of(
    sequence: ReceivedSequence, signed_ua: NDArray[np.int64], felt_ua: NDArray[np.int64]
) -> Load:
    each, width_us = np.abs(signed_ua), sequence.width_us
    strongest_ua = each.max(axis=1, initial=0)
    return Load(
        ((each >= felt_ua) & (each > 0)).sum(axis=0), width_us @ each, width_us @ signed_ua,
        int(strongest_ua.max(initial=0)), int((strongest_ua * width_us).max(initial=0)),
        *_time_of(sequence),
    )  # fmt: skip


def _recharged(
    sequence: ReceivedSequence,
    limits: SessionLimits,
    carried_pc: NDArray[np.int64],
    phase_pc: NDArray[np.int64],
    load: Load,
) -> BrokenRule | None:
    """Return the first broken rule of a recharge phase that brings a charge, after slots of a load
    with which so much is carried."""
    width_us, signed = sequence.recharge_us, sequence.recharge_ua
    assert signed is not None
    if not sequence.slots or not 0 < width_us <= MAX_RECHARGE_US:
        return BrokenRule(Rule.RECHARGE, value=width_us, allowed=MAX_RECHARGE_US)
    if net := int(signed.sum()):
        return BrokenRule(Rule.BALANCE, value=net)
    each = np.abs(signed)
    allowed = np.minimum(min(MAX_RECHARGE_UA, MAX_RECHARGE_PC // width_us), limits.current_ua)
    found = first_above(Rule.CURRENT, each, allowed) or first_above(
        Rule.TOTAL, int(each.sum()) // 2, limits.total_ua
    )
    for passes in (0, sequence.times - 1):
        before_pc = carried_pc + passes * (load.net_pc + phase_pc)
        most_pc = np.maximum(np.abs(before_pc), MAX_RECHARGE_PC)
        found = found or first_above(Rule.RECHARGE, np.abs(before_pc + phase_pc), most_pc)
    return found


def _intensity(intensity: int, limits: SessionLimits, load: Load) -> BrokenRule | None:
    allowed_ua = limits.full_ua * intensity // FULL + limits.rounding_ua
    if limits.full_us:
        allowed_ua = limits.full_ua + limits.rounding_ua
        allowed_pc = allowed_ua * limits.full_us * 1001 * intensity // (1000 * FULL)
        if found := first_above(Rule.INTENSITY, load.peak_pc, allowed_pc):
            return found
    return first_above(Rule.INTENSITY, load.peak_ua, allowed_ua)
