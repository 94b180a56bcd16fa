"""Rules of the ``link`` board of version 4, in whole numbers and in the order of the page."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.emulator.lists import MOST_AMPLITUDE, Keep, Lists, rounded, summed
from smarttouch.boards.emulator.rules import (
    MAX_CHARGE_PC,
    MAX_CURRENT_UA,
    MAX_RECHARGE_PC,
    MAX_RECHARGE_UA,
    MAX_RECHARGE_US,
    MAX_SLOTS,
    MAX_WIDTH_US,
    MIN_PERIOD_US,
)
from smarttouch.boards.link_protocol import LIMITS, NOTHING, Output, Rule

MAX_TOTAL_UA = 10_000
MIN_DISCHARGE_US = 20
MAX_DUTY_PERCENT = 80
MAX_MEAN_UA = 500
BURST_US = 40_000
FULL = 0xFFFF
RAMP_MS = 500
"""Least time from zero to full."""
CATCH_UP_MS = 150
"""Time by which a rise may be ahead of that, as packets may be late."""
_LEEWAY = 2
"""Of an intensity in 1/65,535, for its rounding."""


class Complaint(NamedTuple):
    """First rule that a sequence breaks."""

    rule: Rule
    slot: int = NOTHING
    electrode: int = NOTHING
    value: int = 0
    allowed: int = 0


@dataclass(frozen=True, eq=False)
class SessionLimits:
    """Limits of a session: the host's, or the board's own where these are stricter."""

    period_us: int
    total_ua: int
    charge_pc: int
    width_us: int
    full_ua: int
    rounding_ua: int
    full_us: int
    current_ua: NDArray[np.int64]

    @classmethod
    def of(cls, payload: bytes, electrodes: int) -> "SessionLimits | None":
        """Return the limits in a payload; None if it is none."""
        if len(payload) != LIMITS.size + 2 * electrodes:
            return None
        period, total, charge, width, full, rounding, full_us = LIMITS.unpack_from(payload)
        each = np.frombuffer(payload, "<u2", offset=LIMITS.size).astype(np.int64)
        return cls(
            max(period, MIN_PERIOD_US), min(total, MAX_TOTAL_UA), min(charge, MAX_CHARGE_PC),
            min(width, MAX_WIDTH_US), full, rounding, full_us, np.minimum(each, MAX_CURRENT_UA),
        )  # fmt: skip


class Ramp:
    """Rise of intensity on the board's own clock."""

    def __init__(self, ramp_ms: int = RAMP_MS) -> None:
        self._ramp_us = 1000 * ramp_ms
        self.restart()

    def restart(self) -> None:
        self._level, self._since_us = 0, -1

    def _risen(self, now_us: int) -> int:
        if self._since_us < 0:
            return self._level
        spent_us = now_us - self._since_us
        if spent_us >= self._ramp_us:
            return FULL
        return min(FULL, self._level + spent_us * FULL // self._ramp_us)

    def allowed(self, now_us: int) -> int:
        """Return the largest intensity that may be accepted now."""
        if not self._ramp_us:
            return FULL
        ahead = CATCH_UP_MS * 1000 * FULL // self._ramp_us
        return min(FULL, max(self._level, self._risen(now_us) + ahead) + _LEEWAY)

    def note(self, intensity: int, now_us: int) -> None:
        self._level = min(intensity, max(self._level, self._risen(now_us)))
        self._since_us = now_us


def complaint(
    lists: Lists, limits: SessionLimits, keep: Keep, output: Output, most_intensity: int
) -> Complaint | None:
    """Fill in what kernels make, and return the first rule that is broken, if any."""
    sequence = lists.sequence
    period_us, slots = sequence.period_us, lists.slots
    if slots > MAX_SLOTS:
        return Complaint(Rule.SLOTS, value=slots, allowed=MAX_SLOTS)
    if period_us < limits.period_us:
        return Complaint(Rule.PERIOD, value=_i32(period_us), allowed=_i32(limits.period_us))
    width = sequence.width_us.astype(np.int64)
    discharge = sequence.discharge_us.astype(np.int64)
    for slot in range(slots):
        if not 0 < width[slot] <= limits.width_us:
            return Complaint(Rule.WIDTH, slot, value=int(width[slot]), allowed=limits.width_us)
        if discharge[slot] < MIN_DISCHARGE_US:
            rest_us = int(discharge[slot])
            return Complaint(Rule.DISCHARGE, slot, value=rest_us, allowed=MIN_DISCHARGE_US)
    busy_us = int((width + discharge).sum()) + sequence.recharge_us
    if busy_us > period_us:
        return Complaint(Rule.FIT, value=_i32(busy_us), allowed=_i32(period_us))
    pulses_us = int(width.sum())
    if 100 * pulses_us > MAX_DUTY_PERCENT * period_us:
        allowed = period_us * MAX_DUTY_PERCENT // 100
        return Complaint(Rule.DUTY, value=_i32(pulses_us), allowed=_i32(allowed))
    if (sums := _all_at_once(lists, limits, keep, width)) is not None and output == "weighted":
        return _whole(lists, limits, *sums, most_intensity)
    passed_pc = np.zeros(sequence.electrodes, np.int64)
    peak_ua = peak_pc = slot = 0
    for group in lists.groups:
        if (group.kind == 3) != (output != "weighted"):
            return Complaint(Rule.KIND, slot, value=group.kind)
        for index in range(group.slots):
            if group.kind < 2:
                every = slice(None) if group.kind else slice(index, index + 1)
                kernel, amplitude = group.kernel[every], group.amplitude[every]
                if found := _unkept(kernel, amplitude, keep, slot):
                    return found
                assert keep.weights is not None
                assert sequence.current_ua is not None
                sequence.current_ua[slot] = summed(keep.weights, kernel, amplitude)
                sequence.site[slot] = keep.site[kernel[0]]
            if group.kind == 3:
                assert sequence.source_ua is not None
                assert sequence.state is not None
                state, source = sequence.state[slot], int(sequence.source_ua[slot])
                found, each = _switched(state, source, output, limits, slot)
            else:
                assert sequence.current_ua is not None
                found, each = _weighted(sequence.current_ua[slot], limits, slot)
            if found:
                return found
            most = int(each.max(initial=0))
            charge = most * int(width[slot])
            if charge > limits.charge_pc:
                electrode = int(each.argmax())
                return Complaint(Rule.CHARGE, slot, electrode, charge, limits.charge_pc)
            peak_ua, peak_pc = max(peak_ua, most), max(peak_pc, charge)
            passed_pc += each * int(width[slot])
            slot += 1
    return _whole(lists, limits, passed_pc, (peak_ua, peak_pc), most_intensity)


def _all_at_once(
    lists: Lists, limits: SessionLimits, keep: Keep, width_us: NDArray[np.int64]
) -> tuple[NDArray[np.int64], tuple[int, int]] | None:
    """Return the charge of each electrode and the peaks; None if a slot may break a rule.

    Which one, and which rule, is then found slot by slot.
    """
    sequence, weights, slot = lists.sequence, keep.weights, 0
    current_ua = sequence.current_ua
    if current_ua is None:
        return None
    for group in lists.groups:
        rows = slice(slot, slot + group.slots)
        slot += group.slots
        if group.kind == 3:
            return None
        if group.kind == 2:
            continue
        if weights is None or int(group.kernel.max()) >= len(weights):
            return None
        if group.kind == 1 and int(group.amplitude.sum()) > MOST_AMPLITUDE:
            return None
        every = weights[group.kernel].astype(np.int64) * group.amplitude[:, None]
        if group.kind == 1:
            every = every.sum(axis=0, keepdims=True)
        current_ua[rows] = rounded(every)
        sequence.site[rows] = keep.site[group.kernel[: group.slots]]
    each = np.abs(current_ua.astype(np.int64))
    charge_pc = each.max(axis=1, initial=0) * width_us
    if (
        current_ua.sum(axis=1, dtype=np.int64).any()
        or (each > limits.current_ua).any()
        or int(each.sum(axis=1).max(initial=0)) // 2 > limits.total_ua
        or int(charge_pc.max(initial=0)) > limits.charge_pc
    ):
        return None
    return width_us @ each, (int(each.max(initial=0)), int(charge_pc.max(initial=0)))


def _whole(
    lists: Lists,
    limits: SessionLimits,
    passed_pc: NDArray[np.int64],
    peaks: tuple[int, int],
    most_intensity: int,
) -> Complaint | None:
    """Return the first broken rule of those about the whole sequence."""
    sequence, (peak_ua, peak_pc) = lists.sequence, peaks
    if sequence.recharge_ua is not None:
        if found := _recharged(sequence.recharge_ua, sequence.recharge_us, lists.slots, limits):
            return found
        passed_pc = passed_pc + np.abs(sequence.recharge_ua.astype(np.int64)) * sequence.recharge_us
    allowed = MAX_MEAN_UA * min(sequence.period_us, BURST_US)
    over = np.flatnonzero(passed_pc > allowed)
    if len(over):
        electrode = int(over[0])
        return Complaint(Rule.MEAN, NOTHING, electrode, _i32(int(passed_pc[electrode])), allowed)
    strongest_ua = limits.full_ua + limits.rounding_ua
    if limits.full_us:
        allowed = strongest_ua * limits.full_us * 1001 * lists.intensity // (1000 * FULL)
        if peak_pc > allowed:
            return Complaint(Rule.INTENSITY, value=peak_pc, allowed=_i32(allowed))
        allowed = strongest_ua
    else:
        allowed = limits.full_ua * lists.intensity // FULL + limits.rounding_ua
    if peak_ua > allowed:
        return Complaint(Rule.INTENSITY, value=peak_ua, allowed=allowed)
    if lists.intensity > most_intensity:
        return Complaint(Rule.RISE, value=lists.intensity, allowed=most_intensity)
    return None


def _unkept(
    kernel: NDArray[np.int64], amplitude: NDArray[np.int64], keep: Keep, slot: int
) -> Complaint | None:
    count = 0 if keep.weights is None else len(keep.weights)
    beyond = np.flatnonzero(kernel >= count)
    if len(beyond):
        return Complaint(Rule.KERNEL, slot, value=int(kernel[beyond[0]]), allowed=count)
    if (total := int(amplitude.sum())) > MOST_AMPLITUDE:
        return Complaint(Rule.SUM, slot, value=total, allowed=MOST_AMPLITUDE)
    return None


def _weighted(
    current_ua: NDArray[np.int16], limits: SessionLimits, slot: int
) -> tuple[Complaint | None, NDArray[np.int64]]:
    """Return the first broken rule of a slot's currents, and their magnitudes."""
    each = np.abs(current_ua.astype(np.int64))
    if net := int(current_ua.sum(dtype=np.int64)):
        return Complaint(Rule.BALANCE, slot, value=net), each
    over = np.flatnonzero(each > limits.current_ua)
    if len(over):
        electrode = int(over[0])
        most = int(limits.current_ua[electrode])
        return Complaint(Rule.CURRENT, slot, electrode, int(each[electrode]), most), each
    if (total := int(each.sum()) // 2) > limits.total_ua:
        return Complaint(Rule.TOTAL, slot, value=total, allowed=limits.total_ua), each
    return None, each


def _switched(
    state: NDArray[np.int8], source_ua: int, output: Output, limits: SessionLimits, slot: int
) -> tuple[Complaint | None, NDArray[np.int64]]:
    """Return the first broken rule of a slot's states, and the nominal currents, rounded up."""
    cathodes, anodes = int((state == 1).sum()), int((state == -1).sum())
    wrong = bool((state == 2).any()) or not cathodes or not anodes
    if output == "one-against-all":
        wrong |= bool((state == 0).any()) or min(cathodes, anodes) != 1
    each = np.zeros(len(state), np.int64)
    if wrong:
        return Complaint(Rule.STATES, slot), each
    each[state == 1], each[state == -1] = -(-source_ua // cathodes), -(-source_ua // anodes)
    over = np.flatnonzero(each > limits.current_ua)
    if len(over):
        electrode = int(over[0])
        most = int(limits.current_ua[electrode])
        return Complaint(Rule.CURRENT, slot, electrode, int(each[electrode]), most), each
    if source_ua > limits.total_ua:
        return Complaint(Rule.TOTAL, slot, value=source_ua, allowed=limits.total_ua), each
    return None, each


def _recharged(
    current_ua: NDArray[np.int16], width_us: int, slots: int, limits: SessionLimits
) -> Complaint | None:
    """Return the first broken rule of a recharge phase."""
    if not slots or not 0 < width_us <= MAX_RECHARGE_US:
        return Complaint(Rule.RECHARGE, value=width_us, allowed=MAX_RECHARGE_US)
    each = np.abs(current_ua.astype(np.int64))
    if net := int(current_ua.sum(dtype=np.int64)):
        return Complaint(Rule.BALANCE, value=net)
    allowed = min(MAX_RECHARGE_UA, MAX_RECHARGE_PC // width_us)
    over = np.flatnonzero(each > allowed)
    if len(over):
        return Complaint(Rule.CURRENT, NOTHING, int(over[0]), int(each[over[0]]), allowed)
    if (total := int(each.sum()) // 2) > limits.total_ua:
        return Complaint(Rule.TOTAL, value=total, allowed=limits.total_ua)
    return None


def _i32(value: int) -> int:
    return min(value, 0x7FFFFFFF)
