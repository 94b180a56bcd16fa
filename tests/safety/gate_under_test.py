"""Safety gate under test, and a check of the copies that it returns."""

from dataclasses import dataclass

import numpy as np

from smarttouch.base.errors import SafetyError
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

_NUMBERS = {"period_us": int, "time_ns": int, "intensity": float}
_ARRAYS = ("current_ua", "width_us", "discharge_us", "site", "vibration", "recharge_ua")


@dataclass
class ManualClock:
    """Clock whose time a test sets."""

    time_ns: int = 0

    def now_ns(self):
        return self.time_ns


@dataclass(frozen=True)
class Answer:
    """Answer of a gate: a frozen copy, the name of the broken limit, or an unexpected error."""

    accepted: bool
    copy: ScanSequence | None = None
    limit: str = ""
    crash: str = ""


class GateUnderTest:
    """Safety gate with a clock that the test sets."""

    def __init__(self, profile):
        self.clock = ManualClock()
        self._gate = SafetyGate(SafetyLimits.of(profile), self.clock)

    def ask(self, sequence, clock_ns, times=1, written=True):
        """Set the clock to ``clock_ns``, let the gate prove a sequence, and return the answer.

        If ``written``, the gate records that the accepted sequence was written."""
        self.clock.time_ns = clock_ns
        try:
            proved = self._gate.prove(sequence, times)
            if not self._gate.ramp.permits(proved.strength_ppb, proved.sequence.time_ns):
                return Answer(False, crash="the ramp does not permit the proved sequence")
            if written:
                self._gate.note(proved)
            return Answer(True, proved.sequence)
        except SafetyError as error:
            return Answer(False, limit=error.limit)
        except Exception as error:
            # Report other errors, because refusals must be a SafetyError with a clear message.
            return Answer(False, crash=f"{type(error).__name__}: {error}"[:80])


def faults_of_copy(copy, sequence):
    """Return the fields of a gate's copy that are writable or differ in type or value."""
    faults = [
        name
        for name, kind in _NUMBERS.items()
        if type(getattr(copy, name)) is not kind
        or getattr(copy, name) != kind(getattr(sequence, name))
    ]
    for name in _ARRAYS:
        ours, theirs = getattr(copy, name), getattr(sequence, name)
        if (ours is not None or theirs is not None) and not _is_frozen_copy(ours, theirs):
            faults.append(name)
    return faults


def _is_frozen_copy(ours, theirs):
    """Return whether an array equals the original and cannot be made writable."""
    if type(ours) is not np.ndarray or ours.dtype != theirs.dtype or ours.flags.writeable:
        return False
    try:
        ours.setflags(write=True)
    except ValueError:
        return np.array_equal(ours, theirs)
    return False
