"""The judge of a display's sequences: by itself, and from one to the next.

It shares no line with what proves sequences safe, so that each finds the other's mistakes.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

from .bounds import FREE_RISE, MEAN_UA, NS, STRONG_A_SECOND, WHOLE, Bounds
from .rules import RULES, judge_alone

AMONG = (
    "time",
    "claimed rise",
    "rise",
    "strong in a second",
    "mean in a second",
    "session time",
    "session charge",
)
"""The limits from one sequence to the next, by name."""
NAMES = ("types", "range", *RULES, *AMONG)
RAMPED = ("claimed rise", "rise")
"""What a measuring scan that a firmware fixes need not keep."""


@dataclass
class StepResult:
    """A sequence that was accepted, with its repetitions.

    ``ended_ns`` is when a newer one was accepted; None until then.
    """

    clock_ns: int
    period_us: int
    times: int
    drives: bool
    strong: np.ndarray
    charge_pc: np.ndarray
    ended_ns: int | None = None

    @property
    def asked_us(self):
        """Time with current, were none of its repetitions cut short."""
        return self.times * self.period_us * self.drives

    def begun(self, clock_ns):
        """Return how many repetitions had begun by a time."""
        if self.ended_ns is not None:
            clock_ns = min(clock_ns, self.ended_ns)
        if clock_ns < self.clock_ns:
            return 0
        return min(self.times, 1 + (clock_ns - self.clock_ns) // (1000 * self.period_us))


class Oracle:
    """Judges what is sent to one display, from its opening to its closing.

    Parameters
    ----------
    profile : Profile or Bounds
    alone : callable
        The judge of a single sequence; `quick.judge_alone_quickly` for long runs.

    Attributes
    ----------
    time_ns, clock_ns : int or None
        Claimed time and clock of the last sequence that was accepted.
    """

    def __init__(self, profile, alone=judge_alone):
        self.bounds = profile if isinstance(profile, Bounds) else Bounds.of(profile)
        self._alone = alone
        self._last = None
        self._spent_us = 0
        self._spent_pc = np.zeros(self.bounds.electrodes, np.int64)
        self.restart()

    def restart(self, clock_ns=0):
        """Begin anew at zero, as when a board has restarted; the session's dose stays."""
        if self._last is not None:
            self._spent_us, self._spent_pc = self._spent_by(max(clock_ns, self.clock_ns))
            self._last = None
        self._sent = deque()
        self.time_ns = self.clock_ns = None
        self._ppb = self._risen = 0

    def judge(self, sequence, clock_ns, times=1, measuring=False):
        """Judge a sequence that is about to be sent; one that breaks nothing counts as sent.

        Parameters
        ----------
        sequence : ScanSequence
        clock_ns : int
            The display's clock.
        times : int
            How often it is to be repeated.
        measuring : bool
            Whether it is a scan that a firmware fixes.

        Returns
        -------
        list of str
            The names of all rules that it breaks.
        """
        alone = self._alone(sequence, self.bounds)
        if alone.broken and alone.broken[0] in ("types", "range"):
            return alone.broken
        clock_ns = clock_ns if self.clock_ns is None else max(clock_ns, self.clock_ns)
        new = StepResult(
            clock_ns,
            alone.period_us,
            times,
            alone.slots > 0,
            np.asarray(alone.strong, np.int64),
            np.asarray(alone.charge_pc, np.int64),
        )
        strong, second_pc = self.in_the_second_before(clock_ns)
        spent_us, spent_pc = self._spent_by(clock_ns)
        kept = {
            "time": self.time_ns is None or alone.time_ns > self.time_ns,
            "claimed rise": alone.intensity_ppb <= self.most_as_claimed(alone.time_ns),
            "rise": alone.intensity_ppb <= self.most_by_clock(clock_ns),
            "strong in a second": int((strong + new.strong).max()) <= STRONG_A_SECOND,
            "mean in a second": int((second_pc + new.charge_pc).max()) <= MEAN_UA * 10**6,
            "session time": spent_us + new.asked_us <= self.bounds.session_us,
            "session charge": int((spent_pc + times * new.charge_pc).max())
            <= self.bounds.session_pc,
        }
        broken = alone.broken + [
            name for name, keeps in kept.items() if not keeps and not (measuring and name in RAMPED)
        ]
        if not broken:
            risen = self._risen_by(clock_ns)
            if self._last is not None:
                self._last.ended_ns = clock_ns
                self._spent_us, self._spent_pc = spent_us, spent_pc
            while self._sent and self._sent[0].ended_ns <= clock_ns - NS:
                self._sent.popleft()
            if new.drives:
                self._sent.append(new)
            self._last = new
            self.time_ns, self.clock_ns = alone.time_ns, clock_ns
            self._ppb = self._ppb if measuring else alone.intensity_ppb
            self._risen = min(risen, self._ppb)
        return broken

    def most_as_claimed(self, time_ns):
        """Return the highest intensity by the claimed times, in parts per billion."""
        if self.time_ns is None:
            return FREE_RISE
        rise = (time_ns - self.time_ns) * NS // self.bounds.ramp_ns
        return self._ppb + FREE_RISE + rise

    def most_by_clock(self, clock_ns):
        """Return the highest intensity by the display's clock, in parts per billion."""
        return self._risen_by(clock_ns) + FREE_RISE + self.bounds.late_rise

    def in_the_second_before(self, clock_ns):
        """Return each electrode's strong pulses and charge in the second before a time.

        Of sequences that were accepted, repetitions that had begun by then included.
        """
        strong = np.zeros(self.bounds.electrodes, np.int64)
        charge_pc = strong.copy()
        for sent in self._sent:
            if sent.times == 1:
                count = clock_ns - NS < sent.clock_ns <= clock_ns
            else:
                count = sent.begun(clock_ns) - sent.begun(clock_ns - NS)
            if count:
                strong += count * sent.strong
                charge_pc += count * sent.charge_pc
        return strong, charge_pc

    def session_left(self, clock_ns):
        """Return the time with current, µs, and each electrode's charge, pC, that are left."""
        spent_us, spent_pc = self._spent_by(clock_ns)
        return self.bounds.session_us - spent_us, self.bounds.session_pc - spent_pc

    def _risen_by(self, clock_ns):
        """Return how far intensity may have risen by the display's clock."""
        if self.clock_ns is None:
            return 0
        return min(WHOLE, self._risen + (clock_ns - self.clock_ns) * NS // self.bounds.ramp_ns)

    def _spent_by(self, clock_ns):
        """Return the session's time and charge by a time, repetitions begun by then included."""
        if self._last is None or not self._last.drives:
            return self._spent_us, self._spent_pc
        begun = self._last.begun(clock_ns)
        return (
            self._spent_us + begun * self._last.period_us,
            self._spent_pc + begun * self._last.charge_pc,
        )
