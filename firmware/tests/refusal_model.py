"""Model of what a ``link`` board must refuse, written only from ``firmware/PROTOCOL.md``.

The model and the Python emulator store each pass, and use 50 ms buckets only to decide how long a
pass counts. The C core does not store passes, but sums for each bucket.
"""

import struct
from dataclasses import dataclass, field, replace

import numpy as np

from smarttouch.boards.link import NOTHING, Rule

FULL = 65_535
_SECOND_US = 1_000_000


def _bucket(time_us):
    return time_us // 50_000


def _above(rule, each, allowed, slot=NOTHING):
    """Return a refusal for the first electrode whose value exceeds the allowed one, or None."""
    allowed = np.broadcast_to(allowed, np.shape(each))
    over = np.flatnonzero(each > allowed)
    if not len(over):
        return None
    return rule, slot, int(over[0]), int(each[over[0]]), int(allowed[over[0]])


@dataclass
class Limits:
    """Fields of LIMITS, in the order of the payload."""

    period_us: int = 5000
    total_ua: int = 10_000
    width_us: int = 200
    full_ua: int = 5000
    rounding_ua: int = 3
    ramp_ms: int = 500
    session_s: int = 3600
    session_uc: int = 1_800_000
    duty: int = 80
    usual_us: int = 200
    current_ua: tuple = (5000,) * 4
    felt_ua: tuple = (1200,) * 4
    charge_pc: tuple = (500_000,) * 4

    def payload(self):
        head = struct.pack(
            "<IIHHHHHHIBBH", self.period_us, self.total_ua, self.width_us, self.full_ua,
            self.rounding_ua, 0, self.ramp_ms, self.session_s, self.session_uc,
            self.duty, 0, self.usual_us,
        )  # fmt: skip
        each = zip("HHI", (self.current_ua, self.felt_ua, self.charge_pc), strict=True)
        return head + b"".join(struct.pack(f"<{len(of)}{kind}", *of) for kind, of in each)

    def capped(self, switched=False):
        """Return the limits that apply: the stricter of each limit and the board's own limit."""
        return Limits(
            max(5000, self.period_us), min(5000 if switched else 10_000, self.total_ua),
            min(200, self.width_us), min(5000, self.full_ua),
            min((len(self.current_ua) + 1) // 2 + 1, self.rounding_ua),
            max(500, self.ramp_ms or 10_000), min(3600, self.session_s),
            min(1_800_000, self.session_uc), min(80, self.duty), min(200, self.usual_us),
            np.minimum(5000, self.current_ua), np.minimum(2500, self.felt_ua),
            np.minimum(500_000, self.charge_pc),
        )  # fmt: skip


@dataclass
class Scan:
    """Sequence. Each slot has a width, a discharge time and the currents of the electrodes. With a
    single source, a slot has states of the electrodes instead of currents."""

    period_us: int
    slots: list
    times: int = 1
    intensity: int = FULL
    recharge_us: int = 0
    recharge_ua: tuple = ()
    source_ua: int = 0
    more: bool = False
    """Whether the next sequence continues this scan."""
    goes_on: bool = False
    """Whether this sequence continues the scan of the one before it."""

    def payload(self):
        flags = 2 * bool(self.recharge_ua) | 4 * self.more | 8 * self.goes_on
        parts = [struct.pack("<IHHBB", self.period_us, self.times, self.intensity, flags,
                             len(self.slots))]  # fmt: skip
        parts += [struct.pack("<HH", width, rest) for width, rest, _ in self.slots]
        if self.recharge_ua:
            parts += [struct.pack(f"<H{len(self.recharge_ua)}h", self.recharge_us,
                                  *self.recharge_ua)]  # fmt: skip
        for index, (_, _, each) in enumerate(self.slots):
            parts.append(struct.pack("<BBH", 3 if self.source_ua else 2, index, 1))
            if self.source_ua:
                states = sum((0, 1, 2)[state] << 2 * at for at, state in enumerate(each))
                parts.append(struct.pack("<HHB", 0, self.source_ua, states))
            else:
                parts.append(struct.pack(f"<H{len(each)}h", 0, *each))
        return b"".join(parts)

    def nominal(self):
        """Return the currents of slots, (S, E) µA. With a single source, electrodes of the same
        polarity share its current equally, and each share is rounded up."""
        if not self.slots:
            return np.zeros((0, 1), np.int64)
        rows = np.array([each for _, _, each in self.slots], np.int64)
        if not self.source_ua:
            return rows
        poles = [np.maximum(1, (rows == pole).sum(axis=1, keepdims=True)) for pole in (1, -1)]
        return np.where(rows > 0, -(-self.source_ua // poles[0]),
                        np.where(rows < 0, self.source_ua // -poles[1], 0))  # fmt: skip

    @property
    def busy_us(self):
        return sum(width + rest for width, rest, _ in self.slots) + self.recharge_us


@dataclass
class _Pass:
    start_us: int
    over_us: int
    """Time at which the last slot or the recharge phase ends."""
    end_us: int
    felt: np.ndarray
    charge_pc: np.ndarray
    net_pc: np.ndarray
    flows: bool


@dataclass
class _Rise:
    """Ramp: its level, and the strength, start and duration of the current that raises it."""

    ramp_us: int
    level: int = 0
    strength: int = 0
    since_us: int = 0
    span_us: int = 0

    def risen(self, start_us):
        """Return the level at ``start_us``, and how long current has flowed until then, µs."""
        on_us = min(max(0, start_us - self.since_us), self.span_us)
        if start_us - self.since_us - on_us > 15_000_000:
            return 0, on_us
        risen = self.level + on_us * FULL // self.ramp_us
        return max(self.level, min(self.strength, risen)), on_us

    def after(self, scan, strength, start_us):
        level, on_us = self.risen(start_us)
        if not strength:
            return replace(self, level=level, since_us=self.since_us + on_us, span_us=0)
        level, span_us = min(scan.intensity, level), scan.times * scan.period_us
        return _Rise(self.ramp_us, level, strength, start_us, span_us)


@dataclass
class Judge:
    """Model of a board, which applies the rules and remembers passes across sessions."""

    electrodes: int = 4
    ramp: bool = True
    passes: list = field(default_factory=list)
    starts: list = field(default_factory=list)
    coming: tuple = ()
    """Scan, start of its next pass, and passes left."""
    most_net_pc: int = 0
    flowing: list = field(default_factory=list)
    """Starts of all passes with slots."""
    scan: Scan = None
    """All accepted parts of the last scan, joined to one sequence."""

    def begin(self, limits, switched=False):
        self.limits, self.switched = limits.capped(switched), switched
        self.session_pc = np.zeros(self.electrodes, np.int64)
        self.net_pc, self.flowing_us = self.session_pc.copy(), 0
        self.scan = None
        self.scan_end_us = 0
        self.rise = _Rise(1000 * self.limits.ramp_ms)

    def stop(self, now_us):
        """End the scan that executes."""
        self.advance(now_us)
        self.coming = ()
        if self.passes:
            last = self.passes[-1]
            self.passes[-1] = replace(
                last, over_us=min(last.over_us, now_us), end_us=min(last.end_us, now_us)
            )

    def advance(self, now_us):
        """Begin all passes that are due."""
        while self.coming and self.coming[1] <= now_us:
            scan, start_us, left = self.coming
            one = self._pass(scan, start_us)
            if scan.goes_on:
                one = replace(one, end_us=max(self.scan_end_us, one.over_us))
            self.starts += [start_us] * (not scan.goes_on)
            self.session_pc += one.charge_pc
            self.net_pc += one.net_pc
            self.flowing_us += scan.period_us * bool(scan.slots) * (not scan.goes_on)
            window = self._window(start_us, None)[2]
            self.most_net_pc = max(self.most_net_pc, self._net(window, one.net_pc[None]).max())
            self.passes.append(one)
            self.flowing += [start_us] * one.flows
            self.coming = (scan, start_us + scan.period_us, left - 1) if left > 1 else ()
        self.passes, self.starts = self.passes[-300:], self.starts[-300:]

    def start_us(self, now_us, scan=None):
        self.advance(now_us)
        if not self.passes:
            return now_us
        last = self.passes[-1]
        return max(now_us, last.over_us if scan is not None and scan.goes_on else last.end_us)

    def whole(self, scan):
        """Return a part joined to the accepted parts before it, as one sequence."""
        if not scan.goes_on:
            return scan
        return replace(scan, slots=[*self.scan.slots, *scan.slots])

    def accept(self, scan, now_us):
        """Accept a scan, which begins now or when the executing one is over."""
        start_us = self.start_us(now_us, scan)
        if scan.goes_on:
            # The previous part ends when this part begins, but the scan lasts for its whole period.
            self.scan_end_us = self.passes[-1].end_us
            if self.scan_end_us > now_us:
                self.passes[-1] = replace(self.passes[-1], end_us=start_us)
        else:
            self.rise_us, self.before = start_us, self.rise
        whole = self.scan = self.whole(scan)
        self.rise = self.before.after(whole, self._strength(whole), self.rise_us)
        self.coming = scan, start_us, scan.times
        self.advance(now_us)

    def allowed(self, start_us, scan=None):
        rise = self.rise
        if scan is not None and scan.goes_on:
            rise, start_us = self.before, self.rise_us
        if not self.ramp:
            return FULL
        return min(FULL, rise.risen(start_us)[0] + 150_000 * FULL // rise.ramp_us + 2)

    def refusal(self, scan, now_us):
        """Return (rule, slot, electrode, value, allowed value) if a rule is broken, or None."""
        start_us, before = self.start_us(now_us, scan), self.scan
        if scan.goes_on and not (
            before is not None
            and before.more
            and (before.period_us, before.intensity) == (scan.period_us, scan.intensity)
        ):
            return Rule.PART, NOTHING, NOTHING, 0, 0
        whole = self.whole(scan)
        found = self._times(scan, whole) or self._slots(scan) or self._recharge(scan)
        if found:
            return found
        one, every = self._pass(scan, start_us), self._pass(whole, start_us)
        burst_us = min(scan.period_us, 40_000)
        return (
            _above(Rule.MEAN, every.charge_pc, 500 * burst_us)
            or _above(Rule.FELT, every.felt, 1500 * burst_us // 1_000_000)
            or self._intensity(whole, self.allowed(start_us, scan))
            or self._over_time(scan, one, start_us, now_us)
        )

    def _times(self, scan, whole):
        limits = self.limits
        if scan.period_us < limits.period_us:
            return Rule.PERIOD, NOTHING, NOTHING, scan.period_us, limits.period_us
        for slot, (width, rest, _) in enumerate(scan.slots):
            if not 0 < width <= limits.width_us:
                return Rule.WIDTH, slot, NOTHING, width, limits.width_us
            if rest < 20:
                return Rule.DISCHARGE, slot, NOTHING, rest, 20
        busy_us = whole.busy_us + 20 * bool(scan.recharge_ua)
        if busy_us > scan.period_us:
            return Rule.FIT, NOTHING, NOTHING, busy_us, scan.period_us
        on_us = sum(width for width, _, _ in whole.slots) + scan.recharge_us
        allowed = limits.duty * scan.period_us
        return (
            (Rule.DUTY, NOTHING, NOTHING, on_us, allowed // 100) if 100 * on_us > allowed else None
        )

    def _slots(self, scan):
        limits = self.limits
        for slot, ((width, _, _), row) in enumerate(zip(scan.slots, scan.nominal(), strict=True)):
            each, source = np.abs(row), scan.source_ua
            if not source and row.sum():
                return Rule.BALANCE, slot, NOTHING, int(row.sum()), 0
            if found := _above(Rule.CURRENT, each, limits.current_ua, slot):
                return found
            total = source or int(each.sum()) // 2
            if total > limits.total_ua:
                return Rule.TOTAL, slot, NOTHING, total, limits.total_ua
            # If only one electrode of a pole touches the skin, it carries the whole current.
            carried = np.where(each > 0, source, 0) if source else each
            if found := _above(Rule.CHARGE, carried * width, limits.charge_pc, slot):
                return found
        return None

    def _recharge(self, scan):
        if not scan.recharge_ua:
            return None
        back, width = np.array(scan.recharge_ua, np.int64), scan.recharge_us
        if not scan.slots or not 0 < width <= 20_000:
            return Rule.RECHARGE, NOTHING, NOTHING, width, 20_000
        if back.sum():
            return Rule.BALANCE, NOTHING, NOTHING, int(back.sum()), 0
        most = np.minimum(min(500, 2_000_000 // width), self.limits.current_ua)
        if found := _above(Rule.CURRENT, np.abs(back), most):
            return found
        if (total := int(np.abs(back).sum()) // 2) > self.limits.total_ua:
            return Rule.TOTAL, NOTHING, NOTHING, total, self.limits.total_ua
        slots_pc = self._pass(scan, 0).net_pc - back * width
        for before in (0, scan.times - 1):
            carried = self.net_pc + slots_pc + before * (slots_pc + back * width)
            allowed = np.maximum(np.abs(carried), 2_000_000)
            if found := _above(Rule.RECHARGE, np.abs(carried + back * width), allowed):
                return found
        return None

    def _intensity(self, scan, risen):
        limits, each = self.limits, np.abs(scan.nominal())
        peak_ua = int(each.max(initial=0))
        most_ua = limits.full_ua * scan.intensity // FULL + limits.rounding_ua
        if peak_ua > most_ua:
            return Rule.INTENSITY, NOTHING, NOTHING, peak_ua, most_ua
        if (strength := self._strength(scan)) > risen:
            return Rule.RISE, NOTHING, NOTHING, strength, risen
        return None

    def _over_time(self, scan, one, start_us, now_us):
        many = min(scan.times, -(-_SECOND_US // scan.period_us))
        most = np.zeros((3, self.electrodes), np.int64)
        often = 0
        for index in range(many):
            at_us = start_us + index * scan.period_us
            felt, charge, net = self._window(at_us, now_us)
            own = np.repeat(one.net_pc[None], index + 1, axis=0)
            felt_in = felt.sum(axis=0) + (index + 1) * one.felt
            charge_in = charge.sum(axis=0) + (index + 1) * one.charge_pc
            most = np.maximum(most, (felt_in, charge_in, self._net(net, own)))
            starts = sum(each >= at_us - _SECOND_US for each in self.starts)
            often = max(often, starts + index + 1)
        if not scan.slots:
            most[:] = 0
        allowed = (1500, 500_000_000, 50_000_000)
        for rule, value, limit in zip(list(Rule)[21:24], most, allowed, strict=True):
            if found := _above(rule, value, limit):
                return found
        most_starts = -(-_SECOND_US // self.limits.period_us) + 1
        if often > most_starts and not scan.goes_on:
            return Rule.OFTEN, NOTHING, NOTHING, often, most_starts
        flowing_us = self.flowing_us + scan.times * scan.period_us * (not scan.goes_on)
        if scan.slots and flowing_us > _SECOND_US * self.limits.session_s:
            seconds = -(-flowing_us // _SECOND_US)
            return Rule.SESSION_TIME, NOTHING, NOTHING, seconds, self.limits.session_s
        charge = -(-(self.session_pc + scan.times * one.charge_pc) // 1_000_000)
        return _above(Rule.SESSION_CHARGE, charge, self.limits.session_uc)

    def _window(self, at_us, now_us):
        """Return felt pulses, charge and net charge, (P, E), of all passes in a window of time."""
        kept = [
            each
            for each in self.passes
            if each.flows
            and (_bucket(each.over_us) >= _bucket(at_us) - 20
                 or (now_us is not None and each.end_us > now_us))
        ]  # fmt: skip
        shape = len(kept), self.electrodes
        columns = ("felt", "charge_pc", "net_pc")
        return [np.array([getattr(each, name) for each in kept]).reshape(shape) for name in columns]

    def _net(self, before, own):
        """Return the largest net charge, (E,) pC, that the last 1, 2, 3, … passes add up to."""
        passes = np.concatenate([before, own])
        return np.abs(passes[::-1].cumsum(axis=0)).max(axis=0)

    def _pass(self, scan, start_us):
        rows = scan.nominal().reshape(-1, self.electrodes)
        width = np.array([width for width, _, _ in scan.slots], np.int64)
        back = np.array(scan.recharge_ua or (0,) * self.electrodes, np.int64) * scan.recharge_us
        felt = ((np.abs(rows) >= self.limits.felt_ua) & (rows != 0)).sum(axis=0)
        return _Pass(
            start_us, start_us + scan.busy_us, start_us + scan.period_us, felt,
            width @ np.abs(rows) + np.abs(back), width @ rows + back, bool(scan.slots),
        )  # fmt: skip

    def _strength(self, scan):
        """Return the strength of a scan (see PROTOCOL.md, Rise), from its strongest pulse."""
        widths = [width for width, _, _ in scan.slots]
        peak_pc = max(
            (int(np.abs(row).max()) * width
             for row, width in zip(scan.nominal(), widths, strict=True)),
            default=0,
        )  # fmt: skip
        whole_pc = self.limits.full_ua * self.limits.usual_us
        if peak_pc >= whole_pc:
            return FULL if peak_pc else 0
        part = -(-FULL * peak_pc // whole_pc)
        return max(part, min(scan.intensity, 4 * part))
