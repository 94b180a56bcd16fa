"""Oracle, which proves the sequences of a display a second time.

It shares no code with the safety gate, so that each reveals mistakes of the other.
"""

from dataclasses import dataclass

import numpy as np

from .bounds import (
    FREE_RISE,
    LATE_NS,
    LEVEL_KEPT_NS,
    MEAN_UA,
    NET_PC,
    NS,
    STRONG_A_SECOND,
    WHOLE,
    Bounds,
)
from .quick import RULES, judge_alone

AMONG = (
    "time", "ramp", "reduces charge", "sequences in a second",
    "strong in a second", "mean in a second", "net in a second", "session time", "session charge",
)  # fmt: skip
"""Names of the rules that depend on earlier sequences. Rules with "in a second" limit the number of
passes, the number of perceptible (strong) pulses, the mean current, and the net charge."""
NAMES = ("types", "range", *RULES, *AMONG)


@dataclass
class Pass:
    """Pass of a sequence, from its start to the end of its slots and its recharge phase."""

    start_ns: int
    end_ns: int
    strong: np.ndarray
    charge_pc: np.ndarray
    net_pc: np.ndarray


@dataclass
class Sent:
    """Accepted sequence with its repetitions; the first pass begins at ``start_ns``."""

    start_ns: int
    period_us: int
    times: int
    alone: object

    def begun(self, clock_ns):
        """Return the number of passes begun by a time: at least 1, as nothing cancels the first."""
        later = (clock_ns - self.start_ns) // (1000 * self.period_us)
        return max(1, min(self.times, 1 + later))

    def passes(self, first, stop):
        """Return the passes from index ``first`` to before ``stop``."""
        alone, made = self.alone, []
        net_pc = alone.slots_pc + alone.recharge_pc
        for index in range(first, stop):
            start_ns = self.start_ns + 1000 * index * self.period_us
            end_ns = start_ns + 1000 * alone.busy_us
            made.append(Pass(start_ns, end_ns, alone.strong, alone.charge_pc, net_pc))
        return made


class Level:
    """Level of the ramp, in parts per billion, on one clock.

    The level rises only while current flows, and at most to the strength of the sent sequence.
    """

    def __init__(self, bounds):
        self._bounds = bounds
        self.close()

    def close(self):
        """Reset the level to zero, as if no current had flowed."""
        self._ppb, self._strong_ppb, self._from_ns, self._current_ns = 0, 0, None, 0
        self.begun = False

    def at(self, time_ns):
        """Return the level at a time."""
        if self._from_ns is None or time_ns - self._from_ns > self._current_ns + LEVEL_KEPT_NS:
            return 0
        counted_ns = min(max(time_ns - self._from_ns, 0), self._current_ns)
        by_time = self._ppb + counted_ns * WHOLE // self._bounds.ramp_ns
        return by_time if by_time < self._strong_ppb else max(self._ppb, self._strong_ppb)

    def most(self, time_ns):
        """Return the largest strength that a sequence at ``time_ns`` may have. For the first
        sequence it is 0, plus the tolerance for rounding errors."""
        if not self.begun:
            return FREE_RISE
        return self.at(time_ns) + FREE_RISE + self._bounds.late_rise

    def sent(self, ppb, strong_ppb, time_ns, current_ns):
        """Record a sequence that was written at ``time_ns`` and has current for ``current_ns``."""
        if self._from_ns is None and not current_ns:
            return
        ahead_ns = 0
        if self._from_ns is not None:
            passed_ns = max(time_ns - self._from_ns, 0)
            # The board drops repetitions, but finishes its pass. Count at most `LATE_NS` of it.
            ahead_ns = min(max(self._current_ns - passed_ns, 0), LATE_NS)
        if current_ns:
            self._ppb, self._strong_ppb = min(ppb, self.at(time_ns)), strong_ppb
            self._from_ns, self._current_ns = time_ns, ahead_ns + current_ns
        else:
            self._current_ns = min(self._current_ns, passed_ns + ahead_ns)


class Oracle:
    """Check of all sequences for one display, from its opening to its closing.

    ``time_ns`` is the time stated in the last accepted sequence. ``clock_ns`` is the time of the
    display's clock when that sequence was sent.
    """

    def __init__(self, profile):
        self.bounds = profile if isinstance(profile, Bounds) else Bounds.of(profile)
        self._last = None
        nothing = np.zeros(self.bounds.electrodes, np.int64)
        self._spent = 0, nothing, nothing
        self._level = Level(self.bounds)
        self.restart()

    def restart(self, clock_ns=0):
        """Restart at zero, as after a restart of the board; the dose of the session remains."""
        if self._last is not None:
            self._spent = self._spent_by(max(clock_ns, self.clock_ns))
            self._last = None
        self._passes = []
        self.time_ns = self.clock_ns = None
        self.newest = None
        """Intensity and strength of the last accepted sequence, and duration of its current, ns."""
        self._level.close()

    def judge(self, sequence, clock_ns, times=1, written=True):
        """Return the names of all rules that a sequence with ``times`` passes breaks if it is sent
        at ``clock_ns``. A sequence that breaks no rule counts as sent. It also counts as written
        if ``written``; otherwise call `wrote` when it is written.
        """
        alone = judge_alone(sequence, self.bounds)
        if isinstance(times, bool) or not isinstance(times, int | np.integer):
            return ["types"]
        if alone.broken and alone.broken[0] in ("types", "range"):
            return alone.broken
        clock_ns = clock_ns if self.clock_ns is None else max(clock_ns, self.clock_ns)
        known = self.passes_by(clock_ns)
        new = Sent(self._free_from(clock_ns), alone.period_us, times, alone)
        spent_us, spent_pc, carried_pc = self._spent_by(clock_ns)
        strong_ppb = self.bounds.strength_ppb(alone.intensity_ppb, alone.peak_pc)
        kept = {
            "time": self.time_ns is None or alone.time_ns > self.time_ns,
            "ramp": alone.peak_pc == 0 or strong_ppb <= self.most(clock_ns),
            "reduces charge": self._reduces_net_charge(alone, carried_pc, times),
            "sequences in a second": 1 + sum(each.start_ns > clock_ns - NS for each in known)
            <= self.bounds.most_passes,
            **self._seconds(new, known, clock_ns),
            "session time": spent_us + times * alone.period_us * (alone.slots > 0)
            <= self.bounds.session_us,
            "session charge": int((spent_pc + times * alone.charge_pc).max())
            <= self.bounds.session_pc,
        }
        broken = alone.broken + [name for name, keeps in kept.items() if not keeps]
        if not broken:
            self._spent, self._passes, self._last = (spent_us, spent_pc, carried_pc), known, new
            self.clock_ns = clock_ns
            self.time_ns = alone.time_ns
            self._level.begun = True
            current_ns = 1000 * times * alone.period_us * (alone.peak_pc > 0)
            self.newest = alone.intensity_ppb, strong_ppb, current_ns
            if written:
                self.wrote(self.newest, clock_ns)
        return broken

    def wrote(self, sent, clock_ns):
        """Record that a sequence was written; ``sent`` is the `newest` that `judge` set for it."""
        clock_ns = max(clock_ns, self.clock_ns or 0)
        ppb, strong_ppb, current_ns = sent
        self._level.sent(ppb, strong_ppb, clock_ns, current_ns)

    def most(self, clock_ns):
        """Return the largest strength that a sequence at ``clock_ns`` may have, ppb."""
        return self._level.most(clock_ns)

    def passes_by(self, clock_ns):
        """Return all passes that run at ``clock_ns`` or ended less than a second before it."""
        passes = list(self._passes)
        if self._last is not None:
            begun = self._last.begun(clock_ns)
            older = (clock_ns - NS - self._last.start_ns) // (1000 * self._last.period_us) - 1
            passes += self._last.passes(max(0, min(older, begun)), begun)
        return [each for each in passes if each.end_ns > clock_ns - NS]

    def in_the_second_before(self, clock_ns):
        """Return two arrays over electrodes for the second before a time: the number of
        perceptible pulses, and the charge, pC."""
        return self._sums(self.passes_by(clock_ns))

    def most_net_before(self, clock_ns):
        """Return the largest and smallest net charge, pC, over the last 0, 1, 2, … passes."""
        high = low = sums = np.zeros(self.bounds.electrodes, np.int64)
        for each in reversed(self.passes_by(clock_ns)):
            sums = sums + each.net_pc
            high, low = np.maximum(high, sums), np.minimum(low, sums)
        return high, low

    def session_left(self, clock_ns):
        """Return the time, µs, and the charge of electrodes, pC, that the session still allows."""
        spent_us, spent_pc, _ = self._spent_by(clock_ns)
        return self.bounds.session_us - spent_us, self.bounds.session_pc - spent_pc

    def carried(self, clock_ns):
        """Return the net charge of each electrode in the session, pC."""
        return self._spent_by(clock_ns)[2]

    def _sums(self, passes):
        nothing = np.zeros(self.bounds.electrodes, np.int64)
        return (
            sum((each.strong for each in passes), nothing),
            sum((each.charge_pc for each in passes), nothing),
        )

    def _free_from(self, clock_ns):
        """Return the earliest start of a new sequence: after the running pass."""
        if self._last is None:
            return clock_ns
        over_ns = self._last.start_ns + 1000 * self._last.begun(clock_ns) * self._last.period_us
        return max(clock_ns, over_ns)

    def _reduces_net_charge(self, alone, carried_pc, times):
        """Return whether all recharge phases only reduce the net charge of each electrode."""
        if not np.any(alone.recharge_pc):
            return True
        net_pc = alone.slots_pc + alone.recharge_pc
        for done in {0, times - 1}:
            before_pc = carried_pc + done * net_pc + alone.slots_pc
            back = alone.recharge_pc
            opposite = np.sign(back) == -np.sign(before_pc)
            if not ((back == 0) | (opposite & (np.abs(back) <= np.abs(before_pc)))).all():
                return False
        return True

    def _seconds(self, new, known, clock_ns):
        """Return, for each rule over one second, whether new passes keep it in each second.

        The check ends one second after the end of the first new pass: sums no longer grow."""
        alone = new.alone
        net_pc = alone.slots_pc + alone.recharge_pc
        strong, charge_pc = self._sums(known)
        newest_pc = np.cumsum([0 * net_pc, *(each.net_pc for each in reversed(known))], axis=0)
        keeps = {"strong in a second": True, "mean in a second": True, "net in a second": True}
        dropped, end_ns = 0, new.start_ns + 1000 * alone.busy_us
        for index in range(new.times):
            at_ns = clock_ns if index == 0 else new.start_ns + 1000 * index * new.period_us
            if index and end_ns <= at_ns - NS:
                break
            while dropped < len(known) and known[dropped].end_ns <= at_ns - NS:
                strong = strong - known[dropped].strong
                charge_pc = charge_pc - known[dropped].charge_pc
                dropped += 1
            own = index + 1
            if int((strong + own * alone.strong).max()) > STRONG_A_SECOND:
                keeps["strong in a second"] = False
            if int((charge_pc + own * alone.charge_pc).max()) > MEAN_UA * 10**6:
                keeps["mean in a second"] = False
            if np.abs(newest_pc[: len(known) - dropped + 1] + own * net_pc).max() > NET_PC:
                keeps["net in a second"] = False
        return keeps

    def _spent_by(self, clock_ns):
        """Return time, charge and net charge of all passes that the session began by a time."""
        if self._last is None:
            return self._spent
        spent_us, spent_pc, net_pc = self._spent
        alone, begun = self._last.alone, self._last.begun(clock_ns)
        return (
            spent_us + begun * self._last.period_us * (alone.slots > 0),
            spent_pc + begun * alone.charge_pc,
            net_pc + begun * (alone.slots_pc + alone.recharge_pc),
        )
