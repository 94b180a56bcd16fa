"""Sums that a ``link`` board keeps between sequences, its room, and the sequence at hand.

The sums are of the last second, the session and the rise, all on the board's own clock, in whole
microseconds and pC.
"""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.link.protocol import Rule
from smarttouch.emulator.link_packets import ReceivedSequence
from smarttouch.emulator.link_rules import (
    FULL,
    MAX_PULSES_HZ,
    MAX_SLOTS,
    BrokenRule,
    Load,
    SessionLimits,
    first_above,
)

BUCKET_US = 50_000
BUCKETS = 20  # whole buckets before the one at hand: a second, and up to a twentieth of one more
SECOND_US = 1_000_000
MOST_CHARGE_PC = 500_000_000
MOST_NET_PC = 50_000_000
RAMP_MS = 500  # least time from zero to full
CATCH_UP_US = 150_000  # time by which a rise may be ahead of that, as packets may be late
KEPT_US = 15_000_000  # time without current after which a level is closed
_LEEWAY = 2  # of an intensity in 1/65,535, for its rounding


class LastSecond:
    """Passes of the last second, and the dose of the session.

    ``most_net_pc`` is the largest net charge of an electrode within a second, of all passes that
    have begun; ``net_pc``, (E,) int64, that of the session, positive cathodic.
    """

    def __init__(self, electrodes: int) -> None:
        self._over: deque[tuple[int, Load]] = deque()  # bucket and load of each pass that is over
        self._running: Load | None = None
        self._starts_us: deque[int] = deque()
        self._electrodes = electrodes
        self.most_net_pc: int = 0
        self.begin_session()

    def begin_session(self) -> None:
        """Reset the dose of the session; the last second still counts."""
        self.session_us: int = 0
        self.session_pc: NDArray[np.int64] = np.zeros(self._electrodes, np.int64)
        self.net_pc: NDArray[np.int64] = np.zeros(self._electrodes, np.int64)

    def begin(self, start_us: int, period_us: int, load: Load | None, goes_on: bool) -> None:
        """Enter a pass that begins; without a load it has no slots. Start and time of a scan are
        those of its first part."""
        if not goes_on:
            self._starts_us.append(start_us)
            self.session_us += period_us * (load is not None)
        while self._starts_us and self._starts_us[0] < start_us - SECOND_US:
            self._starts_us.popleft()
        if load is None:
            return
        while self._over and self._over[0][0] < start_us // BUCKET_US - BUCKETS:
            self._over.popleft()
        nets_pc = np.abs(self._nets(start_us) + load.net_pc)
        self.most_net_pc = max(self.most_net_pc, int(nets_pc.max()))
        self._running = load
        self.session_pc += load.charge_pc
        self.net_pc += load.net_pc

    def end(self, end_us: int) -> None:
        """Take the pass that executes as over since a time."""
        if self._running is not None:
            self._over.append((end_us // BUCKET_US, self._running))
            self._running = None

    def _in_window(self, start_us: int) -> list[Load]:
        first = start_us // BUCKET_US - BUCKETS
        loads = [load for bucket, load in self._over if bucket >= first]
        return loads if self._running is None else [*loads, self._running]

    def _nets(self, start_us: int) -> NDArray[np.int64]:
        """Return the net charge of each run of passes up to now, (N + 1, E); none comes first."""
        nets = [load.net_pc for load in reversed(self._in_window(start_us))]
        return np.cumsum([np.zeros(self._electrodes, np.int64), *nets], axis=0)

    def complaint(
        self, start_us: int, sequence: ReceivedSequence, load: Load | None, limits: SessionLimits
    ) -> BrokenRule | None:
        """Return the first rule that a sequence whose first pass begins at ``start_us`` breaks with
        what was before it, if any."""
        period_us, times, found = sequence.period_us, sequence.times, None
        starts_us = range(start_us, start_us + min(times * period_us, SECOND_US), period_us)
        if load is not None:
            found = self._second(starts_us, load)
        if not sequence.goes_on:
            most = max(
                own + sum(each >= at_us - SECOND_US for each in self._starts_us)
                for own, at_us in enumerate(starts_us, 1)
            )
            found = found or first_above(Rule.OFTEN, most, -(-SECOND_US // limits.period_us) + 1)
        if load is None or found is not None:
            return found
        session_us = self.session_us + times * period_us * (not sequence.goes_on)
        session_uc = -(-(self.session_pc + times * load.charge_pc) // 10**6)
        return first_above(
            Rule.SESSION_TIME, -(-session_us // 10**6), limits.session_s
        ) or first_above(Rule.SESSION_CHARGE, session_uc, limits.session_uc)

    def _second(self, starts_us: range, load: Load) -> BrokenRule | None:
        felt, charge_pc, net_pc = np.zeros((3, self._electrodes), np.int64)
        for own, at_us in enumerate(starts_us, 1):
            every = sum(self._in_window(at_us), Load.none(self._electrodes))
            felt = np.maximum(felt, every.felt + own * load.felt)
            charge_pc = np.maximum(charge_pc, every.charge_pc + own * load.charge_pc)
            nets_pc = np.abs(self._nets(at_us) + own * load.net_pc)
            net_pc = np.maximum(net_pc, nets_pc.max(axis=0))
        return (
            first_above(Rule.FELT_IN_SECOND, felt, MAX_PULSES_HZ)
            or first_above(Rule.CHARGE_IN_SECOND, charge_pc, MOST_CHARGE_PC)
            or first_above(Rule.NET_IN_SECOND, net_pc, MOST_NET_PC)
        )


class Ramp:
    """Rise of intensity by delivered current, and no higher than its strength.

    ``ramp_ms`` is the least time from zero to full; 0 for tests whose time is what they claim.
    """

    def __init__(self, ramp_ms: int = RAMP_MS) -> None:
        self._own_ms = ramp_ms
        self.restart(ramp_ms)

    def restart(self, ramp_ms: int) -> None:
        """Begin at zero, with at least so long a ramp."""
        self._ramp_us = 1000 * max(self._own_ms, ramp_ms) if self._own_ms else 0
        self._level = self._strength = self._since_us = self._span_us = 0

    def _on_us(self, now_us: int) -> int:
        """Return for how long current has flowed since the last sequence."""
        return max(0, min(now_us - self._since_us, self._span_us))

    def _risen(self, now_us: int) -> int:
        on_us = self._on_us(now_us)
        if now_us - self._since_us - on_us > KEPT_US:
            return 0
        return max(self._level, min(self._strength, self._level + on_us * FULL // self._ramp_us))

    def allowed(self, now_us: int) -> int:
        """Return the largest strength that may begin at a time."""
        if not self._ramp_us:
            return FULL
        ahead = CATCH_UP_US * FULL // self._ramp_us
        return min(FULL, self._risen(now_us) + ahead + _LEEWAY)

    def note(self, intensity: int, strength: int, now_us: int, span_us: int) -> None:
        """Record a sequence that begins at a time, and for how long its current flows."""
        if not self._ramp_us:
            return
        risen, on_us = self._risen(now_us), self._on_us(now_us)
        if span_us:
            self._level, self._since_us = min(intensity, risen), now_us
            self._strength = strength
        else:
            self._level, self._since_us = risen, self._since_us + on_us
        self._span_us = span_us


@dataclass(frozen=True)
class Room:
    """What a board has room for: a small one gets a scan in parts."""

    slots: int = MAX_SLOTS
    packet_bytes: int = 1 << 20
    kernel_bytes: int = 1 << 23
    kernels: int = 4096


@dataclass
class ScanSoFar:
    """Parts of a scan that were accepted: to the rules they are one sequence with those to come."""

    last: ReceivedSequence  # the last of these parts
    rise_us: int  # when it was to begin, on the skin
    rise: Ramp  # as it was before the scan
    load: Load

    def goes_on_in(self, part: ReceivedSequence) -> bool:
        same = (self.last.period_us, self.last.intensity) == (part.period_us, part.intensity)
        return self.last.more and same


@dataclass
class SequenceAtHand:
    """Sequence that executes, or waits to."""

    number: int
    sequence: ReceivedSequence
    load: Load | None  # of a pass; None without slots
    left: int  # number of remaining scans, with the current one
    came_ns: int = 0
    starts_ns: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    over_ns: int = 0  # end of the last slot or recharge phase of the pass at hand
    end_ns: int = 0
    done: int = 0
    volts: list[float] = field(default_factory=list)
    recharge_ns: int | None = None  # start of its recharge phase, until that has been recorded

    def begin(self, start_ns: int, scan_end_ns: int) -> None:
        """Begin a pass; that of a scan's further part ends when the scan does."""
        sequence = self.sequence
        lengths = sequence.width_us + sequence.discharge_us
        self.done = 0
        self.starts_ns = start_ns + 1000 * (np.cumsum(lengths) - lengths)
        slots_end_ns = start_ns + 1000 * int(lengths.sum())
        self.over_ns = slots_end_ns + 1000 * sequence.recharge_us
        self.end_ns = start_ns + 1000 * sequence.period_us
        if sequence.goes_on:
            self.end_ns = max(scan_end_ns, self.over_ns)
        self.recharge_ns = None if sequence.recharge_ua is None else slots_end_ns
        self.volts.clear()
