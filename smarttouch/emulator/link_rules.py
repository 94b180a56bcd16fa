"""Rules of the ``link`` board for one sequence, in whole numbers and in the order of the page."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.link.protocol import NOTHING, Output, Rule
from smarttouch.emulator.link_limits import (
    BURST_US,
    FULL,
    MAX_MEAN_UA,
    MAX_PULSES_HZ,
    MAX_RECHARGE_PC,
    MAX_RECHARGE_UA,
    MAX_RECHARGE_US,
    MIN_DISCHARGE_US,
    Load,
    SessionLimits,
)
from smarttouch.emulator.link_packets import (
    MOST_AMPLITUDE,
    KernelStore,
    ReceivedSequence,
    rounded,
    summed,
)

_BLOCK = 1 << 13
"""Currents judged at a time, which stay in a processor's own cache."""


class BrokenRule(NamedTuple):
    """First rule that a sequence breaks."""

    rule: Rule
    slot: int = NOTHING
    electrode: int = NOTHING
    value: int = 0
    allowed: int = 0


def complaint(
    lists: ReceivedSequence,
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
    sequence = lists.sequence
    load = Load.none(sequence.electrodes)
    width = sequence.width_us.astype(np.int64)
    if lists.slots > most_slots:
        return BrokenRule(Rule.SLOTS, value=lists.slots, allowed=most_slots), load
    if found := _times(lists, limits, width, load, before):
        return found, load
    peaks = _all_at_once(lists, limits, keep, width, load) if output == "weighted" else None
    if peaks is None:
        load = load.restarted()
        found, peaks = _slot_by_slot(lists, limits, keep, output, width, load)
        if found:
            return found, load
    load.peak_pc = peaks[1]
    return _whole(lists, limits, load, peaks, carried_pc, before), load


def _times(
    lists: ReceivedSequence,
    limits: SessionLimits,
    width: NDArray[np.int64],
    load: Load,
    before: Load,
) -> BrokenRule | None:
    """Return the first broken rule about times; enter them into the load."""
    sequence, slots = lists.sequence, lists.slots
    period_us = sequence.period_us
    if period_us < limits.period_us:
        return BrokenRule(Rule.PERIOD, value=_i32(period_us), allowed=_i32(limits.period_us))
    discharge = sequence.discharge_us.astype(np.int64)
    for slot in range(slots):
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


def _slot_by_slot(
    lists: ReceivedSequence,
    limits: SessionLimits,
    keep: KernelStore,
    output: Output,
    width: NDArray[np.int64],
    load: Load,
) -> tuple[BrokenRule | None, tuple[int, int]]:
    """Return the first broken rule of a slot, and the strongest current and charge."""
    sequence = lists.sequence
    peak_ua = peak_pc = slot = 0
    for group in lists.groups:
        if (group.kind == 3) != (output != "weighted"):
            return BrokenRule(Rule.KIND, slot, value=group.kind), (0, 0)
        for index in range(group.slots):
            if group.kind < 2:
                every = slice(None) if group.kind else slice(index, index + 1)
                kernel, amplitude = group.kernel[every], group.amplitude[every]
                if found := _unkept(kernel, amplitude, keep, slot):
                    return found, (0, 0)
                assert keep.weights is not None
                assert sequence.current_ua is not None
                sequence.current_ua[slot] = summed(keep.weights, kernel, amplitude)
                sequence.site[slot] = keep.site[kernel[0]]
            charged_ua: NDArray[np.int64]
            if group.kind == 3:
                assert sequence.source_ua is not None
                assert sequence.state is not None
                state, source = sequence.state[slot], int(sequence.source_ua[slot])
                found, signed = _switched(state, source, output, limits, slot)
                # Any electrode may be the last that still touches the skin.
                charged_ua = np.where(state == 0, 0, source)
            else:
                assert sequence.current_ua is not None
                found, signed = _weighted(sequence.current_ua[slot], limits, slot)
                charged_ua = np.abs(signed)
            if found:
                return found, (0, 0)
            if found := _above(Rule.CHARGE, slot, charged_ua * int(width[slot]), limits.charge_pc):
                return found, (0, 0)
            most = int(np.abs(signed).max(initial=0))
            peak_ua, peak_pc = max(peak_ua, most), max(peak_pc, most * int(width[slot]))
            load.add(signed[None], width[slot : slot + 1], limits.felt_ua)
            slot += 1
    return None, (peak_ua, peak_pc)


def _all_at_once(
    lists: ReceivedSequence,
    limits: SessionLimits,
    keep: KernelStore,
    width_us: NDArray[np.int64],
    load: Load,
) -> tuple[int, int] | None:
    """Return the strongest current and charge; None if a slot may break a rule.

    Which one, and which rule, is then found slot by slot.
    """
    current_ua = lists.sequence.current_ua
    if current_ua is None or any(group.kind == 3 for group in lists.groups):
        return None
    if not _filled_in(lists, keep, current_ua):
        return None
    peak_ua = peak_pc = 0
    for rows in _blocks(*current_ua.shape):
        signed, width = current_ua[rows].astype(np.int64), width_us[rows]
        each = np.abs(signed)
        charge_pc = each * width[:, None]
        if (
            signed.sum(axis=1).any()
            or (each > limits.current_ua).any()
            or int(each.sum(axis=1).max(initial=0)) // 2 > limits.total_ua
            or (charge_pc > limits.charge_pc).any()
        ):
            return None
        load.add(signed, width, limits.felt_ua)
        peak_ua = max(peak_ua, int(each.max(initial=0)))
        peak_pc = max(peak_pc, int(charge_pc.max(initial=0)))
    return peak_ua, peak_pc


def _blocks(rows: int, electrodes: int) -> Iterator[slice]:
    """Yield slices of as many rows as stay in the processor's cache."""
    step = max(1, _BLOCK // max(1, electrodes))
    return (slice(start, min(start + step, rows)) for start in range(0, rows, step))


def _filled_in(lists: ReceivedSequence, keep: KernelStore, current_ua: NDArray[np.int16]) -> bool:
    """Return whether all kernels are kept and no sum is too large, and fill in what they make."""
    slot = np.repeat([group.kind < 2 for group in lists.groups], [g.slots for g in lists.groups])
    if not slot.any():
        return True
    of_kernels = [group for group in lists.groups if group.kind < 2]
    kernel = np.concatenate([group.kernel for group in of_kernels])
    amplitude = np.concatenate([group.amplitude for group in of_kernels])
    size = np.concatenate(
        [
            [len(group.kernel)] if group.kind else np.ones(group.slots, np.int64)
            for group in of_kernels
        ]
    )
    end = np.cumsum(size)
    first = end - size
    if keep.weights is None or int(kernel.max()) >= len(keep.weights):
        return False
    if (np.add.reduceat(amplitude, first) > MOST_AMPLITUDE).any():
        return False
    places = slot.nonzero()[0]
    for rows in _blocks(len(places), current_ua.shape[1]):
        pairs = slice(first[rows.start], end[rows.stop - 1])
        every = keep.weights[kernel[pairs]].astype(np.int64)
        every *= amplitude[pairs, None]
        current_ua[places[rows]] = rounded(
            np.add.reduceat(every, first[rows] - pairs.start, axis=0)
        )
    lists.sequence.site[slot] = keep.site[kernel[first]]
    return True


def _whole(
    lists: ReceivedSequence,
    limits: SessionLimits,
    load: Load,
    peaks: tuple[int, int],
    carried_pc: NDArray[np.int64],
    before: Load,
) -> BrokenRule | None:
    """Return the first broken rule of those about the whole sequence, by itself."""
    sequence, (peak_ua, peak_pc) = lists.sequence, peaks
    if sequence.recharge_ua is not None:
        if found := _recharged(lists, limits, load, carried_pc):
            return found
        recharge_pc = sequence.recharge_ua.astype(np.int64) * sequence.recharge_us
        load.charge_pc += np.abs(recharge_pc)
        load.net_pc += recharge_pc
    burst_us = min(sequence.period_us, BURST_US)
    charge_pc, felt = before.charge_pc + load.charge_pc, before.felt + load.felt
    if found := _above(Rule.MEAN, NOTHING, charge_pc, MAX_MEAN_UA * burst_us):
        return found
    if found := _above(Rule.FELT, NOTHING, felt, MAX_PULSES_HZ * burst_us // 10**6):
        return found
    strongest_ua = limits.full_ua + limits.rounding_ua
    if limits.full_us:
        allowed = strongest_ua * limits.full_us * 1001 * lists.intensity // (1000 * FULL)
        if peak_pc > allowed:
            return BrokenRule(Rule.INTENSITY, value=peak_pc, allowed=_i32(allowed))
        allowed = strongest_ua
    else:
        allowed = limits.full_ua * lists.intensity // FULL + limits.rounding_ua
    if peak_ua > allowed:
        return BrokenRule(Rule.INTENSITY, value=peak_ua, allowed=allowed)
    return None


def _unkept(
    kernel: NDArray[np.int64], amplitude: NDArray[np.int64], keep: KernelStore, slot: int
) -> BrokenRule | None:
    count = 0 if keep.weights is None else len(keep.weights)
    beyond = np.flatnonzero(kernel >= count)
    if len(beyond):
        return BrokenRule(Rule.KERNEL, slot, value=int(kernel[beyond[0]]), allowed=count)
    if (total := int(amplitude.sum())) > MOST_AMPLITUDE:
        return BrokenRule(Rule.SUM, slot, value=total, allowed=MOST_AMPLITUDE)
    return None


def _weighted(
    current_ua: NDArray[np.int16], limits: SessionLimits, slot: int
) -> tuple[BrokenRule | None, NDArray[np.int64]]:
    """Return the first broken rule of a slot's currents, and the currents."""
    signed = current_ua.astype(np.int64)
    each = np.abs(signed)
    if net := int(current_ua.sum(dtype=np.int64)):
        return BrokenRule(Rule.BALANCE, slot, value=net), signed
    if found := _above(Rule.CURRENT, slot, each, limits.current_ua):
        return found, signed
    if (total := int(each.sum()) // 2) > limits.total_ua:
        return BrokenRule(Rule.TOTAL, slot, value=total, allowed=limits.total_ua), signed
    return None, signed


def _switched(
    state: NDArray[np.int8], source_ua: int, output: Output, limits: SessionLimits, slot: int
) -> tuple[BrokenRule | None, NDArray[np.int64]]:
    """Return the first broken rule of a slot's states, and its currents, rounded away from 0."""
    cathodes, anodes = int((state == 1).sum()), int((state == -1).sum())
    wrong = bool((state == 2).any()) or not cathodes or not anodes
    if output == "one-against-all":
        wrong |= bool((state == 0).any()) or min(cathodes, anodes) != 1
    each = np.zeros(len(state), np.int64)
    if wrong:
        return BrokenRule(Rule.STATES, slot), each
    each[state == 1], each[state == -1] = -(-source_ua // cathodes), -(-source_ua // anodes)
    signed = np.where(state == -1, -each, each)
    if found := _above(Rule.CURRENT, slot, each, limits.current_ua):
        return found, signed
    if source_ua > limits.total_ua:
        return BrokenRule(Rule.TOTAL, slot, value=source_ua, allowed=limits.total_ua), signed
    return None, signed


def _recharged(
    lists: ReceivedSequence, limits: SessionLimits, load: Load, carried_pc: NDArray[np.int64]
) -> BrokenRule | None:
    """Return the first broken rule of a recharge phase after slots of a load."""
    sequence = lists.sequence
    current_ua, width_us = sequence.recharge_ua, sequence.recharge_us
    assert current_ua is not None
    if not lists.slots or not 0 < width_us <= MAX_RECHARGE_US:
        return BrokenRule(Rule.RECHARGE, value=width_us, allowed=MAX_RECHARGE_US)
    signed = current_ua.astype(np.int64)
    each = np.abs(signed)
    if net := int(signed.sum()):
        return BrokenRule(Rule.BALANCE, value=net)
    allowed = np.minimum(min(MAX_RECHARGE_UA, MAX_RECHARGE_PC // width_us), limits.current_ua)
    if found := _above(Rule.CURRENT, NOTHING, each, allowed):
        return found
    if (total := int(each.sum()) // 2) > limits.total_ua:
        return BrokenRule(Rule.TOTAL, value=total, allowed=limits.total_ua)
    phase_pc = signed * width_us
    for passes in (0, sequence.times - 1):
        before_pc = carried_pc + passes * (load.net_pc + phase_pc) + load.net_pc
        after = np.abs(before_pc + phase_pc)
        most_pc = np.maximum(np.abs(before_pc), MAX_RECHARGE_PC)
        if found := _above(Rule.RECHARGE, NOTHING, after, most_pc):
            return found
    return None


def _above(
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
