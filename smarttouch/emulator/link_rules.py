"""Rules of the ``link`` board for one sequence, in whole numbers and in the order of the page, with
the limits of a session, those of the firmware, and loads."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.link.protocol import LIMITS, NOTHING, Output, Rule
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
_BLOCK = 1 << 13
"""Currents judged at a time, which stay in a processor's own cache."""


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
    session_us: int
    session_pc: int
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
        at = LIMITS.size
        current = np.frombuffer(payload, "<u2", electrodes, at).astype(np.int64)
        felt = np.frombuffer(payload, "<u2", electrodes, at + 2 * electrodes).astype(np.int64)
        charge = np.frombuffer(payload, "<u4", electrodes, at + 4 * electrodes).astype(np.int64)
        most = MAX_TOTAL_UA if output == "weighted" else MAX_CURRENT_UA
        return cls(
            max(period, MIN_PERIOD_US), min(total, most), min(width, MAX_WIDTH_US),
            min(full, MAX_CURRENT_UA), min(rounding, -(-electrodes // 2) + 1),
            min(full_us, MAX_WIDTH_US), max(ramp or MAX_RAMP_MS, MIN_RAMP_MS),
            10**6 * min(session_s, MAX_SESSION_S), 10**6 * min(session_uc, MAX_SESSION_UC),
            min(duty, MAX_DUTY_PERCENT), min(full, MAX_CURRENT_UA) * min(usual, MAX_WIDTH_US),
            np.minimum(current, MAX_CURRENT_UA),
            np.minimum(felt, MAX_FELT_UA), np.minimum(charge, MAX_CHARGE_PC),
        )  # fmt: skip

    def strength(self, intensity: int, peak_pc: int) -> int:
        """Return what an intensity amounts to with pulses of such a charge, of `FULL`."""
        share = -(-peak_pc * FULL // self.full_pc) if self.full_pc else FULL * (peak_pc > 0)
        return min(FULL, max(share, min(intensity, STRENGTH * share)))


@dataclass(eq=False)
class Load:
    """What one pass of a sequence brings to each electrode, (E,) int64."""

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

    def plus(self, other: "Load") -> "Load":
        """Return the load of both one after the other."""
        return Load(
            self.felt + other.felt, self.charge_pc + other.charge_pc, self.net_pc + other.net_pc,
            max(self.peak_ua, other.peak_ua), max(self.peak_pc, other.peak_pc),
            self.busy_us + other.busy_us, self.pulses_us + other.pulses_us,
        )  # fmt: skip

    def add(
        self, signed_ua: NDArray[np.int64], width_us: NDArray[np.int64], felt_ua: NDArray[np.int64]
    ) -> None:
        """Add slots: currents (S, E) µA and widths (S,) µs."""
        each = np.abs(signed_ua)
        self.felt += ((each >= felt_ua) & (each > 0)).sum(axis=0)
        self.charge_pc += width_us @ each
        self.net_pc += width_us @ signed_ua
        strongest_ua = each.max(axis=1, initial=0)
        self.peak_ua = max(self.peak_ua, int(strongest_ua.max(initial=0)))
        self.peak_pc = max(self.peak_pc, int((strongest_ua * width_us).max(initial=0)))


class BrokenRule(NamedTuple):
    """First rule that a sequence breaks."""

    rule: Rule
    slot: int = NOTHING
    electrode: int = NOTHING
    value: int = 0
    allowed: int = 0


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
    load = Load.none(sequence.electrodes)
    if sequence.slots > most_slots:
        return BrokenRule(Rule.SLOTS, value=sequence.slots, allowed=most_slots), load
    found = (
        _times(sequence, limits, load, before)
        or _slots(sequence, limits, keep, output, load)
        or _whole(sequence, limits, load, carried_pc, before)
    )
    return found, load


def _times(
    sequence: ReceivedSequence, limits: SessionLimits, load: Load, before: Load
) -> BrokenRule | None:
    """Return the first broken rule about times; enter them into the load."""
    period_us = sequence.period_us
    if period_us < limits.period_us:
        return BrokenRule(Rule.PERIOD, value=_i32(period_us), allowed=_i32(limits.period_us))
    width = sequence.width_us.astype(np.int64)
    discharge = sequence.discharge_us.astype(np.int64)
    for slot in range(sequence.slots):
        if not 0 < width[slot] <= limits.width_us:
            return BrokenRule(Rule.WIDTH, slot, value=int(width[slot]), allowed=limits.width_us)
        if discharge[slot] < MIN_DISCHARGE_US:
            rest_us = int(discharge[slot])
            return BrokenRule(Rule.DISCHARGE, slot, value=rest_us, allowed=MIN_DISCHARGE_US)
    load.busy_us = int((width + discharge).sum())
    if sequence.recharge_ua is not None:
        load.busy_us += sequence.recharge_us + MIN_DISCHARGE_US
    busy_us = before.busy_us + load.busy_us
    if busy_us > period_us:
        return BrokenRule(Rule.FIT, value=_i32(busy_us), allowed=_i32(period_us))
    load.pulses_us = int(width.sum()) + sequence.recharge_us
    pulses_us = before.pulses_us + load.pulses_us
    if 100 * pulses_us > limits.duty_percent * period_us:
        allowed = period_us * limits.duty_percent // 100
        return BrokenRule(Rule.DUTY, value=_i32(pulses_us), allowed=_i32(allowed))
    return None


def _slots(
    sequence: ReceivedSequence,
    limits: SessionLimits,
    keep: KernelStore,
    output: Output,
    load: Load,
) -> BrokenRule | None:
    """Return the first broken rule of a slot; fill in what kernels make, and enter the slots into
    the load."""
    kind, switched = sequence.kind, output != "weighted"
    other, unkept = (kind == 3) != switched, _filled_in(sequence, keep)
    width = sequence.width_us.astype(np.int64)
    for rows in _blocks(sequence.slots, sequence.electrodes):
        if switched:
            odd, signed, each_ua, total_ua = _switched(sequence, rows, output)
        else:
            assert sequence.current_ua is not None
            signed = sequence.current_ua[rows].astype(np.int64)
            each_ua = np.abs(signed)
            odd, total_ua = signed.sum(axis=1), each_ua.sum(axis=1) // 2
        # Of one source any electrode may be the last that still touches the skin.
        charge_pc = np.where(signed == 0, 0, total_ua[:, None]) if switched else each_ua
        charge_pc = charge_pc * width[rows, None]
        broken = other[rows] | unkept[rows] | (odd != 0) | (total_ua > limits.total_ua)
        broken |= (each_ua > limits.current_ua).any(axis=1)
        broken |= (charge_pc > limits.charge_pc).any(axis=1)
        if broken.any():
            row = int(broken.argmax())
            slot, total = rows.start + row, int(total_ua[row])
            if other[slot]:
                return BrokenRule(Rule.KIND, slot, value=int(kind[slot]))
            if unkept[slot]:
                return _unkept(sequence, keep, slot)
            if odd[row]:
                rule = Rule.STATES if switched else Rule.BALANCE
                return BrokenRule(rule, slot, value=0 if switched else int(odd[row]))
            found = first_above(Rule.CURRENT, slot, each_ua[row], limits.current_ua)
            if found is None and total > limits.total_ua:
                found = BrokenRule(Rule.TOTAL, slot, value=total, allowed=limits.total_ua)
            return found or first_above(Rule.CHARGE, slot, charge_pc[row], limits.charge_pc)
        load.add(signed, width[rows], limits.felt_ua)
    return None


def _blocks(rows: int, electrodes: int) -> Iterator[slice]:
    """Yield slices of as many rows as stay in the processor's cache."""
    step = max(1, _BLOCK // max(1, electrodes))
    return (slice(start, min(start + step, rows)) for start in range(0, rows, step))


def _filled_in(sequence: ReceivedSequence, keep: KernelStore) -> NDArray[np.bool_]:
    """Return the slots whose kernels are not kept or sum to too much, and fill in what the others
    make."""
    unkept, current_ua = np.zeros(sequence.slots, np.bool_), sequence.current_ua
    if not len(sequence.pairs) or current_ua is None:
        return unkept
    kernel, amplitude = sequence.kernel, sequence.amplitude
    end, places = np.cumsum(sequence.pairs), np.flatnonzero(sequence.kind < 2)
    first = end - sequence.pairs
    weights = np.zeros((0, current_ua.shape[1]), np.int16) if keep.weights is None else keep.weights
    unkept[places] = np.maximum.reduceat(kernel, first) >= len(weights)
    unkept[places] |= np.add.reduceat(amplitude, first) > MOST_AMPLITUDE
    if unkept.any():
        # Nothing of these is judged, and nothing after the first.
        kernel = np.where(kernel < len(weights), kernel, 0)
    if not len(weights):
        return unkept
    for rows in _blocks(len(places), current_ua.shape[1]):
        pairs = slice(first[rows.start], end[rows.stop - 1])
        every = weights[kernel[pairs]].astype(np.int64)
        every *= amplitude[pairs, None]
        current_ua[places[rows]] = rounded(
            np.add.reduceat(every, first[rows] - pairs.start, axis=0)
        )
    sequence.site[places] = keep.site[kernel[first]]
    return unkept


def _whole(
    sequence: ReceivedSequence,
    limits: SessionLimits,
    load: Load,
    carried_pc: NDArray[np.int64],
    before: Load,
) -> BrokenRule | None:
    """Return the first broken rule of those about the whole sequence, by itself."""
    if sequence.recharge_ua is not None:
        if found := _recharged(sequence, limits, load, carried_pc):
            return found
        recharge_pc = sequence.recharge_ua.astype(np.int64) * sequence.recharge_us
        load.charge_pc += np.abs(recharge_pc)
        load.net_pc += recharge_pc
    burst_us = min(sequence.period_us, BURST_US)
    charge_pc, felt = before.charge_pc + load.charge_pc, before.felt + load.felt
    if found := first_above(Rule.MEAN, NOTHING, charge_pc, MAX_MEAN_UA * burst_us):
        return found
    if found := first_above(Rule.FELT, NOTHING, felt, MAX_PULSES_HZ * burst_us // 10**6):
        return found
    strongest_ua = limits.full_ua + limits.rounding_ua
    if limits.full_us:
        allowed = strongest_ua * limits.full_us * 1001 * sequence.intensity // (1000 * FULL)
        if load.peak_pc > allowed:
            return BrokenRule(Rule.INTENSITY, value=load.peak_pc, allowed=_i32(allowed))
        allowed = strongest_ua
    else:
        allowed = limits.full_ua * sequence.intensity // FULL + limits.rounding_ua
    if load.peak_ua > allowed:
        return BrokenRule(Rule.INTENSITY, value=load.peak_ua, allowed=allowed)
    return None


def _unkept(sequence: ReceivedSequence, keep: KernelStore, slot: int) -> BrokenRule:
    """Return the rule that a slot breaks by its kernels."""
    count = 0 if keep.weights is None else len(keep.weights)
    at = int(np.count_nonzero(sequence.kind[:slot] < 2))
    end = int(sequence.pairs[: at + 1].sum())
    own = slice(end - int(sequence.pairs[at]), end)
    kernel, total = sequence.kernel[own], int(sequence.amplitude[own].sum())
    beyond = np.flatnonzero(kernel >= count)
    if len(beyond):
        return BrokenRule(Rule.KERNEL, slot, value=int(kernel[beyond[0]]), allowed=count)
    return BrokenRule(Rule.SUM, slot, value=total, allowed=MOST_AMPLITUDE)


def _switched(
    sequence: ReceivedSequence, rows: slice, output: Output
) -> tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return which slots make no circuit, the currents of some, (N, E), rounded away from 0, their
    magnitudes and those of the source, (N,)."""
    assert sequence.state is not None
    assert sequence.source_ua is not None
    state, source = sequence.state[rows], sequence.source_ua[rows].astype(np.int64)
    cathodes, anodes = ((state == pole).sum(axis=1) for pole in (1, -1))
    odd = (state == 2).any(axis=1) | (cathodes == 0) | (anodes == 0)
    if output == "one-against-all":
        odd |= (state == 0).any(axis=1) | (np.minimum(cathodes, anodes) != 1)
    shares = [-(-source // np.maximum(poles, 1))[:, None] for poles in (cathodes, anodes)]
    each = np.where(state == 1, shares[0], np.where(state == -1, shares[1], 0))
    return odd, np.where(state == -1, -each, each), each, source


def _recharged(
    sequence: ReceivedSequence, limits: SessionLimits, load: Load, carried_pc: NDArray[np.int64]
) -> BrokenRule | None:
    """Return the first broken rule of a recharge phase after slots of a load."""
    current_ua, width_us = sequence.recharge_ua, sequence.recharge_us
    assert current_ua is not None
    if not sequence.slots or not 0 < width_us <= MAX_RECHARGE_US:
        return BrokenRule(Rule.RECHARGE, value=width_us, allowed=MAX_RECHARGE_US)
    signed = current_ua.astype(np.int64)
    each = np.abs(signed)
    if net := int(signed.sum()):
        return BrokenRule(Rule.BALANCE, value=net)
    allowed = np.minimum(min(MAX_RECHARGE_UA, MAX_RECHARGE_PC // width_us), limits.current_ua)
    if found := first_above(Rule.CURRENT, NOTHING, each, allowed):
        return found
    if (total := int(each.sum()) // 2) > limits.total_ua:
        return BrokenRule(Rule.TOTAL, value=total, allowed=limits.total_ua)
    phase_pc = signed * width_us
    for passes in (0, sequence.times - 1):
        before_pc = carried_pc + passes * (load.net_pc + phase_pc) + load.net_pc
        after = np.abs(before_pc + phase_pc)
        most_pc = np.maximum(np.abs(before_pc), MAX_RECHARGE_PC)
        if found := first_above(Rule.RECHARGE, NOTHING, after, most_pc):
            return found
    return None


def first_above(
    rule: Rule, slot: int, value: NDArray[np.int64], allowed: NDArray[np.int64] | int
) -> BrokenRule | None:
    """Return a rule as broken at the first electrode whose value, (E,), is above the allowed."""
    over = np.flatnonzero(value > allowed)
    if not len(over):
        return None
    electrode, most = int(over[0]), np.broadcast_to(allowed, value.shape)
    return BrokenRule(
        rule, slot, electrode, _i32(int(value[electrode])), _i32(int(most[electrode]))
    )


def _i32(value: int) -> int:
    return min(value, 0x7FFFFFFF)
