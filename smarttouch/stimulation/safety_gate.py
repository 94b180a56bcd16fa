"""The safety gate, which validates every limit on a frozen copy of each scan sequence."""

from dataclasses import InitVar, dataclass, replace
from threading import Lock
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.clock import LATE_NS, Clock
from smarttouch.base.errors import SafetyError
from smarttouch.stimulation.ramp import Ramp
from smarttouch.stimulation.safety_limits import PPB, SafetyLimits, parts_per_billion
from smarttouch.stimulation.scan_sequence import ScanSequence, unwritable
from smarttouch.stimulation.sequence_limits import Dose, Exposure, prove_sequence

__all__ = ["ProvedSequence", "SafetyGate", "SafetyLimits"]

_ARRAYS = (
    ("current_ua", np.dtype(np.int16), 2, True),
    ("width_us", np.dtype(np.uint16), 1, True),
    ("discharge_us", np.dtype(np.uint16), 1, True),
    ("site", np.dtype(np.uint16), 1, True),
    ("vibration", np.dtype(np.float32), 1, False),
    ("recharge_ua", np.dtype(np.int16), 1, False),
)
"""Arrays of a sequence: type, dimensions, and whether they have a row for each slot; the others
may be None."""


_GATE: Final = object()
"""Key with which the gate makes a `ProvedSequence`."""
WAITS_NS = 5_000_000_000
"""Longest wait of a sequence for its turn, beside four of its periods and its repetitions: a kit
that has lost a command takes over 2 s to find the next one."""


@dataclass(frozen=True, eq=False)
class ProvedSequence:
    """Sequence that the gate has proved safe; only the gate can make one.

    Attributes
    ----------
    sequence : ScanSequence
        The frozen copy that was proved.
    times : int
        Number of passes, one period after another, unless a newer sequence comes.
    number : int
        Number of the sequence on its board.
    due_ns, write_before_ns : int
        Planned start, and the time after which it may no longer be written, by the board's clock.
    """

    sequence: ScanSequence
    times: int
    number: int
    due_ns: int
    write_before_ns: int
    session: int
    """Of the gate, in which it was proved."""
    strength_ppb: int = 0
    """By its strongest pulse; see `SafetyLimits.strength_ppb`."""
    key: InitVar[object] = None

    def __post_init__(self, key: object) -> None:
        if key is not _GATE:
            raise SafetyError("only the safety gate can prove a sequence", limit="gate")


class SafetyGate:
    """Validator of successive sequences, on the clock of the display that it guards.

    Parameters
    ----------
    limits : SafetyLimits
        Limits of every sequence.
    clock : Clock, optional
        The display's. Without one, for checks that reach no board, time is what each
        sequence claims.
    """

    def __init__(self, limits: SafetyLimits, clock: Clock | None = None) -> None:
        self.limits: SafetyLimits = limits
        self._clock = clock
        self._exposure = Exposure(limits)
        self._ramp = Ramp(limits.ramp_ns)
        self._lock = Lock()
        self._now_ns: int | None = None
        self._session = 0
        self.restart()

    @property
    def dose(self) -> Dose:
        """Dose of the session."""
        return self._exposure.dose

    @property
    def net_pc(self) -> NDArray[np.int64]:
        """Net charge of each electrode in the session, (E,) pC, positive cathodic."""
        return self._exposure.net_pc

    def restart(self) -> None:
        """Restart the ramp; sequence time may start again at zero, the session continues."""
        self._ramp.restart()
        self._time_ns: int | None = None
        self._noted: ScanSequence | None = None  # the sequence that was written last
        if self._clock is None:
            self._now_ns = None
            self._exposure.forget_second()

    def net_rest_ns(self) -> int:
        """Return how long a new session must wait: see `Exposure.net_rest_ns`."""
        with self._lock:
            return 0 if self._clock is None else self._exposure.net_rest_ns(self._clock.now_ns())

    def begin_session(self) -> None:
        """Start at intensity zero with a dose of zero; the last second still counts."""
        now_ns = None if self._clock is None else self._clock.now_ns()
        self._exposure.begin_session(now_ns)
        self._session += 1
        self.restart()

    def allowed_level(self, time_ns: int) -> float:
        """Return the strength, in [0, 1], to plan for a sequence that claims a time."""
        with self._lock:
            return self._ramp.allowed_level(self._time_of(time_ns))

    def open_level(self, time_ns: int) -> float:
        """Return the strength, in [0, 1], with which pulses may go on after a pause."""
        with self._lock:
            return self._ramp.open_level(self._time_of(time_ns))

    def prove(
        self,
        sequence: ScanSequence,
        times: int = 1,
        *,
        number: int = 0,
        due_ns: int = 0,
        late_ns: int = LATE_NS,
    ) -> ProvedSequence:
        """Return a frozen copy of a sequence for its board, or raise if it breaks a limit.

        Parameters
        ----------
        sequence : ScanSequence
        times : int
            Number of passes.
        number : int
            Of the sequence on its board.
        due_ns, late_ns : int
            Planned start by the board's clock, and the delay after which it is not sent.

        Raises
        ------
        SafetyError
            Naming the limit, the slot and electrode, and by how much.
        """
        with self._lock:
            times = times if type(times) is int else _whole(times, "times")
            if times < 1:
                raise SafetyError(f"{times} repetitions: there must be one at least", limit="times")
            copy = frozen(sequence)
            # Beyond 0 to 1 it is refused.
            ppb = parts_per_billion(copy.intensity) if 0 <= copy.intensity <= 1 else 0
            load = prove_sequence(copy, self.limits, ppb)
            now_ns, strength_ppb = self._time_of(copy.time_ns), load.strength_ppb
            self._prove_ramp(copy, strength_ppb, now_ns)
            self._exposure.enter(now_ns, copy.period_us, times, load, copy.slots > 0)
            self._now_ns, self._time_ns = now_ns, copy.time_ns
            self._ramp.claim(ppb, strength_ppb)
            return ProvedSequence(
                copy, times, number, due_ns, due_ns + late_ns, self._session, strength_ppb, _GATE
            )

    def check(self, sequence: ScanSequence, times: int = 1) -> ScanSequence:
        """Return a frozen copy of a sequence that reaches no board, or raise as `prove`; it counts
        as written."""
        proved = self.prove(sequence, times)
        self.note(proved)
        return proved.sequence

    def has_proved(self, proved: ProvedSequence) -> bool:
        """Return whether a sequence was proved in the present session."""
        return proved.session == self._session

    def repeated(self, proved: ProvedSequence, due_ns: int) -> ProvedSequence:
        """Return a proved sequence for a later start: a repetition that the host times, or a
        sequence that had to wait for its turn on the board.

        Raises
        ------
        SafetyError
            If that is later than its repetitions and the longest wait can explain.
        """
        period_ns = 1000 * proved.sequence.period_us
        latest_ns = proved.due_ns + (proved.times + 4) * period_ns + WAITS_NS
        if due_ns > latest_ns:
            raise SafetyError(
                f"sequence {proved.number} would begin {(due_ns - latest_ns) / 1e9:.3g} s too late",
                limit="write_before_ns", value=due_ns, allowed=latest_ns,
            )  # fmt: skip
        waits_ns = proved.write_before_ns - proved.due_ns
        return replace(proved, due_ns=due_ns, write_before_ns=due_ns + waits_ns, key=_GATE)

    def permits(self, proved: ProvedSequence) -> bool:
        """Return whether the current of a proved sequence may begin now, by what was written."""
        if not proved.strength_ppb:
            return True
        with self._lock:
            now_ns = self._time_of(proved.sequence.time_ns)
            return self._ramp.permits(proved.strength_ppb, now_ns)

    def note(self, proved: ProvedSequence) -> None:
        """Enter that the bytes of a proved sequence have just been written; its parts and
        repetitions count once."""
        sequence = proved.sequence
        if sequence is self._noted:
            return
        ppb, lasting_ns = parts_per_billion(sequence.intensity), 1000 * sequence.period_us
        with self._lock:
            self._noted, now_ns = sequence, self._time_of(sequence.time_ns)
            self._ramp.note(ppb, proved.strength_ppb, now_ns, lasting_ns * proved.times)

    def _time_of(self, claimed_ns: int) -> int:
        now_ns = claimed_ns if self._clock is None else self._clock.now_ns()
        # A clock that falls counts as standing still.
        return now_ns if self._now_ns is None else max(now_ns, self._now_ns)

    def _prove_ramp(self, sequence: ScanSequence, strength_ppb: int, now_ns: int) -> None:
        """Raise if a sequence does not follow the one before, or its current rises too fast."""
        before_ns, time_ns = self._time_ns, sequence.time_ns
        if before_ns is not None and time_ns <= before_ns:
            raise SafetyError(
                f"sequence at {time_ns} ns does not follow the one at {before_ns} ns",
                limit="time_ns",
                value=time_ns,
                allowed=before_ns + 1,
            )
        if strength_ppb and not self._ramp.permits(strength_ppb, now_ns):
            strength, level = strength_ppb / PPB, self._ramp.open_ppb(now_ns) / PPB
            raise SafetyError(
                f"current of strength {strength:.3f} where {level:.3f} is open: zero to full "
                f"must take {self.limits.ramp_s:g} s or more of pulses",
                limit="ramp_s",
                value=strength,
                allowed=level,
            )


def _whole(value: Any, name: str) -> int:
    """Return a whole number as a plain one, or raise."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise SafetyError(f"{name} is {value!r}, must be a whole number", limit=name)
    return int(value)


def frozen(sequence: ScanSequence) -> ScanSequence:
    """Return an immutable copy: arrays backed by bytes, and plain whole numbers; raise a
    SafetyError if a field has another type or shape than it should."""
    fields: dict[str, Any] = {"proof": sequence.proof, "sums": sequence.sums}
    slots: int | None = None
    for name, kind, dimensions, of_slots in _ARRAYS:
        values = getattr(sequence, name)
        if values is None and not of_slots:
            continue
        if not isinstance(values, np.ndarray):
            raise SafetyError(f"{name} is {type(values).__name__}, must be an array", limit=name)
        # As a plain array: a foreign class may pretend to be another array.
        plain = np.asarray(values)
        fits = plain.dtype == kind and plain.ndim == dimensions
        if fits and of_slots:
            slots = len(plain) if slots is None else slots
            fits = len(plain) == slots
        if not fits:
            raise SafetyError(
                f"{name} is {plain.dtype} {plain.shape}, must be {kind} in {dimensions} "
                f"dimension(s), {slots} slots",
                limit=name,
            )
        fields[name] = unwritable(plain)
    for name in ("period_us", "time_ns", "recharge_us"):
        value = getattr(sequence, name)
        fields[name] = value if type(value) is int else _whole(value, name)
    value = sequence.intensity
    if isinstance(value, bool) or not isinstance(value, (int, float, np.floating)):
        raise SafetyError(f"intensity is {value!r}, must be a number", limit="intensity")
    try:
        intensity = float(value)
    except OverflowError:
        raise SafetyError("intensity is too large to be a number", limit="intensity") from None
    return ScanSequence(**fields, intensity=intensity)
