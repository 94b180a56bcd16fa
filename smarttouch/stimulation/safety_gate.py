"""The safety gate, which validates every limit on a frozen copy of each scan sequence."""

from dataclasses import InitVar, dataclass, replace
from threading import Lock
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.clock import LATE_NS
from smarttouch.base.errors import SafetyError
from smarttouch.stimulation.exposure import Dose, Exposure
from smarttouch.stimulation.safety_limits import PPB, SafetyLimits, parts_per_billion
from smarttouch.stimulation.scan_sequence import ScanSequence
from smarttouch.stimulation.sequence_limits import prove_fields, prove_slots
from smarttouch.stimulation.slot_sums import SlotAdder

__all__ = ["ProvedSequence", "SafetyGate", "SafetyLimits"]

LEEWAY_PPB = 1000  # tolerance for rounding in the ramp's sum

LEVEL_KEPT_NS = 15_000_000_000
"""Time without current for which a level stays open: an experiment waits for an answer so long
while the finger stays in contact."""

_ARRAYS = tuple(
    (name, np.dtype(kind), dimensions, of_slots)
    for name, kind, dimensions, of_slots in (
        ("current_ua", np.int16, 2, True),
        ("width_us", np.uint16, 1, True),
        ("discharge_us", np.uint16, 1, True),
        ("site", np.uint16, 1, True),
        ("vibration", np.float32, 1, False),
        ("recharge_ua", np.int16, 1, False),
    )
)
"""Arrays of a sequence: type, dimensions, and whether they have a row for each slot; the others
may be None."""
_WHOLE = ("period_us", "time_ns", "recharge_us")


class NanosecondClock(Protocol):
    """Clock of the gate."""

    def now_ns(self) -> int: ...


class Rise:
    """Level opened by current that has flowed since it was zero, in whole parts per billion.

    Only the time of passes with current counts, no more of it than has gone by, and up to their
    strength (`SafetyLimits.strength_ppb`). A level stays open for `LEVEL_KEPT_NS` after the last
    of it, and weak current does not lower it. One late step may be caught up.

    Parameters
    ----------
    ramp_ns : int
        Least time from zero to full.
    """

    def __init__(self, ramp_ns: int) -> None:
        self._ramp_ns = ramp_ns
        self._hurried_ppb = LATE_NS * PPB // ramp_ns
        self.restart()

    def restart(self) -> None:
        """Restart at zero."""
        self._ppb = self._strength_ppb = self._since_ns = self._left_ns = 0

    def risen_ppb(self, now_ns: int) -> int:
        """Return the level that is open now, without what may be caught up."""
        since_ns = now_ns - self._since_ns
        if since_ns > self._left_ns + LEVEL_KEPT_NS:
            return 0
        flowed_ns = max(0, min(since_ns, self._left_ns))
        risen_ppb = self._ppb + flowed_ns * PPB // self._ramp_ns
        return max(self._ppb, min(self._strength_ppb, risen_ppb))

    def permits(self, ppb: int, now_ns: int) -> bool:
        """Whether current of a strength may begin now: `LATE_NS` of the ramp are caught up."""
        if ppb <= self._ppb and now_ns - self._since_ns <= self._left_ns + LEVEL_KEPT_NS:
            return True
        return ppb - LEEWAY_PPB <= self.risen_ppb(now_ns) + self._hurried_ppb

    def note(self, ppb: int, strength_ppb: int, now_ns: int, lasting_ns: int) -> None:
        """Enter a sequence that begins now; what it fell short of or hurried is kept.

        Parameters
        ----------
        ppb, strength_ppb : int
            Intensity that it claims, which lowers the level, and its strength, above which it
            raises none.
        now_ns : int
        lasting_ns : int
            Time of its passes with current, all repetitions included; 0 if they have none.
        """
        # The board finishes its present pass, and of repetitions no more.
        gone_ns = max(0, now_ns - self._since_ns)
        left_ns = self._left_ns - gone_ns
        to_come_ns = min(left_ns, LATE_NS) if left_ns > 0 else 0
        if lasting_ns:
            if ppb > self._ppb or -left_ns > LEVEL_KEPT_NS:
                ppb = min(ppb, self.risen_ppb(now_ns))
            self._ppb, self._strength_ppb = ppb, strength_ppb
            self._since_ns, self._left_ns = now_ns, to_come_ns + lasting_ns
        else:
            self._left_ns = min(self._left_ns, gone_ns + to_come_ns)


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
    ramped : bool
        Whether it must keep to the ramp; not a measuring scan, which the firmware fixes.
    """

    sequence: ScanSequence
    times: int
    number: int
    due_ns: int
    write_before_ns: int
    ramped: bool
    session: int
    """Of the gate, in which it was proved."""
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
    clock : NanosecondClock, optional
        The display's. Without one, for checks that reach no board, time is what each
        sequence claims.
    """

    def __init__(self, limits: SafetyLimits, clock: NanosecondClock | None = None) -> None:
        self.limits = limits
        self._clock = clock
        self._exposure = Exposure(limits)
        self._adder = SlotAdder(limits.felt_ua)
        self._lock = Lock()
        self._now_ns: int | None = None
        self._session = 0
        # By the display's clock, and by the time that sequences claim.
        self._rises = Rise(limits.ramp_ns), Rise(limits.ramp_ns)
        # What was proved may wait: the rise that the skin gets is that of what was written.
        self._written = Rise(limits.ramp_ns)
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
        """Close the level; sequence time may start again at zero, the session continues."""
        for rise in (*self._rises, self._written):
            rise.restart()
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
        copy = self._prove(sequence, times, ramped=True)
        latest_ns = due_ns + late_ns
        return ProvedSequence(
            copy, int(times), number, due_ns, latest_ns, True, self._session, _GATE
        )

    def check(self, sequence: ScanSequence, times: int = 1) -> ScanSequence:
        """Return a frozen copy of a sequence that reaches no board, or raise as `prove`."""
        return self._prove(sequence, times, ramped=True)

    def prove_measurement(
        self,
        sequence: ScanSequence,
        times: int = 1,
        *,
        number: int = 0,
        due_ns: int = 0,
        late_ns: int = LATE_NS,
    ) -> ProvedSequence:
        """Return a frozen copy of a scan; every limit is checked but the rise since the one before.

        For boards that measure with a pulse that their firmware fixes: it cannot
        be ramped, and comes only when a user asks for it.
        """
        for _ in range(times):
            copy = self._prove(sequence, 1, ramped=False)
        latest_ns = due_ns + late_ns
        return ProvedSequence(copy, times, number, due_ns, latest_ns, False, self._session, _GATE)

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
        sequence = proved.sequence
        if not proved.ramped or not sequence.drives:
            return True
        strength_ppb = self.limits.strength_of(sequence)
        with self._lock:
            return self._written.permits(strength_ppb, self._time_of(sequence))

    def note(self, proved: ProvedSequence) -> None:
        """Enter that the bytes of a proved sequence have just been written; its parts and
        repetitions count once."""
        sequence = proved.sequence
        if not proved.ramped or sequence is self._noted:
            return
        lasting_ns = 1000 * sequence.period_us * proved.times * sequence.drives
        ppb, strength_ppb = parts_per_billion(sequence.intensity), self.limits.strength_of(sequence)
        with self._lock:
            self._noted = sequence
            self._written.note(ppb, strength_ppb, self._time_of(sequence), lasting_ns)

    def _time_of(self, sequence: ScanSequence) -> int:
        return sequence.time_ns if self._clock is None else self._clock.now_ns()

    def _prove(self, given: ScanSequence, times: int, *, ramped: bool) -> ScanSequence:
        # What is added up is added up in memory that the next sequence will use again.
        with self._lock:
            times = _whole(times, "times")
            if times < 1:
                raise SafetyError(f"{times} repetitions: there must be one at least", limit="times")
            sequence, limits = frozen(given), self.limits
            prove_fields(sequence, limits)
            ppb = parts_per_billion(sequence.intensity)
            made = prove_slots(sequence, limits, ppb, self._adder)
            now_ns = sequence.time_ns if self._clock is None else self._clock.now_ns()
            # A clock that falls counts as standing still.
            now_ns = now_ns if self._now_ns is None else max(now_ns, self._now_ns)
            strength_ppb = limits.strength_ppb(ppb, made.peak_pc)
            if ramped:
                self._prove_rise(sequence, strength_ppb, now_ns)
            flows = len(sequence.width_us) > 0
            self._exposure.enter(now_ns, sequence.period_us, times, made, flows)
            self._now_ns = now_ns
            if ramped:
                self._time_ns = sequence.time_ns
                lasting_ns = 1000 * sequence.period_us * times * (made.peak_pc > 0)
                by_clock, claimed = self._rises
                by_clock.note(ppb, strength_ppb, now_ns, lasting_ns)
                claimed.note(ppb, strength_ppb, sequence.time_ns, lasting_ns)
            return sequence

    def _prove_rise(self, sequence: ScanSequence, ppb: int, now_ns: int) -> None:
        """Raise if current of a strength, 0 if there is none, rises too fast: by the time that
        sequences claim, or the display's.
        """
        before_ns, time_ns = self._time_ns, sequence.time_ns
        if before_ns is not None and time_ns <= before_ns:
            raise SafetyError(
                f"sequence at {time_ns} ns does not follow the one at {before_ns} ns",
                limit="time_ns",
                value=time_ns,
                allowed=before_ns + 1,
            )
        by_clock, claimed = self._rises
        # The first is without current.
        if ppb and (
            (before_ns is None and ppb > LEEWAY_PPB)
            or not by_clock.permits(ppb, now_ns)
            or not claimed.permits(ppb, time_ns)
        ):
            level = min(by_clock.risen_ppb(now_ns), claimed.risen_ppb(time_ns)) / PPB
            raise SafetyError(
                f"current of strength {ppb / PPB:.3f} where {level:.3f} is open: zero to full "
                f"must take {self.limits.ramp_s:g} s or more of pulses",
                limit="ramp_s",
                value=ppb / PPB,
                allowed=level,
            )


def _whole(value: Any, name: str) -> int:
    """Return a whole number as a plain one, or raise."""
    if type(value) is int:
        return value
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise SafetyError(f"{name} is {value!r}, must be a whole number", limit=name)
    return int(value)


def frozen(sequence: ScanSequence) -> ScanSequence:
    """Return an immutable copy: arrays backed by bytes, and plain whole numbers.

    Raises
    ------
    SafetyError
        If a field has another type or shape than it should.
    """
    fields: dict[str, Any] = {"proof": sequence.proof, "sums": sequence.sums}
    slots: int | None = None
    for name, kind, dimensions, of_slots in _ARRAYS:
        values = getattr(sequence, name)
        if values is None and not of_slots:
            continue
        # As a plain array: a foreign class may pretend to be another array.
        plain = values if type(values) is np.ndarray else None
        if plain is None and isinstance(values, np.ndarray):
            plain = np.asarray(values)
        if (
            plain is None
            or plain.dtype != kind
            or plain.ndim != dimensions
            or (of_slots and slots is not None and len(plain) != slots)
        ):
            found = type(values).__name__ if plain is None else f"{plain.dtype} {plain.shape}"
            of = "" if slots is None or not of_slots else f" of {slots} slots"
            raise SafetyError(
                f"{name} is {found}, must be {kind} in {dimensions} "
                f"dimension{'s' * (dimensions > 1)}{of}",
                limit=name,
            )
        slots = len(plain) if slots is None else slots
        flat = np.frombuffer(plain.tobytes(), kind)
        fields[name] = flat if dimensions == 1 else flat.reshape(plain.shape)
    for name in _WHOLE:
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
