"""Rules of the ``link`` board, in the order of ``firmware/PROTOCOL.md``, computed in integers.

The rules limit each sequence, the ramp, pulses and charges within one second, and time and charges
of one session. Times are on the board's clock, in µs; charges are in pC."""

from collections import deque
from copy import copy
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.link import FULL, LIMITS, NAK, NOTHING, STATES, Output, Refusal, Rule
from smarttouch.emulator.link_packets import KernelStore, ReceivedSequence, rounded

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
"""Largest current of a recharge phase: a tenth of `MAX_CURRENT_UA`. The phase must not be felt, but
the board does not know the detection thresholds."""
MAX_RECHARGE_US = 20_000
MAX_RECHARGE_PC = 2_000_000
STRENGTH = 4  # largest ratio of strength to ``share``, see `SessionLimits.strength`
BUCKET_US = 50_000  # duration of a bucket; a pass belongs to the bucket in which it ends
BUCKETS = 20  # the last second has this number of buckets, without the current bucket
SECOND_US = 1_000_000
MOST_CHARGE_PC = 500_000_000
MOST_NET_PC = 50_000_000
RAMP_MS = 500  # shortest time from zero to full intensity
CATCH_UP_US = 150_000  # strength may be ahead of the ramp by this time, because packets can be late
KEPT_US = 15_000_000  # time without current after which the ramp restarts
_LEEWAY = 2  # tolerance for the rounding of an intensity, in units of 1/65,535


class BrokenRule(NamedTuple):
    """Violation of a rule by a sequence."""

    rule: Rule
    slot: int = NOTHING
    electrode: int = NOTHING
    value: int = 0
    allowed: int = 0

    def nak(self, reason: Refusal = Refusal.UNSAFE) -> bytes:
        value, allowed = (min(number, 0x7FFFFFFF) for number in self[3:])
        return NAK.pack(reason, *self[:3], value, allowed)


def first_above(
    rule: Rule, value: NDArray[np.int64] | int, allowed: Any, slot: int = NOTHING
) -> BrokenRule | None:
    """Return a violation for the first value that exceeds its allowed value, or None."""
    values, allowed_each = np.broadcast_arrays(np.atleast_1d(value), allowed)
    if not len(over := np.flatnonzero(values > allowed_each)):
        return None
    first = int(over[0])
    electrode = first if isinstance(value, np.ndarray) else NOTHING
    return BrokenRule(rule, slot, electrode, int(values[first]), int(allowed_each[first]))


class Load(NamedTuple):
    """Counts, charges, peaks and durations of one pass of a sequence, or of parts of a scan."""

    each: NDArray[np.int64]
    """(3, E): number of perceptible pulses; absolute charge, pC; net charge, pC (cathodic is
    positive). Charges include the recharge phase."""
    peak_ua: int  # largest current of a pulse
    peak_pc: int  # largest charge of a pulse
    busy_us: int  # duration of all slots and the recharge phase
    pulses_us: int  # duration of all pulses and the recharge phase, without discharge

    def after(self, before: "Load") -> "Load":
        """Return the total of this load and ``before``. Add counts, charges and durations. Keep
        the larger value of each peak."""
        return Load(
            before.each + self.each, max(before.peak_ua, self.peak_ua),
            max(before.peak_pc, self.peak_pc), before.busy_us + self.busy_us,
            before.pulses_us + self.pulses_us,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class SessionLimits:
    """Limits of a session. Each is the stricter one of the host's and the board's limit."""

    period_us: int
    total_ua: int
    width_us: int
    full_ua: int
    rounding_ua: int
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
        """Decode limits; return None if the payload is invalid."""
        if len(payload) != LIMITS.size + 8 * electrodes:
            return None
        (
            period, total, width, full, rounding, _, ramp, session_s, session_uc, duty, _, usual_us,
        ) = LIMITS.unpack_from(payload)  # fmt: skip
        current, felt = np.frombuffer(payload, "<u2", 2 * electrodes, LIMITS.size).reshape(2, -1)
        charge = np.frombuffer(payload, "<u4", electrodes, LIMITS.size + 4 * electrodes)
        total_ua = MAX_TOTAL_UA if output == "weighted" else MAX_CURRENT_UA
        return cls(
            max(period, MIN_PERIOD_US), min(total, total_ua), min(width, MAX_WIDTH_US),
            min(full, MAX_CURRENT_UA), min(rounding, -(-electrodes // 2) + 1),
            max(ramp or MAX_RAMP_MS, MIN_RAMP_MS),
            min(session_s, MAX_SESSION_S), min(session_uc, MAX_SESSION_UC),
            min(duty, MAX_DUTY_PERCENT), min(full, MAX_CURRENT_UA) * min(usual_us, MAX_WIDTH_US),
            np.minimum(current.astype(np.int64), MAX_CURRENT_UA),
            np.minimum(felt.astype(np.int64), MAX_FELT_UA),
            np.minimum(charge.astype(np.int64), MAX_CHARGE_PC),
        )  # fmt: skip

    def strength(self, intensity: int, peak_pc: int) -> int:
        """Return the strength of a sequence; the ramp limits how fast the strength rises. It is the
        intensity, but at least ``share``, at most `STRENGTH` times ``share``, and never above
        `FULL`. ``share`` is ``peak_pc`` relative to the charge of a full pulse."""
        share = -(-peak_pc * FULL // self.full_pc) if self.full_pc else FULL * (peak_pc > 0)
        return min(FULL, max(share, min(intensity, STRENGTH * share)))

    def intensity(self, intensity: int, load: "Load") -> "BrokenRule | None":
        """Return a violation if pulses are too strong for the stated intensity."""
        allowed_ua = self.full_ua * intensity // FULL + self.rounding_ua
        return first_above(Rule.INTENSITY, load.peak_ua, allowed_ua)


class LastSecond:
    """Record of pulses and charges in the last second and in the session, to check limits."""

    def __init__(self, electrodes: int) -> None:
        # For each ended pass: the bucket in which it ended, and its load
        self._over: deque[tuple[int, NDArray[np.int64]]] = deque()
        self._running: NDArray[np.int64] | None = None  # load of the executing pass
        self._starts_us: deque[int] = deque()
        self._none = np.zeros((3, electrodes), np.int64)
        self.most_net_pc: int = 0  # largest net charge of an electrode within any second so far
        self.begin_session()

    def begin_session(self) -> None:
        """Reset the load of the session; keep the load of the last second."""
        self.session_us: int = 0
        self.session: NDArray[np.int64] = self._none  # (3, E): sum of `Load.each` in the session

    def begin(self, start_us: int, period_us: int, load: Load, goes_on: bool) -> None:
        """Add a pass that begins at ``start_us``. If ``goes_on``, the pass continues a scan, whose
        start and period are already counted."""
        if not goes_on:
            self._starts_us.append(start_us)
            self.session_us += period_us * (load.busy_us > 0)
        while self._starts_us and self._starts_us[0] < start_us - SECOND_US:
            self._starts_us.popleft()
        if not load.busy_us:
            return
        while self._over and self._over[0][0] < start_us // BUCKET_US - BUCKETS:
            self._over.popleft()
        nets_pc = _most_net(self._in_window(start_us), load.each[2])
        self.most_net_pc = max(self.most_net_pc, int(nets_pc.max()))
        self._running = load.each
        self.session = self.session + load.each

    def end(self, end_us: int) -> None:
        """Record that the executing pass ended at ``end_us``."""
        if self._running is not None:
            self._over.append((end_us // BUCKET_US, self._running))
            self._running = None

    def _in_window(self, start_us: int) -> NDArray[np.int64]:
        """Return `Load.each` of the N passes in the last second, latest first, (N, 3, E)."""
        first = start_us // BUCKET_US - BUCKETS
        loads = [] if self._running is None else [self._running]
        loads += [load for bucket, load in reversed(self._over) if bucket >= first]
        return np.array(loads, np.int64).reshape(-1, *self._none.shape)

    def find_violation(
        self, start_us: int, sequence: ReceivedSequence, load: Load, limits: SessionLimits
    ) -> BrokenRule | None:
        """Return the first violation of a limit per second or per session, or None. The sequence
        begins at ``start_us``; earlier passes count, too."""
        period_us, times, broken = sequence.period_us, sequence.times, None
        starts_us = range(start_us, start_us + min(times * period_us, SECOND_US), period_us)
        if load.busy_us:
            broken = self._second(starts_us, load)
        if not sequence.goes_on:
            most_starts = max(
                own_starts + sum(pass_us >= at_us - SECOND_US for pass_us in self._starts_us)
                for own_starts, at_us in enumerate(starts_us, 1)
            )
            broken = broken or first_above(
                Rule.OFTEN, most_starts, -(-SECOND_US // limits.period_us) + 1
            )
        if broken is not None or not load.busy_us:
            return broken
        session_us = self.session_us + times * period_us * (not sequence.goes_on)
        session_uc = -(-(self.session[1] + times * load.each[1]) // 10**6)
        return first_above(
            Rule.SESSION_TIME, -(-session_us // 10**6), limits.session_s
        ) or first_above(Rule.SESSION_CHARGE, session_uc, limits.session_uc)

    def _second(self, starts_us: range, load: Load) -> BrokenRule | None:
        largest = self._none
        for passes, at_us in enumerate(starts_us, 1):
            window = self._in_window(at_us)
            every = window.sum(axis=0) + passes * load.each
            every[2] = _most_net(window, passes * load.each[2])
            largest = np.maximum(largest, every)
        return (
            first_above(Rule.FELT_IN_SECOND, largest[0], MAX_PULSES_HZ)
            or first_above(Rule.CHARGE_IN_SECOND, largest[1], MOST_CHARGE_PC)
            or first_above(Rule.NET_IN_SECOND, largest[2], MOST_NET_PC)
        )


def _most_net(window: NDArray[np.int64], net_pc: NDArray[np.int64]) -> NDArray[np.int64]:
    """Add ``net_pc`` and the net charges of the latest k passes in ``window``, for each k from 0.
    Return the largest absolute sum for each electrode, (E,)."""
    runs = np.cumsum([net_pc, *window[:, 2]], axis=0)
    return np.asarray(np.abs(runs).max(axis=0))


class Ramp:
    """Slew limit: intensity rises only while current flows, and only to the sequence's strength.
    ``ramp_ms`` is the shortest time from zero to full intensity; 0 turns off the ramp in tests."""

    def __init__(self, ramp_ms: int = RAMP_MS) -> None:
        self._own_ms = ramp_ms
        self.restart(ramp_ms)

    def restart(self, ramp_ms: int) -> None:
        """Restart at zero intensity. The shortest time to full intensity is the longer of
        ``ramp_ms`` here and in the constructor."""
        self._ramp_us = 1000 * max(self._own_ms, ramp_ms) if self._own_ms else 0
        self._level = self._strength = self._since_us = self._span_us = 0

    def _reached(self, now_us: int) -> tuple[int, int]:
        """Return the intensity reached, and how long current flowed since the last `note`, µs."""
        on_us = max(0, min(now_us - self._since_us, self._span_us))
        if now_us - self._since_us - on_us > KEPT_US:
            return 0, on_us
        risen = min(self._strength, self._level + on_us * FULL // self._ramp_us)
        return max(self._level, risen), on_us

    def allowed(self, now_us: int) -> int:
        """Return the largest strength allowed at ``now_us``."""
        if not self._ramp_us:
            return FULL
        ahead = CATCH_UP_US * FULL // self._ramp_us
        return min(FULL, self._reached(now_us)[0] + ahead + _LEEWAY)

    def note(self, intensity: int, strength: int, now_us: int, span_us: int) -> None:
        """Record the start of a sequence; ``span_us`` is its duration, 0 if it has no current."""
        if not self._ramp_us:
            return
        risen, on_us = self._reached(now_us)
        if span_us:
            self._level, self._since_us = min(intensity, risen), now_us
            self._strength = strength
        else:
            self._level, self._since_us = risen, self._since_us + on_us
        self._span_us = span_us


@dataclass(frozen=True)
class Room:
    """Capacity of a board. The host divides scans into parts that fit."""

    slots: int = MAX_SLOTS
    packet_bytes: int = 1 << 20
    kernel_bytes: int = 1 << 23
    kernels: int = 4096


@dataclass
class _Scan:
    """Accepted parts of a scan; the rules treat all parts as one sequence."""

    last: ReceivedSequence  # latest part
    real_us: int  # planned start in real time, see `LinkRules.check`
    ramp: Ramp  # state of the ramp before the scan
    load: Load


class LinkRules:
    """Checks of sequences, with the limits, kernels and past loads that the checks need."""

    def __init__(self, electrodes: int, output: Output, room: Room, ramp_ms: int) -> None:
        self._none = Load(np.zeros((3, electrodes), np.int64), 0, 0, 0, 0)
        self._output, self._room = output, room
        self.keep = KernelStore(electrodes, room.kernel_bytes, room.kernels)
        self.second = LastSecond(electrodes)
        self.limits: SessionLimits | None = None
        self._ramp = Ramp(ramp_ms)
        self._scan: _Scan | None = None

    def begin_session(self) -> None:
        self.limits = self._scan = None
        self._ramp.restart(0)
        self.second.begin_session()

    def take_limits(self, payload: bytes) -> None:
        """Set the limits of the session; do nothing if the session already has valid limits."""
        if self.limits is None:
            self.limits = SessionLimits.of(payload, self._none.each.shape[1], self._output)
            self._ramp.restart(0 if self.limits is None else self.limits.ramp_ms)

    def check(self, sequence: ReceivedSequence, start_us: int, real_us: int) -> BrokenRule | Load:
        """Compute the currents of kernels. Return the first violation, or the load of one pass. The
        first pass begins at ``start_us`` on the board's clock, which can stand still, and at
        ``real_us`` on a clock that never stands still."""
        scan, limits = self._scan, self.limits
        if not sequence.goes_on:
            scan = _Scan(sequence, real_us, copy(self._ramp), self._none)
        if limits is None:
            return BrokenRule(Rule.LIMITS)
        if scan is None or (sequence.goes_on and not scan.last.more):
            return BrokenRule(Rule.PART)
        last = scan.last
        if (last.period_us, last.intensity) != (sequence.period_us, sequence.intensity):
            return BrokenRule(Rule.PART)
        missing, amplitude = self._fill_in(sequence)
        signed_ua = self._currents(sequence)
        load = _load_of(sequence, signed_ua, limits)
        total_load = load.after(scan.load)
        burst_us = min(sequence.period_us, BURST_US)
        strength = limits.strength(sequence.intensity, total_load.peak_pc)
        if broken := (
            self._times(sequence, limits, total_load)
            or self._slots(sequence, np.abs(signed_ua), limits, missing, amplitude)
            or self._recharged(sequence, limits, load)
            or first_above(Rule.MEAN, total_load.each[1], MAX_MEAN_UA * burst_us)
            or first_above(Rule.FELT, total_load.each[0], MAX_PULSES_HZ * burst_us // 10**6)
            or limits.intensity(sequence.intensity, load)
            or first_above(Rule.RISE, strength, scan.ramp.allowed(scan.real_us))
            or self.second.find_violation(start_us, sequence, load, limits)
        ):
            return broken
        scan.load, scan.last, self._scan, self._ramp = total_load, sequence, scan, copy(scan.ramp)
        span_us = sequence.times * sequence.period_us if total_load.peak_pc else 0
        self._ramp.note(sequence.intensity, strength, scan.real_us, span_us)
        return load

    def _times(
        self, sequence: ReceivedSequence, limits: SessionLimits, total_load: Load
    ) -> BrokenRule | None:
        period_us = sequence.period_us
        if broken := first_above(Rule.SLOTS, sequence.slots, self._room.slots):
            return broken
        if period_us < limits.period_us:
            return BrokenRule(Rule.PERIOD, value=period_us, allowed=limits.period_us)
        width_us, rest_us = sequence.width_us, sequence.discharge_us
        wide = (width_us < 1) | (width_us > limits.width_us)
        if (wrong := wide | (rest_us < MIN_DISCHARGE_US)).any():
            slot = int(wrong.argmax())
            rule, value, allowed = Rule.DISCHARGE, rest_us[slot], MIN_DISCHARGE_US
            if wide[slot]:
                rule, value, allowed = Rule.WIDTH, width_us[slot], limits.width_us
            return BrokenRule(rule, slot, value=int(value), allowed=allowed)
        return first_above(Rule.FIT, total_load.busy_us, period_us) or first_above(
            Rule.DUTY, total_load.pulses_us, limits.duty_percent * period_us // 100
        )

    def _slots(
        self,
        sequence: ReceivedSequence,
        each_ua: NDArray[np.int64],
        limits: SessionLimits,
        missing: NDArray[np.int64],
        amplitude: NDArray[np.int64],
    ) -> BrokenRule | None:
        """Return the first violation in the first slot that violates a rule, or None."""
        kind, switched = sequence.kind, self._output != "weighted"
        if switched:
            odd = (Rule.STATES, self._no_circuit(sequence.rows), 0 * kind, 0)
            total_ua = sequence.source_ua
            # An electrode carries all current if the other electrodes of its pole lose contact.
            through_ua = np.where(each_ua > 0, total_ua[:, None], 0)
        else:
            sums_ua = sequence.rows.sum(axis=1)
            odd = (Rule.BALANCE, sums_ua != 0, sums_ua, 0)
            total_ua, through_ua = each_ua.sum(axis=1) // 2, each_ua
        charge_pc = through_ua * sequence.width_us[:, None]
        # For each rule: mask of violations, (S,) or (S, E); checked values; allowed values
        rules: list[tuple[Rule, NDArray[np.bool_], NDArray[np.int64], Any]] = [
            (Rule.KIND, (kind == STATES) != switched, kind, 0),
            (Rule.KERNEL, missing >= 0, missing, self.keep.count),
            (Rule.SUM, amplitude > FULL, amplitude, FULL),
            odd,
            (Rule.CURRENT, each_ua > limits.current_ua, each_ua, limits.current_ua),
            (Rule.TOTAL, total_ua > limits.total_ua, total_ua, limits.total_ua),
            (Rule.CHARGE, charge_pc > limits.charge_pc, charge_pc, limits.charge_pc),
        ]
        broken = np.array(
            [
                is_broken if is_broken.ndim == 1 else is_broken.any(axis=1)
                for _, is_broken, _, _ in rules
            ]
        )
        if not broken.any():
            return None
        slot = int(broken.any(axis=0).argmax())
        rule, _, values, allowed = rules[int(broken[:, slot].argmax())]
        if values.ndim == 1:
            return BrokenRule(rule, slot, value=int(values[slot]), allowed=allowed)
        return first_above(rule, values[slot], allowed, slot)

    def _fill_in(self, sequence: ReceivedSequence) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Compute currents and sites of slots that list kernels. Return two arrays, (S,): for each
        slot, its first kernel that is not stored (or -1), and the sum of its amplitudes."""
        keep, (slot, kernel, amplitude) = self.keep, sequence.pairs.T
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

    def _no_circuit(self, state: NDArray[np.int64]) -> NDArray[np.bool_]:
        cathodes, anodes = ((state == pole).sum(axis=1) for pole in (1, -1))
        odd = (state == 2).any(axis=1) | (cathodes == 0) | (anodes == 0)
        if self._output == "one-against-all":
            odd |= (state == 0).any(axis=1) | (np.minimum(cathodes, anodes) != 1)
        return np.asarray(odd)

    def _currents(self, sequence: ReceivedSequence) -> NDArray[np.int64]:
        """Return the currents, (S, E) µA. The current of a single source is divided equally among
        the electrodes of a pole, and rounded away from 0."""
        rows, source_ua = sequence.rows, sequence.source_ua
        if self._output == "weighted":
            return rows
        share_ua = [
            -(-source_ua // np.maximum((rows == pole).sum(axis=1), 1))[:, None] for pole in (1, -1)
        ]
        return np.asarray(np.where(rows == 1, share_ua[0], -share_ua[1] * (rows == -1)))

    def _recharged(
        self, sequence: ReceivedSequence, limits: SessionLimits, load: Load
    ) -> BrokenRule | None:
        """Return the first violation by the recharge phase, or None. ``load`` is for one pass."""
        width_us, recharge_ua = sequence.recharge_us, sequence.recharge_ua
        if recharge_ua is None:
            return None
        if not sequence.slots or not 0 < width_us <= MAX_RECHARGE_US:
            return BrokenRule(Rule.RECHARGE, value=width_us, allowed=MAX_RECHARGE_US)
        if net := int(recharge_ua.sum()):
            return BrokenRule(Rule.BALANCE, value=net)
        magnitude_ua = np.abs(recharge_ua)
        allowed = np.minimum(min(MAX_RECHARGE_UA, MAX_RECHARGE_PC // width_us), limits.current_ua)
        broken = first_above(Rule.CURRENT, magnitude_ua, allowed) or first_above(
            Rule.TOTAL, int(magnitude_ua.sum()) // 2, limits.total_ua
        )
        for passes in (1, sequence.times):
            after_pc = self.second.session[2] + passes * load.each[2]
            most_pc = np.maximum(np.abs(after_pc - recharge_ua * width_us), MAX_RECHARGE_PC)
            broken = broken or first_above(Rule.RECHARGE, np.abs(after_pc), most_pc)
        return broken


def _load_of(
    sequence: ReceivedSequence, signed_ua: NDArray[np.int64], limits: SessionLimits
) -> Load:
    """Return the load of one pass with the currents ``signed_ua``, (S, E)."""
    width_us, each_ua = sequence.width_us, np.abs(signed_ua)
    strongest_ua, pulses_us = each_ua.max(axis=1, initial=0), int(width_us.sum())
    felt = ((each_ua >= limits.felt_ua) & (each_ua > 0)).sum(axis=0)
    loads = np.array([felt, width_us @ each_ua, width_us @ signed_ua])
    busy_us = pulses_us + int(sequence.discharge_us.sum())
    if sequence.recharge_ua is not None:
        phase_pc = sequence.recharge_ua * sequence.recharge_us
        loads += [0 * phase_pc, np.abs(phase_pc), phase_pc]
        pulses_us += sequence.recharge_us
        busy_us += sequence.recharge_us + MIN_DISCHARGE_US
    peak_pc = int((strongest_ua * width_us).max(initial=0))
    return Load(loads, int(strongest_ua.max(initial=0)), peak_pc, busy_us, pulses_us)
