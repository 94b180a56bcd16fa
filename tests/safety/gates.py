"""The gate under test, and what is wrong with its copies."""

from dataclasses import dataclass

import numpy as np

from smarttouch.base.errors import SafetyError
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

_NUMBERS = {"period_us": int, "time_ns": int, "intensity": float}
_ARRAYS = ("current_ua", "width_us", "discharge_us", "site", "vibration", "recharge_ua")


@dataclass
class ManualClock:
    """A clock that stands where it is put."""

    time_ns: int = 0

    def now_ns(self):
        return self.time_ns


@dataclass(frozen=True)
class Answer:
    """Answer of a gate: its copy or nothing, the limit that it named, and no error but its own."""

    accepted: bool
    copy: ScanSequence | None = None
    limit: str = ""
    crash: str = ""


class GateUnderTest:
    """A safety gate with a clock that the test sets."""

    def __init__(self, profile):
        self.clock = ManualClock()
        self._gate = SafetyGate(SafetyLimits.of(profile), self.clock)

    def ask(self, sequence, clock_ns, times=1, written=True):
        """Return what the gate says of a sequence at a time of its clock, and whether it permits
        what it proved; it is written then, unless a newer one replaces it.
        """
        self.clock.time_ns = clock_ns
        try:
            proved = self._gate.prove(sequence, times)
            if not self._gate.ramp.permits(proved.strength_ppb, proved.sequence.time_ns):
                return Answer(False, crash="what was proved is not permitted")
            if written:
                self._gate.note(proved)
            return Answer(True, proved.sequence)
        except SafetyError as error:
            return Answer(False, limit=error.limit)
        except Exception as error:
            # A gate that breaks lets nothing through, yet owes one clear sentence.
            return Answer(False, crash=f"{type(error).__name__}: {error}"[:80])


def faults_of_copy(copy, sequence):
    """Return the fields of a gate's copy of other types or numbers, or that can be written."""
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
    """Return whether an array has the numbers of another, and nobody can make it writable."""
    if type(ours) is not np.ndarray or ours.dtype != theirs.dtype or ours.flags.writeable:
        return False
    try:
        ours.setflags(write=True)
    except ValueError:
        return np.array_equal(ours, theirs)
    return False
