"""Reading of a source, the finger's force and the user's controls, once for each step."""

import math
from dataclasses import dataclass, replace

from smarttouch.boards.board import Board
from smarttouch.events import (
    Emit,
    FingerLifted,
    InputLost,
    InputRestored,
    IntensityChanged,
    ModeChanged,
    Paused,
    Resumed,
)
from smarttouch.running.controls import Controls, ControlState
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.statistics import RunStatistics
from smarttouch.sources.forces.force import ForceSource
from smarttouch.sources.input_checks import checked_input
from smarttouch.sources.source import Source
from smarttouch.sources.stimulus import Input

LIFT_NS = 300_000_000
"""Time without current after a lifted finger; it then rises from zero again."""


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

    def read(self, time_ns: int, now_ns: int) -> tuple[Input, float] | None:
        """Return the input with the force that counts (zero if unknown), and the level that flows.

        ``time_ns`` is of the run, ``now_ns`` of the loop's clock. None at the end of the source.
        """
        source = self.source
        given = source.read(time_ns)
        if given is None:
            return None
        given = checked_input(given, source.url or source.title, self.pipeline.electrodes)
        self.statistics.seen += given.number != self._last_seen
        self._last_seen = given.number
        force_n = self._force_n(given, time_ns)
        blind = given.stale or math.isnan(force_n)
        self.statistics.blind += blind
        if blind is not self._blind:
            lost = InputLost(time_ns, image=given.stale)
            self.emit(lost if blind else InputRestored(time_ns))
            self._blind = blind
        counts_n = 0.0 if blind else force_n
        if counts_n != given.force_n:
            given = replace(given, force_n=counts_n)
        state = self.controls.state(time_ns)
        level = state.current_level
        if state is not self._before:
            self._say_changes(state, time_ns)
        if state.mode is not self.pipeline.mode:
            self.pipeline.change_mode(state.mode)
        if self.board.lifted or now_ns < self._lifted_until_ns:
            self._handle_lift(time_ns, now_ns)
        return given, level

    def _force_n(self, given: Input, time_ns: int) -> float:
        """Return the force that counts, NaN if unknown; a force on the board may lower it.

        On a board that a finger may be on, only force of that finger counts.
        """
        on_board, virtual = self.board.force_n, not self.board.on_a_finger
        if self.force is not None:
            force_n = self.force.read(time_ns) if virtual or self.force.is_live else math.nan
        elif self.source.measures_force or (
            virtual and (self.source.knows_force or on_board is None)
        ):
            force_n = given.force_n
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
            self._begin_at_zero()
            self.emit(Paused(time_ns) if state.paused else Resumed(time_ns))
        if before is None or state.mode is not before.mode:
            self.emit(ModeChanged(time_ns, state.mode))

    def _handle_lift(self, time_ns: int, now_ns: int) -> None:
        """Keep intensity at zero for a while after the board found the finger lifted."""
        if self.board.lifted and now_ns >= self._lifted_until_ns:
            # Only a pulse can tell whether the finger is back: try again, from zero.
            self.board.lifted = False
            self.statistics.lifts += 1
            self.emit(FingerLifted(time_ns))
            self._lifted_until_ns = now_ns + LIFT_NS
        if now_ns < self._lifted_until_ns:
            self._begin_at_zero()

    def _begin_at_zero(self) -> None:
        """Close the level that is open: intensity rises from zero again."""
        self.pipeline.restart_softly()
        self.board.close_level()
