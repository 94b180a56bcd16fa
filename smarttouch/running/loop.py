"""The loop: one clock, absolute deadlines, and an orderly end whatever happens."""

import contextlib
import gc
import logging
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import cv2

from smarttouch.base.clock import LATE_NS, Clock, SimulatedClock
from smarttouch.base.errors import (
    BoardError,
    BoardRestartedError,
    BoardStoppedError,
    SequenceLateError,
)
from smarttouch.base.events import BoardRestarted, Emit, Event, Note, RunEnded
from smarttouch.base.posix import prioritized, priority_advice
from smarttouch.base.stopping import StopRequest
from smarttouch.boards.board import Board
from smarttouch.running.inputs import Controls, ControlState, Inputs
from smarttouch.running.listener import Listener
from smarttouch.running.phase_lock import PhaseLock, Sent
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.regulation import Regulator
from smarttouch.running.run_statistics import RunStatistics
from smarttouch.running.step import Step, StepResult
from smarttouch.sources.force import ForceSource
from smarttouch.sources.source_contract import Source


@contextmanager
def steady_environment(pipeline: Pipeline, simulated_time: bool = False) -> Iterator[None]:
    """Warm a pipeline up, freeze garbage collection and keep OpenCV to one thread in the block.

    Before a board is open: it would take the delay for a lost host. In simulated time, where
    nothing is late, OpenCV alone is kept to one thread.
    """
    threads = cv2.getNumThreads()
    # Images are small: a second thread costs more than it saves, and takes the other core.
    cv2.setNumThreads(1)
    freezes = not simulated_time and not gc.get_freeze_count()
    if not simulated_time:
        pipeline.warm_up()
    # What a program has frozen for itself stays so.
    if freezes:
        gc.freeze()
    try:
        yield
    finally:
        cv2.setNumThreads(threads)
        if freezes:
            gc.unfreeze()


HELD_UP_NS = 1_000_000
"""A send that takes longer than this, beside its own work, has waited for the board."""
_LATE_AGAIN_NS = 5_000_000_000  # time without a delay after which the next one is reported


LOG = logging.getLogger("smarttouch.run")
"""Logger of events: to a program's handlers, and nowhere without them."""
logging.getLogger("smarttouch").addHandler(logging.NullHandler())


def emit_to(listeners: Sequence[Listener]) -> Emit:
    """Return a function that logs an event and hands it to each of these listeners."""

    def emit(event: Event) -> None:
        LOG.info("%.1f s: %s", event.time_ns / 1e9, event)
        for each in listeners:
            each.event(event)

    return emit


def run_loop(
    source: Source,
    pipeline: Pipeline,
    board: Board,
    *,
    stop: StopRequest,
    statistics: RunStatistics,
    seconds: float | None = None,
    listeners: Sequence[Listener] = (),
    controls: Controls | None = None,
    force: ForceSource | None = None,
    regulator: Regulator | None = None,
    clock: Clock | None = None,
) -> None:
    """Deliver what a source gives to an open board until it ends.

    The source is read at each deadline; the next deadline is one sequence later, so an input that
    needs longer to scan lowers the rate and nothing queues. A late loop moves its schedule and
    never hurries. Statistics are filled as the run goes, so that they are there after a fault;
    listeners also get a step that was lost with the board. Without controls the level is 1, which
    only boards accept that no finger can be on.
    """
    if controls is None and board.on_a_finger:
        raise BoardError(
            "there may be a finger on this board, and no intensity is set: give controls, for "
            "example Controls(ControlState(mode, level=0)), and raise the level from there"
        )
    controls = controls or Controls(ControlState(pipeline.mode))
    if isinstance(source, Listener):
        # A source that depends on how its frames were delivered.
        listeners = [source, *listeners]
    source.emit = emit = emit_to(listeners)
    inputs = Inputs(source, force, board, pipeline, controls, statistics, emit)
    steps = [
        each.step for each in listeners if getattr(each.step, "__func__", None) is not Listener.step
    ]
    regulator = regulator or Regulator()
    regulates = None if regulator.is_idle(board) else regulator
    pipeline.adaptation = regulator.adaptation
    phase = PhaseLock(board, statistics)
    loop = _Loop(inputs, regulates, stop, steps, clock or board.clock, phase)
    with contextlib.nullcontext(False) if board.simulated_time else prioritized() as real_time:
        statistics.real_time = real_time
        if board.on_a_finger and not real_time:
            emit(Note(0, priority_advice()))
        loop.run(seconds)
    emit(RunEnded(loop.elapsed_ns, stop.reason or source.ended))


@dataclass
class _Loop:
    inputs: Inputs
    regulator: Regulator | None
    stop: StopRequest
    steps: Sequence[Callable[[StepResult], None]]
    clock: Clock
    phase: PhaseLock
    elapsed_ns: int = 0
    _start_ns: int = 0
    _report_late_ns: int = 0
    _shift_ns: int = 0
    _expected_ns: int | None = None  # when this step is expected, by the one before
    _over_ns: int = 0

    def run(self, seconds: float | None) -> None:
        statistics, clock, stop = self.inputs.statistics, self.clock, self.stop
        board = self.inputs.board
        source = self.inputs.source
        news = None if self._is_simulated else source.news
        own_time = not self._is_simulated and clock is not board.clock
        self._start_ns = start_ns = clock.now_ns()
        while not stop.event.is_set():
            deadline_ns = start_ns + self.elapsed_ns + self._shift_ns
            clock.wait_until(deadline_ns, stop.event)
            if news is not None and (waits_ns := self._patience_ns()) > 0:
                # Nothing is to be shown: time goes on.
                news.wait(waits_ns / 1e9)
                waited_ns = max(0, clock.now_ns() - deadline_ns)
                self.elapsed_ns += waited_ns
                deadline_ns += waited_ns
                self._expected_ns, self._over_ns = None, 0
            if stop.event.is_set():
                break
            # In this order: a pause of the computer between the two makes the frame late.
            board_ns = board.clock.now_ns() if own_time else None
            now_ns = clock.now_ns()
            statistics.seconds = (now_ns - start_ns) / 1e9
            if seconds is not None and statistics.seconds >= seconds:
                stop.ask(f"time limit of {seconds:g} s", at_once=False)
                break
            late_ns = now_ns - deadline_ns
            if not self._step(now_ns, late_ns, now_ns if board_ns is None else board_ns):
                break
        board.drain()
        self.phase.follow(self._shift_ns)
        statistics.seconds = (clock.now_ns() - start_ns) / 1e9

    @property
    def _is_simulated(self) -> bool:
        """Whether time passes only by waiting, as fast as this computer can."""
        return isinstance(self.clock, SimulatedClock)

    def _patience_ns(self) -> int:
        """Return how long the source's news may be waited for, ns, a second at most."""
        waits_ns = self.inputs.source.patience_ns(self.elapsed_ns)
        return min(waits_ns, 1_000_000_000)

    def _move(self, by_ns: int) -> None:
        """Move the schedule later: what comes then is not late."""
        self._shift_ns += by_ns
        self._over_ns += by_ns
        if self._expected_ns is not None:
            self._expected_ns += by_ns

    def _hold(self, until_ns: int) -> int:
        """Wait until a time of `time.monotonic_ns`, and move the schedule; return how long, ns."""
        begun_ns, left_ns = self.clock.now_ns(), until_ns - time.monotonic_ns()
        if left_ns <= 0:
            return 0
        self.clock.wait_until(begun_ns + left_ns, self.stop.event)
        held_ns = self.clock.now_ns() - begun_ns
        self._shift_ns += held_ns
        return held_ns

    def _step(self, now_ns: int, late_ns: int, board_ns: int) -> bool:
        """Deliver one input; return False at the end of the source."""
        # The skin waits since the sequence before was over, whatever the plan says.
        waits_ns = max(0, late_ns, now_ns - self._over_ns if self._over_ns else 0)
        # By simulated time no skin has waited.
        stalled = waits_ns > LATE_NS and not self.inputs.board.simulated_time
        # After a stall the plan is a new one.
        due_ns = board_ns if stalled else board_ns - waits_ns
        inputs, clock = self.inputs, self.clock
        pipeline, board = inputs.pipeline, inputs.board
        if stalled:
            # The board may have fallen silent.
            inputs.begin_at_zero()
        read = inputs.read(self.elapsed_ns, now_ns)
        if read is None:
            return False
        in_hand_ns, worked_ns = clock.now_ns(), time.thread_time_ns()
        observed = () if self.regulator is None else self.regulator.observe(board.take_volts())
        step = pipeline.process(*read, board.allowed_level(read[0].time_ns))
        if self.regulator is not None:
            step = self.regulator.regulate(step, observed)
        if inputs.source.send_at_ns is not None and not self._is_simulated:
            held_ns = self._hold(inputs.source.send_at_ns)
            now_ns, in_hand_ns = now_ns + held_ns, in_hand_ns + held_ns
            board_ns, due_ns = board_ns + held_ns, due_ns + held_ns
        sending_ns, own_ns = clock.now_ns(), time.thread_time_ns()
        try:
            number = self._send(step, due_ns)
        except BoardStoppedError:
            if not self.stop.event.is_set():
                raise
            return False
        sent_ns = clock.now_ns()
        over_ns = time.thread_time_ns()
        result = StepResult(
            step,
            number,
            (sent_ns - in_hand_ns) / 1000,
            (over_ns - worked_ns) / 1000,
            board.acknowledged,
            board.refused,
            self.phase.newest,
            now_ns - self._start_ns,
        )
        # Proving and writing are the loop's own work, however long.
        waited_ns = sent_ns - sending_ns - (over_ns - own_ns)
        sent = Sent(
            0 if number is None else number,
            in_hand_ns - step.input.age_ns,
            now_ns - late_ns,
            self._shift_ns,
            waited_ns if HELD_UP_NS < waited_ns < LATE_NS else 0,
            sent_ns,
            1000 * step.sequence.period_us,
            board_ns - now_ns,
        )
        self._plan_next(result, sent, now_ns)
        for follow in self.steps:
            follow(result)
        return True

    def _send(self, step: Step, due_ns: int) -> int | None:
        """Send a step's sequence; return its number, or None if it was lost with the board."""
        try:
            return self.inputs.board.send(step.sequence, due_ns=due_ns)
        except BoardRestartedError as lost:
            late = isinstance(lost, SequenceLateError)
            self.inputs.statistics.restarts += not late
            # A busy computer is late again and again: what is dropped is counted.
            if not late or self.elapsed_ns >= self._report_late_ns:
                self.inputs.emit(BoardRestarted(self.elapsed_ns, str(lost)))
            if late:
                self._report_late_ns = self.elapsed_ns + _LATE_AGAIN_NS
            if self.regulator is not None:
                self.regulator.lost(step.sequence)
            self.inputs.pipeline.restart_softly()
            return None

    def _plan_next(self, result: StepResult, sent: Sent, now_ns: int) -> None:
        """Enter a step into the statistics, and move the schedule by what it took."""
        statistics, period_ns = self.inputs.statistics, sent.period_ns
        if result.number is None:
            self._shift_ns += sent.sent_ns - now_ns
            self._expected_ns = None
            self._over_ns = 0
            self.phase.forget()
        else:
            expected_ns, self._expected_ns = self._expected_ns, now_ns + period_ns
            error_us = None if expected_ns is None else abs(now_ns - expected_ns) / 1000
            statistics.enter(result, error_us)
            self._over_ns = sent.sent_ns + period_ns
            self.phase.note(sent)
            # After a wait the board's clock is behind: frames taken later reach the skin as soon,
            # and fresher.
            self._shift_ns += sent.waited_ns
            late_ns = now_ns - sent.deadline_ns
            if late_ns > period_ns:
                statistics.late += 1
                self._shift_ns += late_ns
            if later_ns := self.phase.follow(self._shift_ns):
                self._move(later_ns)
        self.elapsed_ns += period_ns
