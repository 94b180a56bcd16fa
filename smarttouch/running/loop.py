"""The loop: one clock, absolute deadlines, and an orderly end whatever happens."""

import contextlib
import gc
import logging
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from operator import itemgetter

import cv2

from smarttouch.base.clock import LATE_NS, Clock, SimulatedClock
from smarttouch.base.errors import (
    BoardRestartedError,
    BoardStoppedError,
    SequenceLateError,
)
from smarttouch.base.events import BoardRestarted, Emit, Event, Note, RunEnded
from smarttouch.base.posix import prioritized, priority_advice
from smarttouch.base.stopping import StopRequest
from smarttouch.boards.board import Board
from smarttouch.running.inputs import Controls, Inputs
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.run_statistics import RunStatistics
from smarttouch.running.step import FirstPulse, Listener, OnStep, Step, StepResult
from smarttouch.sources.force import ForceSource
from smarttouch.sources.source_contract import Source

GUARD_NS = 500_000  # time kept beside the usual delay of a sequence
HELD_UP_NS = 1_000_000
"""A send that takes longer than this, beside its own work, has waited for the board."""
_IDLE_NS = 1_000_000
"""Pause of the board from which a sequence counts as late; below, the board itself may be."""
_LATE_AGAIN_NS = 5_000_000_000  # time without a delay after which the next one is reported
_OF_20 = 20  # one sequence in so many may come late
_REMEMBERED = 250  # sequences for which it is remembered what the line took

LOG = logging.getLogger("smarttouch.run")
"""Logger of events: to a program's handlers, and nowhere without them."""
logging.getLogger("smarttouch").addHandler(logging.NullHandler())


def emit_to(listeners: Sequence[Listener]) -> Emit:
    """Return a function that logs an event and hands it to each of these listeners."""

    def emit(event: Event) -> None:
        LOG.info("%.1f s: %s", event.time_ns / 1e9, event)
        for listener in listeners:
            listener.event(event)

    return emit


@contextmanager
def steady_environment(pipeline: Pipeline, simulated_time: bool = False) -> Iterator[None]:
    """Warm a pipeline up, freeze garbage collection and keep OpenCV to one thread in the block.

    Before a board is open: it would take the delay for a lost host. In simulated time, where
    nothing is late, OpenCV alone is kept to one thread.
    """
    threads = cv2.getNumThreads()
    # Images are small: a second thread costs more than it saves, and takes the other core.
    cv2.setNumThreads(1)
    # What a program has frozen for itself stays so.
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


@dataclass(frozen=True)
class Sent:
    """Sequence that was sent; times by the loop's clock."""

    number: int
    taken_ns: int  # when its image was taken
    deadline_ns: int
    elapsed_ns: int  # time of the run at its deadline
    waited_ns: int  # for a place on the board, where that was the board's doing
    sent_ns: int
    period_ns: int
    ahead_ns: int  # of the board's clock, of the loop's


class PhaseLock:
    """Shift of a loop's deadlines by the times at which a board says it began earlier sequences.

    A sequence is complete some delay after its deadline. Deadlines move later until they lie
    before the board's need by the delay that 19 of 20 of the last ones had, what the line takes,
    and `GUARD_NS`: images are as fresh as they can be. They never move earlier: a sequence that
    comes late makes the board wait, and thereby moves all its later needs.
    """

    def __init__(self, board: Board, statistics: RunStatistics) -> None:
        self._board, self._statistics = board, statistics
        self._pending: deque[Sent] = deque(maxlen=8)
        self._delays_ns: deque[int] = deque(maxlen=64)
        self._lines: deque[tuple[int, int]] = deque(maxlen=8)
        """Of sequences for which the board waited: number, and from last byte to start, ns."""
        self._free_ns: int | None = None
        """When the board was free after the newest sequence whose start is known."""
        self.newest: FirstPulse | None = None
        """Of the newest sequence whose start has become known since the step before."""

    def follow(self, zero_ns: int, sent: Sent | None = None) -> int:
        """Note what was sent, and return by how much deadlines move later; the run's time is now 0
        at ``zero_ns`` of the loop's clock."""
        if sent is not None:
            self._delays_ns.append(sent.sent_ns - sent.waited_ns - sent.deadline_ns)
            self._pending.append(sent)
        self.newest, more_ns = None, 0
        for earlier in list(self._pending):
            start = self._board.start_of(earlier.number)
            if start is None:
                continue
            self._pending.remove(earlier)
            begun_ns = start.time_ns - earlier.ahead_ns
            waited_ns, number = begun_ns - earlier.sent_ns, earlier.number
            taken_ns = begun_ns - earlier.taken_ns
            self.newest = FirstPulse(number, taken_ns / 1000, waited_ns / 1000)
            self._statistics.first_pulse.add(taken_ns / 1000)
            self._statistics.waited.add(waited_ns / 1000)
            while self._lines and self._lines[0][0] < number - _REMEMBERED:
                self._lines.popleft()
            # What the line usually takes, from two sequences on: one may have been held up.
            lines, line_ns = sorted(self._lines, key=itemgetter(1)), 0
            if len(lines) > 1:
                line_ns = lines[(len(lines) - 1) // 2][1]
            if self._free_ns is not None and begun_ns > self._free_ns + _IDLE_NS:
                self._lines.append((number, waited_ns))
                line_ns = max(line_ns, waited_ns)
            self._free_ns = begun_ns + earlier.period_ns
            # The delay that 19 of 20 keep.
            usual_ns = sorted(self._delays_ns)[-1 - len(self._delays_ns) // _OF_20]
            room_ns = begun_ns - zero_ns - earlier.elapsed_ns
            more_ns = max(0, room_ns - line_ns - usual_ns - GUARD_NS)
        return more_ns

    def forget(self) -> None:
        """Discard what was sent: the board was lost."""
        self._pending.clear()
        self._free_ns = None


class Loop:
    """Delivers what a source gives to an open board, one sequence after another.

    The source is read at each deadline; the next deadline is one sequence later, so an input that
    needs longer to scan lowers the rate and nothing queues. A late loop moves its schedule and
    never hurries. Statistics are filled as the run goes, so that they are there after a fault;
    listeners also get a step that was lost with the board.
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
            # A source that depends on how its frames were delivered.
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
        """Whether time passes only by waiting, as fast as this computer can."""
        # By simulated time no skin has waited.
        self._may_stall = not board.simulated_time
        self._seconds = seconds
        self._start_ns: int | None = None
        # By the loop's clock: when the run's time was 0, moved later by every delay; when the
        # sequence before is over; when the next step is expected, by the one before.
        self._zero_ns = self._over_ns = self._report_late_ns = 0
        self._expected_ns: int | None = None

    def run(self) -> None:
        """Deliver inputs until the source ends or a stop is requested."""
        with self.steady():
            while self.wait() and self.deliver():
                pass
        self.end()

    @contextmanager
    def steady(self) -> Iterator[None]:
        """Go on from now, in a block whose thread has real-time priority if that is allowed."""
        with prioritized() if self._may_stall else contextlib.nullcontext(False) as real_time:
            if self._start_ns is None:
                self.inputs.statistics.real_time = real_time
                if self.inputs.board.on_a_finger and not real_time:
                    self._emit(Note(0, priority_advice()))
            self.resume()
            yield

    def resume(self) -> None:
        """Go on from now, where nothing was sent for a while."""
        if self._start_ns is None:
            self._start_ns = self._zero_ns = self._clock.now_ns()
        elif (idle_ns := self.time_ns() - self.elapsed_ns) > 0:
            self.elapsed_ns += idle_ns
            self._expected_ns, self._over_ns = None, 0

    def time_ns(self) -> int:
        """Return the time since the start of the run, ns, without delays of its schedule."""
        return self._clock.now_ns() - self._zero_ns

    def begins_at_zero(self) -> bool:
        """Return whether intensity will begin at zero with the next step."""
        return self.inputs.begins_at_zero(self.elapsed_ns, self._clock.now_ns())

    def end(self) -> None:
        """Wait until the board has delivered everything, and complete the statistics."""
        self.inputs.board.drain()
        if self._phase is not None:
            self._phase.follow(self._zero_ns)
        if self._start_ns is not None:
            self.inputs.statistics.seconds = (self._clock.now_ns() - self._start_ns) / 1e9
        self._emit(RunEnded(self.elapsed_ns, self.stop.reason or self.inputs.source.ended))

    def wait(self) -> bool:
        """Wait for the next deadline; return False if the run ends there."""
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
        # In this order: a pause of the computer between the two makes the frame late.
        board_ns, now_ns = board.clock.now_ns(), clock.now_ns()
        since_ns, deadline_ns = now_ns - (self._start_ns or 0), self._zero_ns + self.elapsed_ns
        inputs.statistics.seconds = since_ns / 1e9
        # The skin waits since the sequence before was over, whatever the plan says.
        waits_ns = max(0, now_ns - deadline_ns, now_ns - self._over_ns if self._over_ns else 0)
        if waits_ns > LATE_NS and self._may_stall:
            # After a stall, plan again from now. The board may have fallen silent.
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
        # Proving and writing are the loop's own work, however long.
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
        """Begin at zero after a sequence that was lost with the board, or too late to be sent."""
        late = isinstance(lost, SequenceLateError)
        self.inputs.statistics.restarts += not late
        # A busy computer is late again and again: what is dropped is counted.
        if not late or self.elapsed_ns >= self._report_late_ns:
            self._emit(BoardRestarted(self.elapsed_ns, str(lost)))
        if late:
            self._report_late_ns = self.elapsed_ns + _LATE_AGAIN_NS
        self.inputs.pipeline.regulator.take_back(step.sequence)
        self.inputs.pipeline.restart_softly()

    def _plan_next(self, result: StepResult, sent: Sent, now_ns: int) -> None:
        """Enter a step into the statistics, and move the schedule by what it took."""
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
            # After a wait the board's clock is behind: frames taken later reach the skin as soon,
            # and fresher.
            self._zero_ns += sent.waited_ns
            if late_ns > sent.period_ns:
                statistics.late += 1
                self._zero_ns += late_ns
            more_ns = 0 if phase is None else phase.follow(self._zero_ns, sent)
            # What comes later by the board's doing is not late.
            self._zero_ns += more_ns
            self._expected_ns = now_ns + sent.period_ns + more_ns
            self._over_ns = sent.sent_ns + sent.period_ns + more_ns
        self.elapsed_ns += sent.period_ns
