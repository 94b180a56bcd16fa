"""Safety gate and ramp. The gate checks all limits on a frozen copy of each scan sequence. The ramp
limits how fast the strength of sequences rises from zero."""

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

LEEWAY_PPB = 1000  # strength may exceed the ramp's limit by this much, ppb, due to rounding
LEVEL_KEPT_NS = 15_000_000_000
"""Longest pause without current, ns, in which the ramp keeps its level. After a longer pause the
level is zero. The pause is long enough for a participant of an experiment to answer."""
PLANNED_KEPT_NS = LEVEL_KEPT_NS - 1_000_000_000
"""Longest pause without current, ns, after which plans do not restart at zero intensity. The value
is below `LEVEL_KEPT_NS`, because a sequence is written some time after it is planned."""
FIRST_NS = 20_000_000
"""Time, ns, in which the ramp rises from zero to the first strength above zero that the scheduler
plans. If all currents round to zero at this strength, the scheduler plans a larger strength."""
MOST_STEP_NS = 80_000_000
"""Time, ns, that the ramp needs for the largest rise of strength between two plans."""
AHEAD_NS = 85_000_000
"""Time, ns. A planned strength may exceed the ramp's level by as much as the ramp rises in this
time. The gate allows as much as the ramp rises in 100 ms, so that late sequences can catch up."""

_ARRAYS = (
    ("current_ua", np.dtype(np.int16), 2, True),
    ("width_us", np.dtype(np.uint16), 1, True),
    ("discharge_us", np.dtype(np.uint16), 1, True),
    ("site", np.dtype(np.uint16), 1, True),
    ("vibration", np.dtype(np.float32), 1, False),
    ("recharge_ua", np.dtype(np.int16), 1, False),
)
"""For each array of a sequence: its name, type, number of dimensions, and whether it has one row
for each slot. Arrays that do not have one row for each slot may be None."""

WAITS_NS = 5_000_000_000
"""Fixed part, ns, of the largest delay that `SafetyGate.repeated` allows. It is this long because
resynchronizing a board takes over 2 s."""


class Ramp:
    """Slew limit of the strength of sequences, in integer parts per billion (ppb) of full strength.

    The ramp has a level. It rises only while passes with current are delivered, and never above the
    strength of these passes (see `sequence_limits.strength_ppb`). The rise from zero to full takes
    at least ``ramp_ns``. The strength of a sequence may exceed the level by as much as the ramp
    rises in `LATE_NS`, so that late sequences can catch up. If a sequence has current, and its
    intensity is below the level, the level falls to it. After a pause without current of over
    `LEVEL_KEPT_NS`, the level is zero. Without a ``clock``, the times of the sequences are used.
    """

    def __init__(self, ramp_ns: int, clock: Clock | None = None) -> None:
        self._ramp_ns, self._clock = ramp_ns, clock
        self._late_ppb = LATE_NS * PPB // ramp_ns
        self._newest_ns = -(2**63)
        self.lock: AbstractContextManager[object] = RLock()
        self.restart()

    def restart(self) -> None:
        """Restart at zero intensity."""
        self._begun = False
        self._level_ppb = self._strength_ppb = self._since_ns = self._left_ns = 0
        self._claimed_ppb = 0
        if self._clock is None:
            self._newest_ns = -(2**63)

    def claim(self, ppb: int, strength_ppb: int, now_ns: int) -> None:
        """Record the intensity of a proved sequence. The next intensity is planned from this value.

        A sequence without current never raises the value.
        """
        self._begun, self._newest_ns = True, now_ns
        self._claimed_ppb = ppb if strength_ppb else min(ppb, self._claimed_ppb)

    def open_at(self, claimed_ns: int, kept_ns: int = LEVEL_KEPT_NS) -> tuple[int, int]:
        """Return the present time, ns, and the ramp's level, ppb. The time never decreases."""
        # If the clock goes back, treat it as stopped.
        clock_ns = claimed_ns if self._clock is None else self._clock.now_ns()
        now_ns = max(clock_ns, self._newest_ns)
        gone_ns = now_ns - self._since_ns
        if gone_ns > self._left_ns + kept_ns:
            return now_ns, 0
        flowed_ns = max(0, min(gone_ns, self._left_ns))
        risen_ppb = self._level_ppb + flowed_ns * PPB // self._ramp_ns
        return now_ns, max(self._level_ppb, min(self._strength_ppb, risen_ppb))

    def open_level(self, claimed_ns: int) -> float:
        """Return the strength, in [0, 1], at which a run can continue after a pause."""
        with self.lock:
            _, open_ppb = self.open_at(claimed_ns, PLANNED_KEPT_NS)
            return min(self._claimed_ppb, open_ppb) / PPB

    def allowed_level(self, claimed_ns: int) -> float:
        """Return the largest strength, in [0, 1], to plan for a sequence that begins now."""
        with self.lock:
            if not self._begun:
                return 0.0
            now_ns, open_ppb = self.open_at(claimed_ns, PLANNED_KEPT_NS)
            if not open_ppb:
                return FIRST_NS / self._ramp_ns
            # The level rises only while current flows.
            step_ns = min(now_ns - self._since_ns, self._left_ns, MOST_STEP_NS)
            step_ns = max(step_ns, 0 if self._claimed_ppb else FIRST_NS)
            risen_ppb = self._claimed_ppb + step_ns * PPB // self._ramp_ns
            return min(PPB, risen_ppb, open_ppb + AHEAD_NS * PPB // self._ramp_ns) / PPB

    def permits(self, strength_ppb: int, claimed_ns: int, open_ppb: int | None = None) -> bool:
        """Return whether a sequence of this strength may begin now. The first one after a restart
        must have no current. Later, strength may exceed the ramp's level by its rise in `LATE_NS`.
        ``open_ppb`` is the ramp's level, without this excess, if the caller knows it."""
        with self.lock:
            most_ppb = LEEWAY_PPB
            if self._begun:
                level_ppb = self.open_at(claimed_ns)[1] if open_ppb is None else open_ppb
                most_ppb += level_ppb + self._late_ppb
            return strength_ppb <= most_ppb

    def note(self, ppb: int, strength_ppb: int, claimed_ns: int, lasting_ns: int) -> None:
        """Record a written sequence. If it has current, and the ramp's level is above its
        intensity ``ppb``, the level falls to ``ppb``. Then the level rises during the passes
        (``lasting_ns``), at most to ``strength_ppb``."""
        with self.lock:
            # The board finishes the running pass of the old sequence and drops its other passes.
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
        Number of passes; a newer sequence ends them early.
    number : int
        Number of the sequence on its board.
    due_ns, write_before_ns : int
        Planned start, and latest time of writing, by the board's clock.
    session : int
        Number of the session in which the gate proved the sequence.
    strength_ppb : int
        See `sequence_limits.strength_ppb`.
    peak_ua : int
        Strongest current of the slots.
    """

    sequence: ScanSequence
    times: int
    number: int
    due_ns: int
    write_before_ns: int
    session: int
    strength_ppb: int
    peak_ua: int

    def __init__(self, *_: object, **__: object) -> None:
        raise SafetyError("only the safety gate proves sequences: use Board.send", limit="gate")


class SafetyGate:
    """Gate that proves each sequence safe before a board may write it.

    Parameters
    ----------
    limits : SafetyLimits
        Limits of every sequence.
    clock : Clock, optional
        Clock of the display; by default, the times of the sequences are used.
    """

    def __init__(self, limits: SafetyLimits, clock: Clock | None = None) -> None:
        self.limits: SafetyLimits = limits
        self.ramp: Ramp = Ramp(limits.ramp_ns, clock)
        """Ramp of strength. Schedulers plan within the ramp; `prove` and the driver check it."""
        self.session: int = 0
        """Number of the present session; boards reject sequences of other sessions."""
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
        """Restart the ramp in the same session. Times of sequences may start at 0 again."""
        self.ramp.restart()
        self._time_ns: int | None = None
        self._noted: ScanSequence | None = None  # last written sequence
        if self._clock is None:
            self._exposure.forget_second()

    def net_rest_ns(self) -> int:
        """Return how long a new session must wait, ns; see `Exposure.net_rest_ns`."""
        with self.ramp.lock:
            return 0 if self._clock is None else self._exposure.net_rest_ns(self._clock.now_ns())

    def begin_session(self) -> None:
        """Start a session: ramp and dose are zero. Limits per second still count earlier pulses."""
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
        """Prove a sequence for a board and return a frozen copy.

        Parameters
        ----------
        sequence : ScanSequence
        times : int
            Number of passes.
        number : int
            Number of the sequence on its board.
        due_ns, late_ns : int
            Planned start by the board's clock, and delay after which the sequence is not sent.

        Raises
        ------
        SafetyError
            If the gate rejects the sequence. The error has the limit, slot, electrode and values.
        """
        with self.ramp.lock:
            times = times if type(times) is int else _whole(times, "times")
            if times < 1:
                raise SafetyError(f"times is {times}, must be 1 or more", limit="times")
            sequence = frozen(sequence)
            # `prove_sequence` rejects intensities outside of [0, 1].
            ppb = parts_per_billion(sequence.intensity) if 0 <= sequence.intensity <= 1 else 0
            load = prove_sequence(sequence, self.limits, ppb)
            time_ns, strength_ppb = sequence.time_ns, load.strength_ppb
            if self._time_ns is not None and time_ns <= self._time_ns:
                raise refusal("order", time_ns, self._time_ns + 1)
            now_ns, open_ppb = self.ramp.open_at(time_ns)
            if strength_ppb and not self.ramp.permits(strength_ppb, time_ns, open_ppb):
                raise refusal("ramp_s", strength_ppb / PPB, open_ppb / PPB)
            flows = len(sequence.width_us) > 0
            self._exposure.enter(now_ns, sequence.period_us, times, load, flows)
            self._time_ns = time_ns
            self.ramp.claim(ppb, strength_ppb, now_ns)
            proved = object.__new__(ProvedSequence)
            vars(proved).update(
                sequence=sequence, times=times, number=number, due_ns=due_ns,
                write_before_ns=due_ns + late_ns, session=self.session, strength_ppb=strength_ppb,
                peak_ua=load.peak_ua,
            )  # fmt: skip
            return proved

    def check(self, sequence: ScanSequence, times: int = 1) -> ScanSequence:
        """Prove a sequence without a board, and count it as written. Raises errors like `prove`."""
        proved = self.prove(sequence, times)
        self.note(proved)
        return proved.sequence

    def repeated(self, proved: ProvedSequence, due_ns: int) -> ProvedSequence:
        """Return a proved sequence with the later start ``due_ns``. Use this if the host times the
        repetitions, or if the board was not ready. The largest allowed delay is the sum of the time
        of all passes, four periods and `WAITS_NS`. Raises SafetyError if the delay is larger."""
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
        """Record that a proved sequence was written. Repeated calls for one sequence count once."""
        sequence = proved.sequence
        if sequence is not self._noted:
            self._noted = sequence
            ppb, lasting_ns = parts_per_billion(sequence.intensity), 1000 * sequence.period_us
            self.ramp.note(ppb, proved.strength_ppb, sequence.time_ns, lasting_ns * proved.times)


def _whole(value: Any, name: str) -> int:
    """Convert an integer to int. Raises SafetyError for other values."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise SafetyError(f"{name} is {value!r}, must be a whole number", limit=name)
    return int(value)


def frozen(sequence: ScanSequence) -> ScanSequence:
    """Return an immutable copy: arrays are backed by bytes, integers are plain ints. Raises
    SafetyError if a field has a wrong type or shape."""
    fields: dict[str, Any] = {"proof": sequence.proof, "sums": sequence.sums}
    slots: int | None = None
    for name, kind, dimensions, of_slots in _ARRAYS:
        values = getattr(sequence, name)
        if values is None and not of_slots:
            continue
        if not isinstance(values, np.ndarray):
            raise SafetyError(f"{name} is {type(values).__name__}, must be an array", limit=name)
        # Convert to a plain array, because a subclass may behave differently.
        plain = np.asarray(values)
        fits = plain.dtype == kind and plain.ndim == dimensions
        if fits and of_slots:
            slots = len(plain) if slots is None else slots
            fits = len(plain) == slots
        if not fits:
            rows = f" and {slots} rows" if of_slots and slots is not None else ""
            raise SafetyError(
                f"{name} is {plain.dtype} {plain.shape}, must be {kind} with {dimensions} "
                f"dimension(s){rows}",
                limit=name,
            )
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
        raise SafetyError("intensity is too large: give 0 to 1", limit="intensity") from None
    return ScanSequence(**fields, intensity=intensity)
