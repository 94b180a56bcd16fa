"""The gate under test, and the oracle beside it."""

from dataclasses import dataclass

import numpy as np

from smarttouch.base.errors import SafetyError
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

_FIELDS = ("current_ua", "width_us", "discharge_us", "site", "vibration", "recharge_ua")


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
        limits = SafetyLimits.of(profile)
        self._gate = SafetyGate(limits, self.clock)

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
    """Return what is wrong with a gate's copy of a sequence: other numbers, or not for good."""
    if type(copy) is not ScanSequence:
        return [f"a {type(copy).__name__}"]
    faults = [
        f"{name} is a {type(getattr(copy, name)).__name__}"
        for name, kind in (("period_us", int), ("time_ns", int), ("intensity", float))
        if type(getattr(copy, name)) is not kind
    ]
    for name, kind in (("period_us", int), ("time_ns", int), ("intensity", float)):
        if getattr(copy, name) != kind(getattr(sequence, name)):
            faults.append(f"{name} is another")
    for name in _FIELDS:
        ours, theirs = getattr(copy, name, None), getattr(sequence, name, None)
        if ours is None and theirs is None:
            continue
        if type(ours) is not np.ndarray:
            faults.append(f"{name} is a {type(ours).__name__}")
        elif not _is_for_good(ours):
            faults.append(f"{name} can be written")
        elif theirs is not None and ours.dtype != theirs.dtype:
            faults.append(f"{name} is of another type")
        elif not np.array_equal(ours, theirs):
            faults.append(f"{name} has other numbers")
    return faults


def _is_for_good(array):
    """Return whether nobody can make an array writable again."""
    if array.flags.writeable:
        return False
    try:
        array.setflags(write=True)
    except ValueError:
        return True
    return False
