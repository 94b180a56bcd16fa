"""The safety gate, which validates every limit on a frozen copy of each scan sequence, and the
ramp: how strong current may be, by what has flowed since it was zero."""

from contextlib import AbstractContextManager
from copy import copy
from dataclasses import dataclass
from threading import RLock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.clock import LATE_NS, Clock
from smarttouch.base.errors import SafetyError
from smarttouch.stimulation.safety_limits import PPB, SafetyLimits, parts_per_billion, refusal
from smarttouch.stimulation.scan_sequence import ScanSequence
from smarttouch.stimulation.sequence_limits import Dose, Exposure, prove_sequence

__all__ = ["ProvedSequence", "Ramp", "SafetyGate", "SafetyLimits"]

LEEWAY_PPB = 1000  # tolerance for rounding
LEVEL_KEPT_NS = 15_000_000_000
"""Time without current for which a level stays open: an experiment waits for an answer so long
while the finger stays in contact."""
PLANNED_KEPT_NS = LEVEL_KEPT_NS - 1_000_000_000
"""The same for planning: what is written a little later must find the level open."""
FIRST_NS = 20_000_000
MOST_STEP_NS = 80_000_000
"""Part of the ramp at which the first pulses begin, unless that is too weak for any pulse; and the
largest step from one sequence to the next."""
AHEAD_NS = 85_000_000
"""Part of the ramp by which pulses may be planned stronger than what has flowed: 100 ms may be
caught up, and a sequence may be written late."""

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


WAITS_NS = 5_000_000_000
"""Longest wait of a sequence for its turn, beside four of its periods and its repetitions: a kit
that has lost a command takes over 2 s to find the next one."""


class Ramp:
    """Level that written sequences have opened, in whole parts per billion of full strength.

    Only the time of passes with current counts, no more of it than has gone by, and up to their
    strength (`strength_ppb`). A level stays open for `LEVEL_KEPT_NS` after the last of it, and weak
    current does not lower it. One late step may be caught up. From zero to full it takes
    ``ramp_ns`` or longer. Times are of the ``clock``; without one, those that sequences claim.
    """

    def __init__(self, ramp_ns: int, clock: Clock | None = None) -> None:
        self._ramp_ns, self._clock = ramp_ns, clock
        self._late_ppb = LATE_NS * PPB // ramp_ns
        self._newest_ns = -(2**63)
        self.lock: AbstractContextManager[object] = RLock()
        self.restart()

    def restart(self) -> None:
        """Restart at zero: the next sequence must be without current."""
        self._begun = False
        self._level_ppb = self._strength_ppb = self._since_ns = self._left_ns = 0
        self._claimed_ppb = 0
        if self._clock is None:
            self._newest_ns = -(2**63)

    def claim(self, ppb: int, strength_ppb: int, now_ns: int) -> None:
        """Enter a sequence that is proved, and may not be written yet, for planning.

        The next intensity is planned from its own, 0 where a finger was lifted.
        """
        self._begun, self._newest_ns = True, now_ns
        self._claimed_ppb = ppb if strength_ppb else min(ppb, self._claimed_ppb)

    def open_at(self, claimed_ns: int, kept_ns: int = LEVEL_KEPT_NS) -> tuple[int, int]:
        """Return the time of a sequence that is proved, planned or written now, and the level that
        is open then, without what may be caught up."""
        # A clock that falls counts as standing still.
        clock_ns = claimed_ns if self._clock is None else self._clock.now_ns()
        now_ns = max(clock_ns, self._newest_ns)
        gone_ns = now_ns - self._since_ns
        if gone_ns > self._left_ns + kept_ns:
            return now_ns, 0
        flowed_ns = max(0, min(gone_ns, self._left_ns))
        risen_ppb = self._level_ppb + flowed_ns * PPB // self._ramp_ns
        return now_ns, max(self._level_ppb, min(self._strength_ppb, risen_ppb))

    def open_level(self, claimed_ns: int) -> float:
        """Return the strength, in [0, 1], with which pulses may go on after a pause."""
        with self.lock:
            _, open_ppb = self.open_at(claimed_ns, PLANNED_KEPT_NS)
            return min(self._claimed_ppb, open_ppb) / PPB

    def allowed_level(self, claimed_ns: int) -> float:
        """Return the strength, in [0, 1], to plan for a sequence that begins now."""
        with self.lock:
            if not self._begun:
                return 0.0
            now_ns, open_ppb = self.open_at(claimed_ns, PLANNED_KEPT_NS)
            if not open_ppb:
                return FIRST_NS / self._ramp_ns
            # Time counts while pulses flow.
            step_ns = min(now_ns - self._since_ns, self._left_ns, MOST_STEP_NS)
            step_ns = max(step_ns, 0 if self._claimed_ppb else FIRST_NS)
            risen_ppb = self._claimed_ppb + step_ns * PPB // self._ramp_ns
            return min(PPB, risen_ppb, open_ppb + AHEAD_NS * PPB // self._ramp_ns) / PPB

    def permits(self, strength_ppb: int, claimed_ns: int) -> bool:
        """Return whether current of a strength may begin now: `LATE_NS` may be caught up."""
        with self.lock:
            most_ppb = LEEWAY_PPB
            if self._begun:
                most_ppb += self.open_at(claimed_ns)[1] + self._late_ppb
            return strength_ppb <= most_ppb

    def note(self, ppb: int, strength_ppb: int, claimed_ns: int, lasting_ns: int) -> None:
        """Enter a sequence whose bytes have just been written, by the intensity that it claims,
        which lowers the level, its strength, above which it raises none, and the time of its
        passes, all repetitions included."""
        with self.lock:
            # The board finishes its present pass, and of repetitions no more.
            now_ns, open_ppb = self.open_at(claimed_ns)
            gone_ns = max(0, now_ns - self._since_ns)
            left_ns = self._left_ns - gone_ns
            to_come_ns = min(left_ns, LATE_NS) if left_ns > 0 else 0
            if strength_ppb:
                if ppb > self._level_ppb or -left_ns > LEVEL_KEPT_NS:
                    ppb = min(ppb, open_ppb)
                self._level_ppb, self._strength_ppb = ppb, strength_ppb
                self._since_ns, self._left_ns = now_ns, to_come_ns + lasting_ns
            else:
                self._left_ns = min(self._left_ns, gone_ns + to_come_ns)


@dataclass(frozen=True, eq=False, init=False)
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
    session : int
        Of the gate, in which it was proved.
    strength_ppb : int
        By its strongest pulse; see `sequence_limits.strength_ppb`.
    """

    sequence: ScanSequence
    times: int
    number: int
    due_ns: int
    write_before_ns: int
    session: int
    strength_ppb: int

    def __init__(self, *_: object, **__: object) -> None:
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
        self.ramp: Ramp = Ramp(limits.ramp_ns, clock)
        """Of what was written; whoever plans a sequence, or is about to write one, asks it."""
        self.session: int = 0
        """Number of the present session; what was proved in another one is not written."""
        self._clock = clock
        self._exposure = Exposure(limits)
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
        self.ramp.restart()
        self._time_ns: int | None = None
        self._noted: ScanSequence | None = None  # the sequence that was written last
        if self._clock is None:
            self._exposure.forget_second()

    def net_rest_ns(self) -> int:
        """Return how long a new session must wait: see `Exposure.net_rest_ns`."""
        with self.ramp.lock:
            return 0 if self._clock is None else self._exposure.net_rest_ns(self._clock.now_ns())

    def begin_session(self) -> None:
        """Start at intensity zero with a dose of zero; the last second still counts."""
        now_ns = None if self._clock is None else self._clock.now_ns()
        self._exposure.begin_session(now_ns)
        self.session += 1
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
        with self.ramp.lock:
            times = times if type(times) is int else _whole(times, "times")
            if times < 1:
                raise SafetyError(f"{times} repetitions: there must be one at least", limit="times")
            sequence = frozen(sequence)
            # Beyond 0 to 1 it is refused.
            ppb = parts_per_billion(sequence.intensity) if 0 <= sequence.intensity <= 1 else 0
            load = prove_sequence(sequence, self.limits, ppb)
            time_ns, strength_ppb = sequence.time_ns, load.strength_ppb
            if self._time_ns is not None and time_ns <= self._time_ns:
                raise refusal("order", time_ns, self._time_ns + 1)
            permitted = not strength_ppb or self.ramp.permits(strength_ppb, time_ns)
            now_ns, open_ppb = self.ramp.open_at(time_ns)
            if not permitted:
                raise refusal("ramp_s", strength_ppb / PPB, open_ppb / PPB)
            flows = len(sequence.width_us) > 0
            self._exposure.enter(now_ns, sequence.period_us, times, load, flows)
            self._time_ns = time_ns
            self.ramp.claim(ppb, strength_ppb, now_ns)
            proved = object.__new__(ProvedSequence)
            vars(proved).update(
                sequence=sequence, times=times, number=number, due_ns=due_ns,
                write_before_ns=due_ns + late_ns, session=self.session, strength_ppb=strength_ppb,
            )  # fmt: skip
            return proved

    def check(self, sequence: ScanSequence, times: int = 1) -> ScanSequence:
        """Return a frozen copy of a sequence that reaches no board, or raise as `prove`; it counts
        as written."""
        proved = self.prove(sequence, times)
        self.note(proved)
        return proved.sequence

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
        later, waits_ns = copy(proved), proved.write_before_ns - proved.due_ns
        vars(later).update(due_ns=due_ns, write_before_ns=due_ns + waits_ns)
        return later

    def note(self, proved: ProvedSequence) -> None:
        """Enter that the bytes of a proved sequence have just been written; its parts and
        repetitions count once."""
        sequence = proved.sequence
        if sequence is not self._noted:
            self._noted = sequence
            ppb, lasting_ns = parts_per_billion(sequence.intensity), 1000 * sequence.period_us
            self.ramp.note(ppb, proved.strength_ppb, sequence.time_ns, lasting_ns * proved.times)


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
        # Nothing can write to an array that is backed by bytes.
        fields[name] = np.frombuffer(plain.tobytes(), kind).reshape(plain.shape)
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
