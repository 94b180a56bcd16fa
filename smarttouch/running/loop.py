"""The loop: one clock, absolute deadlines, and an orderly end whatever happens."""

import contextlib
import gc
import logging
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

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


class Loop:
    """Delivers what a source gives to an open board, one sequence after another.

    The source is read at each deadline; the next deadline is one sequence later, so an input that
    needs longer to scan lowers the rate and nothing queues. A late loop moves its schedule and
    never hurries. Statistics are filled as the run goes, so that they are there after a fault;
    listeners also get a step that was lost with the board. Without controls the level is 1, which
    only boards accept that no finger can be on.
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
        controls: Controls | None = None,
        force: ForceSource | None = None,
        regulator: Regulator | None = None,
        clock: Clock | None = None,
    ) -> None:
        if controls is None and board.on_a_finger:
            raise BoardError(
                "there may be a finger on this board, and no intensity is set: give controls, for "
                "example Controls(ControlState(mode, level=0)), and raise the level from there"
            )
        controls = controls or Controls(ControlState(pipeline.mode))
        if isinstance(source, Listener):
            # A source that depends on how its frames were delivered.
            listeners = [source, *listeners]
        source.emit = self._emit = emit_to(listeners)
        self.inputs: Inputs = Inputs(
            source, force, board, pipeline, controls, statistics, self._emit
        )
        self.stop: StopRequest = stop
        self.elapsed_ns: int = 0  # time of the run at the next deadline
        self._steps = [
            each.step
            for each in listeners
            if getattr(each.step, "__func__", None) is not Listener.step
        ]
        regulator = regulator or Regulator()
        self._regulator = None if regulator.is_idle(board) else regulator
        pipeline.adaptation = regulator.adaptation
        says_starts = board.driver.reports_starts and not board.simulated_time
        self._phase = PhaseLock(board, statistics) if says_starts else None
        self._clock = clock or board.clock
        self.is_simulated: bool = isinstance(self._clock, SimulatedClock)
        """Whether time passes only by waiting, as fast as this computer can."""
        self._own_time = not self.is_simulated and self._clock is not board.clock
        self._seconds = seconds
        self._start_ns: int | None = None
        self._shift_ns = self._over_ns = self._report_late_ns = 0
        self._expected_ns: int | None = None  # when the next step is expected, by the one before

    def run(self) -> None:
        """Deliver inputs until the source ends or a stop is requested."""
        with self.steady():
            while self.wait() and self.deliver():
                pass
        self.end()

    @contextmanager
    def steady(self) -> Iterator[None]:
        """Go on from now, in a block whose thread has real-time priority if that is allowed."""
        simulated = self.inputs.board.simulated_time
        with contextlib.nullcontext(False) if simulated else prioritized() as real_time:
            if self._start_ns is None:
                self.inputs.statistics.real_time = real_time
                if self.inputs.board.on_a_finger and not real_time:
                    self._emit(Note(0, priority_advice()))
            self.resume()
            yield

    def resume(self) -> None:
        """Go on from now, where nothing was sent for a while."""
        if self._start_ns is None:
            self._start_ns = self._clock.now_ns()
            return
        idle_ns = self.time_ns() - self.elapsed_ns
        if idle_ns > 0:
            self.elapsed_ns += idle_ns
            self._expected_ns, self._over_ns = None, 0

    def time_ns(self) -> int:
        """Return the time since the start of the run, ns, without delays of its schedule."""
        return self._clock.now_ns() - (self._start_ns or 0) - self._shift_ns

    def begins_at_zero(self) -> bool:
        """Return whether intensity will begin at zero with the next step."""
        return self.inputs.begins_at_zero(self.elapsed_ns, self._clock.now_ns())

    def end(self) -> None:
        """Wait until the board has delivered everything, and complete the statistics."""
        self.inputs.board.drain()
        if self._phase is not None:
            self._phase.follow(self._shift_ns)
        if self._start_ns is not None:
            self.inputs.statistics.seconds = (self._clock.now_ns() - self._start_ns) / 1e9
        self._emit(RunEnded(self.elapsed_ns, self.stop.reason or self.inputs.source.ended))

    def wait(self) -> bool:
        """Wait for the next deadline; return False if the run ends there."""
        self._clock.wait_until(self._deadline_ns, self.stop.event)
        seconds, now_s = self._seconds, (self._clock.now_ns() - (self._start_ns or 0)) / 1e9
        if seconds is not None and now_s >= seconds and not self.stop.event.is_set():
            self.inputs.statistics.seconds = now_s
            self.stop.ask(f"time limit of {seconds:g} s", at_once=False)
        return not self.stop.event.is_set()

    def deliver(self) -> bool:
        """Deliver one input; return False at the end of the source or of the run."""
        board, clock = self.inputs.board, self._clock
        # In this order: a pause of the computer between the two makes the frame late.
        board_ns = board.clock.now_ns() if self._own_time else None
        now_ns = clock.now_ns()
        self.inputs.statistics.seconds = (now_ns - (self._start_ns or 0)) / 1e9
        late_ns = now_ns - self._deadline_ns
        return self._deliver(now_ns, late_ns, now_ns if board_ns is None else board_ns)

    @property
    def _deadline_ns(self) -> int:
        return (self._start_ns or 0) + self.elapsed_ns + self._shift_ns

    def _move(self, by_ns: int) -> None:
        """Move the schedule later: what comes then is not late."""
        self._shift_ns += by_ns
        self._over_ns += by_ns
        if self._expected_ns is not None:
            self._expected_ns += by_ns

    def _deliver(self, now_ns: int, late_ns: int, board_ns: int) -> bool:
        """Deliver one input; return False at the end of the source."""
        # The skin waits since the sequence before was over, whatever the plan says.
        waits_ns = max(0, late_ns, now_ns - self._over_ns if self._over_ns else 0)
        # By simulated time no skin has waited.
        stalled = waits_ns > LATE_NS and not self.inputs.board.simulated_time
        # After a stall, plan again from now.
        due_ns = board_ns if stalled else board_ns - waits_ns
        inputs, clock = self.inputs, self._clock
        pipeline, board = inputs.pipeline, inputs.board
        if stalled:
            # The board may have fallen silent.
            inputs.begin_at_zero()
        read = inputs.read(self.elapsed_ns, now_ns)
        if read is None:
            return False
        in_hand_ns, worked_ns = clock.now_ns(), time.thread_time_ns()
        observed = () if self._regulator is None else self._regulator.observe(board.take_volts())
        step = pipeline.process(*read, board.allowed_level(read[0].time_ns))
        if self._regulator is not None:
            step = self._regulator.regulate(step, observed)
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
            None if self._phase is None else self._phase.newest,
            now_ns - (self._start_ns or 0),
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
        for follow in self._steps:
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
                self._emit(BoardRestarted(self.elapsed_ns, str(lost)))
            if late:
                self._report_late_ns = self.elapsed_ns + _LATE_AGAIN_NS
            if self._regulator is not None:
                self._regulator.lost(step.sequence)
            self.inputs.pipeline.restart_softly()
            return None

    def _plan_next(self, result: StepResult, sent: Sent, now_ns: int) -> None:
        """Enter a step into the statistics, and move the schedule by what it took."""
        statistics, period_ns = self.inputs.statistics, sent.period_ns
        if result.number is None:
            self._shift_ns += sent.sent_ns - now_ns
            self._expected_ns = None
            self._over_ns = 0
            if self._phase is not None:
                self._phase.forget()
        else:
            expected_ns, self._expected_ns = self._expected_ns, now_ns + period_ns
            error_us = None if expected_ns is None else abs(now_ns - expected_ns) / 1000
            statistics.enter(result, error_us)
            self._over_ns = sent.sent_ns + period_ns
            # After a wait the board's clock is behind: frames taken later reach the skin as soon,
            # and fresher.
            self._shift_ns += sent.waited_ns
            late_ns = now_ns - sent.deadline_ns
            if late_ns > period_ns:
                statistics.late += 1
                self._shift_ns += late_ns
            if self._phase is not None:
                self._phase.note(sent)
                self._move(self._phase.follow(self._shift_ns))
        self.elapsed_ns += period_ns
