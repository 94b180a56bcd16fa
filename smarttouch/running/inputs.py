"""The user's controls, and the reading of source, force and controls for each step."""

import math
import threading
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from smarttouch.base.afferent import Mode
from smarttouch.base.errors import SmartTouchError, choice_of, require_within
from smarttouch.base.events import (
    Advice,
    Emit,
    FingerLifted,
    InputLost,
    InputRestored,
    IntensityChanged,
    ModeChanged,
    Paused,
    Resumed,
)
from smarttouch.boards.board import Board
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.run_statistics import RunStatistics
from smarttouch.sources.force import ForceSource
from smarttouch.sources.source_contract import Frame, Input, Source, checked_input

STEP = 0.05  # change of level by one press of a key


@dataclass(frozen=True)
class ControlState:
    """State of the user's controls; ``level`` is a part of the strongest comfortable current, [0,
    1].
    """

    mode: Mode
    level: float = 1.0
    paused: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.level <= 1:
            raise ValueError(f"a level of {self.level} is not between 0 and 1")

    @property
    def current_level(self) -> float:
        """Level that flows: zero while paused."""
        return 0.0 if self.paused else self.level


class Controls:
    """Intensity, mode and pause as the user sets them; changed from any thread, read by the loop.

    No level is raised above ``most``; `next_mode` goes through ``modes``.
    """

    most: float = 1.0

    def __init__(self, state: ControlState, modes: tuple[Mode, ...] = ()) -> None:
        self.modes: tuple[Mode, ...] = modes or (state.mode,)
        self._state = state
        # A change that another thread makes in between must not be lost, least of all a pause.
        self._lock = threading.RLock()

    def state(self, _time_ns: int) -> ControlState:
        """Return the state at a time of the run."""
        return self._state

    def change_level(self, by: float) -> None:
        """Raise or lower the level, from 0 to the most that is allowed."""
        with self._lock:
            level = min(self.most, max(0.0, round(self._state.level + by, 6)))
            self._change(level=level)

    def set_level(self, level: float) -> None:
        """Ask for a level; raises if it is not from 0 to the most that is allowed."""
        require_within(SmartTouchError, "intensity", level, 0, self.most)
        self._change(level=level)

    def silence(self) -> None:
        """Set the level to 0 at once."""
        self._change(level=0.0)

    def pause(self) -> None:
        """Set the level that flows to 0 at once, until `resume`."""
        self._change(paused=True)

    def resume(self) -> None:
        """Go on from zero intensity."""
        self._change(paused=False)

    def toggle_pause(self) -> None:
        """Pause, or go on from zero intensity."""
        with self._lock:
            self._change(paused=not self._state.paused)

    def next_mode(self) -> None:
        """Go to the next mode that is offered."""
        with self._lock:
            at = self.modes.index(self._state.mode)
            self._change(mode=self.modes[(at + 1) % len(self.modes)])

    def choose_mode(self, mode: Mode | str) -> None:
        """Go to one of the modes that are offered; raises for any other."""
        self._change(mode=choice_of("mode", mode, self.modes))

    def _change(self, **changes: Any) -> None:
        with self._lock:
            self._state = replace(self._state, **changes)


NO_INK_NS = 5_000_000_000  # time without ink under a pressing finger after which that is said
LIFT_NS = 300_000_000  # time without current after a lifted finger; it then rises from zero again


@dataclass
class Inputs:
    """Reads source, force and controls for each step; unknown force counts as no force.

    A given ``force`` is read in place of the source's; the board may measure force, too, and report
    a lifted finger.
    """

    source: Source
    force: ForceSource | None
    board: Board
    pipeline: Pipeline
    controls: Controls
    statistics: RunStatistics
    emit: Emit
    _before: ControlState | None = None
    _last_seen: int | None = None
    _blind: bool = False
    _lifted_until_ns: int = 0
    _inkless_since_ns: float | None = None  # infinite once that was said

    def read(self, time_ns: int, now_ns: int) -> tuple[Input, float] | None:
        """Return the input with the force that counts (zero if unknown), and the level that flows.

        ``time_ns`` is of the run, ``now_ns`` of the loop's clock. None at the end of the source.
        """
        source, state = self.source, self.controls.state(time_ns)
        if state.mode is not self.pipeline.mode:
            self.pipeline.change_mode(state.mode)
            self.board.close_level()
        if state is not self._before:
            source.afferents = state.mode.afferents
        current = source.read(time_ns)
        if current is None:
            return None
        image = current.image if isinstance(current, Frame) else None
        if (
            type(image) is not np.ndarray
            or image.dtype != np.uint8
            or image.ndim != 2
            or not image.size
        ):
            current = checked_input(current, source, self.pipeline.electrodes)
        self.statistics.seen += current.number != self._last_seen
        self._last_seen = current.number
        force_n = self.force_n(current, time_ns)
        blind = current.stale or math.isnan(force_n)
        self.statistics.blind += blind
        if blind is not self._blind:
            lost = InputLost(time_ns, image=current.stale)
            self.emit(lost if blind else InputRestored(time_ns))
            self._blind = blind
        counts_n = 0.0 if blind else force_n
        if not self.statistics.active and counts_n > 0 and isinstance(current, Frame):
            self._look_for_ink(time_ns)
        if counts_n != current.force_n:
            current = replace(current, force_n=counts_n)
        level = 0.0 if state.paused else state.level
        if state is not self._before:
            self._say_changes(state, time_ns)
        if self.board.lifted or now_ns < self._lifted_until_ns:
            self._handle_lift(time_ns, now_ns)
        return current, level

    def _look_for_ink(self, time_ns: int) -> None:
        """Say once that a pressing finger sees no ink, so that silence has a reason."""
        if self._inkless_since_ns is None:
            self._inkless_since_ns = time_ns
        elif time_ns - self._inkless_since_ns >= NO_INK_NS:
            self._inkless_since_ns = math.inf
            words = f"no ink was seen in the first {NO_INK_NS / 1e9:g} s: nothing can be felt"
            self.emit(Advice(time_ns, words))

    def begins_at_zero(self, time_ns: int, now_ns: int) -> bool:
        """Return whether intensity will begin at zero with the input that is read next."""
        state, before = self.controls.state(time_ns), self._before
        same = before is not None and (state.mode, state.paused) == (before.mode, before.paused)
        return not same or self.board.lifted or now_ns < self._lifted_until_ns

    def force_n(self, current: Input, time_ns: int) -> float:
        """Return the force that counts, NaN if unknown; a force on the board may lower it.

        On a board that a finger may be on, only force of that finger counts.
        """
        on_board, virtual = self.board.force_n, not self.board.on_a_finger
        if self.force is not None:
            force_n = self.force.read(time_ns) if virtual or self.force.is_live else math.nan
        elif self.source.measures_force or (
            virtual and (self.source.knows_force or on_board is None)
        ):
            force_n = current.force_n
        else:
            force_n = math.nan if on_board is None else on_board
        if on_board is None or math.isnan(force_n):
            return force_n
        return min(force_n, on_board)

    def _say_changes(self, state: ControlState, time_ns: int) -> None:
        """Emit what has changed of what the user asks for."""
        before, self._before = self._before, state
        if before is None or state.level != before.level:
            self.emit(IntensityChanged(time_ns, state.level))
        if state.paused != (before is not None and before.paused):
            self.begin_at_zero()
            self.emit(Paused(time_ns) if state.paused else Resumed(time_ns))
        if before is None or state.mode is not before.mode:
            self.emit(ModeChanged(time_ns, state.mode))

    def _handle_lift(self, time_ns: int, now_ns: int) -> None:
        """Keep intensity at zero for a while after the board found the finger lifted."""
        if self.board.lifted and now_ns >= self._lifted_until_ns:
            # Only a pulse can show whether the finger is back: try again, from zero.
            self.board.lifted = False
            self.statistics.lifts += 1
            self.emit(FingerLifted(time_ns))
            self._lifted_until_ns = now_ns + LIFT_NS
        if now_ns < self._lifted_until_ns:
            self.begin_at_zero()

    def begin_at_zero(self) -> None:
        """Close the level that is open: intensity rises from zero again."""
        self.pipeline.restart_softly()
        self.board.close_level()
