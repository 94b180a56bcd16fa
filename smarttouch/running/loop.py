"""Loop of a run: applies controls, reads inputs and sends sequences at deadlines of one clock."""

import contextlib
import gc
import logging
import math
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from smarttouch.base.afferent import Mode
from smarttouch.base.clock import LATE_NS, Clock, SimulatedClock
from smarttouch.base.errors import (
    BoardRestartedError,
    BoardStoppedError,
    SequenceLateError,
    SmartTouchError,
    choice_of,
    require_within,
)
from smarttouch.base.events import (
    Advice,
    BoardRestarted,
    Emit,
    Event,
    FingerLifted,
    InputLost,
    InputRestored,
    IntensityChanged,
    ModeChanged,
    Note,
    Paused,
    Resumed,
    RunEnded,
)
from smarttouch.base.posix import prioritized, priority_advice
from smarttouch.base.stopping import StopRequest
from smarttouch.boards.board import Board
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.run_statistics import PhaseLock, RunStatistics, Sent
from smarttouch.running.step_records import Listener, OnStep, Step, StepResult
from smarttouch.sources.force import ForceSource
from smarttouch.sources.source_contract import Frame, Input, Source, checked_input

HELD_UP_NS = 1_000_000
"""If a send waits longer than this, but less than `LATE_NS`, for the board, the loop postpones all
later deadlines by the wait. The wait is the duration of the send minus its processor time."""
_LATE_AGAIN_NS = 5_000_000_000  # within this time after a late sequence, others are not reported

LOG = logging.getLogger("smarttouch.run")
"""Logger of events, silent unless a program adds handlers."""
logging.getLogger("smarttouch").addHandler(logging.NullHandler())


def emit_to(listeners: Sequence[Listener]) -> Emit:
    """Return a function that logs an event and passes it to all listeners."""

    def emit(event: Event) -> None:
        LOG.info("%.1f s: %s", event.time_ns / 1e9, event)
        for listener in listeners:
            listener.event(event)

    return emit


@contextmanager
def steady_environment(pipeline: Pipeline, simulated_time: bool = False) -> Iterator[None]:
    """Warm up the pipeline, then keep the timing steady during the ``with`` block.

    In the block, OpenCV uses one thread, and garbage collection ignores older objects. The caller
    opens the board in the block, because an open board would report a lost host during the warm-up.
    In simulated time there is no warm-up, and garbage collection is normal: nothing can be late.
    """
    threads = cv2.getNumThreads()
    # Images are small: a second thread costs more than it saves.
    cv2.setNumThreads(1)
    # If the program has called gc.freeze, do not call it here: gc.unfreeze would undo both calls.
    freezes = not simulated_time and not gc.get_freeze_count()
    if not simulated_time:
        pipeline.warm_up()
    if freezes:
        gc.freeze()
    try:
        yield
    finally:
        cv2.setNumThreads(threads)
        if freezes:
            gc.unfreeze()


STEP = 0.05  # change of level by one press of a key


@dataclass(frozen=True)
class ControlState:
    """State of the user's controls; ``level`` is relative to the strongest comfortable current, in
    [0, 1]."""

    mode: Mode
    level: float = 1.0
    paused: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.level <= 1:
            raise ValueError(f"a level of {self.level} is not between 0 and 1")

    @property
    def current_level(self) -> float:
        """Effective level: zero while paused."""
        return 0.0 if self.paused else self.level


class Controls:
    """User's controls: level, mode and pause. Any thread may change them; the loop reads them.

    The level is at most ``most``. `next_mode` cycles through ``modes``.
    """

    most: float = 1.0

    def __init__(self, state: ControlState, modes: tuple[Mode, ...] = ()) -> None:
        self.modes: tuple[Mode, ...] = modes or (state.mode,)
        self._state = state
        # Simultaneous changes by several threads must not be lost, least of all a pause.
        self._lock = threading.RLock()

    def state(self, _time_ns: int) -> ControlState:
        """Return the state at a time of the run."""
        return self._state

    def change_level(self, by: float) -> None:
        """Add a number to the level; the result stays between 0 and ``most``."""
        with self._lock:
            level = min(self.most, max(0.0, round(self._state.level + by, 6)))
            self._change(level=level)

    def set_level(self, level: float) -> None:
        """Set the level. Raises SmartTouchError unless it is between 0 and ``most``."""
        require_within(SmartTouchError, "intensity", level, 0, self.most)
        self._change(level=level)

    def silence(self) -> None:
        """Set the level to 0 at once."""
        self._change(level=0.0)

    def pause(self) -> None:
        """Set the effective level to 0 at once, until `resume`."""
        self._change(paused=True)

    def resume(self) -> None:
        """Continue, starting from zero intensity."""
        self._change(paused=False)

    def toggle_pause(self) -> None:
        """Pause, or continue from zero intensity."""
        with self._lock:
            self._change(paused=not self._state.paused)

    def next_mode(self) -> None:
        """Change to the next mode."""
        with self._lock:
            at = self.modes.index(self._state.mode)
            self._change(mode=self.modes[(at + 1) % len(self.modes)])

    def choose_mode(self, mode: Mode | str) -> None:
        """Change to a mode in ``modes``. Raises SmartTouchError for other modes."""
        self._change(mode=choice_of("mode", mode, self.modes))

    def _change(self, **changes: Any) -> None:
        with self._lock:
            self._state = replace(self._state, **changes)


NO_INK_NS = 5_000_000_000  # time from the first press to an `Advice` event, if there is no ink
LIFT_NS = 300_000_000  # time at zero intensity after a lifted finger, before the ramp rises again


@dataclass
class Inputs:
    """Inputs of a loop: the source, finger force and the user's controls, read for each step.

    Unknown force counts as no force. If ``force`` is set, it replaces the force of the source. The
    board may also measure force, and report a lifted finger.
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
    _inkless_since_ns: float | None = None  # first press without ink; infinite after the advice

    def read(self, time_ns: int, now_ns: int) -> tuple[Input, float] | None:
        """Return the next input and the user's level, or None at the end of the source.

        The force of the input is the effective force. ``time_ns`` is the time of the run, and
        ``now_ns`` is the same moment by the loop's clock.
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
            self._emit_changes(state, time_ns)
        if self.board.lifted or now_ns < self._lifted_until_ns:
            self._handle_lift(time_ns, now_ns)
        return current, level

    def _look_for_ink(self, time_ns: int) -> None:
        """Advise the user once if the finger presses, but the sensor has seen no ink."""
        if self._inkless_since_ns is None:
            self._inkless_since_ns = time_ns
        elif time_ns - self._inkless_since_ns >= NO_INK_NS:
            self._inkless_since_ns = math.inf
            words = f"no ink was seen in the first {NO_INK_NS / 1e9:g} s: move the finger to print"
            self.emit(Advice(time_ns, words))

    def begins_at_zero(self, time_ns: int, now_ns: int) -> bool:
        """Return whether intensity will restart at zero with the next input."""
        state, before = self.controls.state(time_ns), self._before
        same = before is not None and (state.mode, state.paused) == (before.mode, before.paused)
        return not same or self.board.lifted or now_ns < self._lifted_until_ns

    def force_n(self, current: Input, time_ns: int) -> float:
        """Return the effective force, N, or NaN if unknown.

        If a finger may be on the board, force must be measured on that finger, or stated by the
        user. If the board measures a force as well, the smaller of the two counts.
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

    def _emit_changes(self, state: ControlState, time_ns: int) -> None:
        """Emit events for all changes of the user's controls."""
        before, self._before = self._before, state
        if before is None or state.level != before.level:
            self.emit(IntensityChanged(time_ns, state.level))
        if state.paused != (before is not None and before.paused):
            self.begin_at_zero()
            self.emit(Paused(time_ns) if state.paused else Resumed(time_ns))
        if before is None or state.mode is not before.mode:
            self.emit(ModeChanged(time_ns, state.mode))

    def _handle_lift(self, time_ns: int, now_ns: int) -> None:
        """Keep intensity at zero for `LIFT_NS` after the board has detected a lifted finger."""
        if self.board.lifted and now_ns >= self._lifted_until_ns:
            # Only a pulse can show whether the finger has returned, so pulse again, from zero.
            self.board.lifted = False
            self.statistics.lifts += 1
            self.emit(FingerLifted(time_ns))
            self._lifted_until_ns = now_ns + LIFT_NS
        if now_ns < self._lifted_until_ns:
            self.begin_at_zero()

    def begin_at_zero(self) -> None:
        """Reset the ramp: intensity rises from zero again."""
        self.pipeline.restart_at_zero()
        self.board.close_level()


class Loop:
    """Loop that delivers the inputs of a source to an open board, one sequence after another.

    The loop reads the source at each deadline. The next deadline is one sequence period later, so
    inputs never queue. If the loop is late by more than a period, it postpones all later deadlines.
    Statistics are updated at each step, so they are complete after a fault. Listeners also receive
    steps whose sequences were late, or were lost with the board.
    """

    def __init__(
        self,
        source: Source,
        pipeline: Pipeline,
        board: Board,
        *,
        stop: StopRequest,
        statistics: RunStatistics,
        seconds: float | None = None,
        listeners: Sequence[Listener] = (),
        controls: Controls,
        force: ForceSource | None = None,
        clock: Clock | None = None,
    ) -> None:
        if isinstance(source, Listener):
            # A source that is a listener, such as a `Program`, needs the results of its steps.
            listeners = [source, *listeners]
        source.emit = self._emit = emit_to(listeners)
        self.inputs: Inputs = Inputs(
            source, force, board, pipeline, controls, statistics, self._emit
        )
        self.stop: StopRequest = stop
        self.elapsed_ns: int = 0  # time of the run at the next deadline
        self._steps = [
            listener.function if isinstance(listener, OnStep) else listener.step
            for listener in listeners
            if type(listener).step is not Listener.step
        ]
        says_starts = board.capabilities.acknowledges and not board.simulated_time
        self._phase = PhaseLock(board, statistics) if says_starts else None
        self._clock = clock or board.clock
        self.is_simulated: bool = isinstance(self._clock, SimulatedClock)
        """Whether time is simulated."""
        # A pause of the computer does not stall a board with simulated time.
        self._may_stall = not board.simulated_time
        self._seconds = seconds
        self._start_ns: int | None = None
        self._zero_ns = 0  # time 0 of the run by the loop's clock; each delay moves it later
        self._over_ns = 0  # end of the last sequence by the loop's clock
        self._report_late_ns = 0  # time of the run from which late sequences are reported
        self._expected_ns: int | None = None

    def run(self) -> None:
        """Deliver inputs until the source ends or a stop is requested."""
        with self.steady():
            while self.wait() and self.deliver():
                pass
        self.end()

    @contextmanager
    def steady(self) -> Iterator[None]:
        """Move the next deadline to now. Give the ``with`` block real-time priority if allowed."""
        with prioritized() if self._may_stall else contextlib.nullcontext(False) as real_time:
            if self._start_ns is None:
                self.inputs.statistics.real_time = real_time
                if self.inputs.board.on_a_finger and not real_time:
                    self._emit(Note(0, priority_advice()))
            self.resume()
            yield

    def resume(self) -> None:
        """Move the next deadline to now if it has passed in a pause without sequences."""
        if self._start_ns is None:
            self._start_ns = self._zero_ns = self._clock.now_ns()
        elif (idle_ns := self.time_ns() - self.elapsed_ns) > 0:
            self.elapsed_ns += idle_ns
            self._expected_ns, self._over_ns = None, 0

    def time_ns(self) -> int:
        """Return the time of the run, ns: the time since the start, minus all delays."""
        return self._clock.now_ns() - self._zero_ns

    def begins_at_zero(self) -> bool:
        """Return whether intensity will restart at zero with the next step."""
        return self.inputs.begins_at_zero(self.elapsed_ns, self._clock.now_ns())

    def end(self) -> None:
        """Wait until the board has delivered everything; store the run's duration."""
        self.inputs.board.drain()
        if self._phase is not None:
            self._phase.follow(self._zero_ns)
        if self._start_ns is not None:
            self.inputs.statistics.seconds = (self._clock.now_ns() - self._start_ns) / 1e9
        self._emit(RunEnded(self.elapsed_ns, self.stop.reason or self.inputs.source.ended))

    def wait(self) -> bool:
        """Wait for the next deadline; return False if the run ends."""
        self._clock.wait_until(self._zero_ns + self.elapsed_ns, self.stop.event)
        seconds, now_s = self._seconds, (self._clock.now_ns() - (self._start_ns or 0)) / 1e9
        if seconds is not None and now_s >= seconds and not self.stop.event.is_set():
            self.inputs.statistics.seconds = now_s
            self.stop.ask(f"time limit of {seconds:g} s", at_once=False)
        return not self.stop.event.is_set()

    def deliver(self) -> bool:
        """Deliver one input; return False at the end of the source or of the run."""
        inputs, clock = self.inputs, self._clock
        pipeline, board, phase = inputs.pipeline, inputs.board, self._phase
        # Read the board's clock first: then a pause between the readings cannot make `due_ns` late.
        board_ns, now_ns = board.clock.now_ns(), clock.now_ns()
        since_ns, deadline_ns = now_ns - (self._start_ns or 0), self._zero_ns + self.elapsed_ns
        inputs.statistics.seconds = since_ns / 1e9
        # Time since the deadline or since the end of the last sequence, whichever is longer.
        waits_ns = max(0, now_ns - deadline_ns, now_ns - self._over_ns if self._over_ns else 0)
        if waits_ns > LATE_NS and self._may_stall:
            # After a stall, send the next sequence now and restart the ramp.
            inputs.begin_at_zero()
            waits_ns = 0
        read = inputs.read(self.elapsed_ns, now_ns)
        if read is None:
            return False
        in_hand_ns, worked_ns = clock.now_ns(), time.thread_time_ns()
        observed = board.take_volts() if board.capabilities.measures else ()
        step = pipeline.process(*read, board.ramp.allowed_level(read[0].time_ns), observed)
        sending_ns, own_ns = clock.now_ns(), time.thread_time_ns()
        number: int | None = None
        try:
            number = board.send(step.sequence, due_ns=board_ns - waits_ns)
        except BoardRestartedError as lost:
            self._handle_loss(step, lost)
        except BoardStoppedError:
            if not self.stop.event.is_set():
                raise
            return False
        sent_ns, over_ns = clock.now_ns(), time.thread_time_ns()
        result = StepResult(
            step, number, (sent_ns - in_hand_ns) / 1000, (over_ns - worked_ns) / 1000,
            board.acknowledged, board.refused, None if phase is None else phase.newest, since_ns,
        )  # fmt: skip
        # Time that the send waited: its duration minus the processor time of gate and writing.
        waited_ns = sent_ns - sending_ns - (over_ns - own_ns)
        sent = Sent(
            number or 0, in_hand_ns - step.input.age_ns, deadline_ns, self.elapsed_ns,
            waited_ns if HELD_UP_NS < waited_ns < LATE_NS else 0,
            sent_ns, 1000 * step.sequence.period_us, board_ns - now_ns,
        )  # fmt: skip
        self._plan_next(result, sent, now_ns)
        for follow in self._steps:
            follow(result)
        return True

    def _handle_loss(self, step: Step, lost: BoardRestartedError) -> None:
        """Restart intensity at zero after a sequence was late, or after the board was lost."""
        late = isinstance(lost, SequenceLateError)
        self.inputs.statistics.restarts += not late
        # On a busy computer many sequences can be late: count all of them, but report few.
        if not late or self.elapsed_ns >= self._report_late_ns:
            self._emit(BoardRestarted(self.elapsed_ns, str(lost)))
        if late:
            self._report_late_ns = self.elapsed_ns + _LATE_AGAIN_NS
        self.inputs.pipeline.regulator.take_back(step.sequence)
        self.inputs.pipeline.restart_at_zero()

    def _plan_next(self, result: StepResult, sent: Sent, now_ns: int) -> None:
        """Add a step to the statistics, and plan the deadline of the next step."""
        statistics, phase = self.inputs.statistics, self._phase
        if result.number is None:
            self._zero_ns += sent.sent_ns - now_ns
            self._expected_ns, self._over_ns = None, 0
            if phase is not None:
                phase.forget()
        else:
            expected_ns, late_ns = self._expected_ns, now_ns - sent.deadline_ns
            error_us = None if expected_ns is None else abs(now_ns - expected_ns) / 1000
            statistics.enter(result, error_us)
            # If the send waited for the board, postpone all deadlines by the wait. The next
            # sequences then need not wait, and are made from fresher frames.
            self._zero_ns += sent.waited_ns
            if late_ns > sent.period_ns:
                statistics.late += 1
                self._zero_ns += late_ns
            more_ns = 0 if phase is None else phase.follow(self._zero_ns, sent)
            # Expect the next step `more_ns` later, so that this delay does not count as an error.
            self._zero_ns += more_ns
            self._expected_ns = now_ns + sent.period_ns + more_ns
            self._over_ns = sent.sent_ns + sent.period_ns + more_ns
        self.elapsed_ns += sent.period_ns
