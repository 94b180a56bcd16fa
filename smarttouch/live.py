"""The loop: one clock, absolute deadlines, and an orderly end whatever happens."""

import contextlib
import gc
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import cv2
import numpy as np

from smarttouch.boards.board import Board
from smarttouch.clock import LATE_NS, Clock
from smarttouch.controls import Controls, Wish
from smarttouch.errors import (
    BoardError,
    BoardRestartedError,
    BoardStoppedError,
    SequenceLateError,
)
from smarttouch.pipeline import Pipeline, Step
from smarttouch.realtime import Pace, paced
from smarttouch.regulator import Regulator
from smarttouch.sources.forces.force import ForceSource
from smarttouch.sources.frame import Frame, Sensor
from smarttouch.stopping import StopRequest
from smarttouch.tally import Tally

HELD_UP_NS = 1_000_000
"""A send that takes longer than this has waited for the board."""
LIFT_NS = 300_000_000
"""After a lifted finger: so long there is no current, then it rises from zero again."""

Tell = Callable[[int, str], None]
"""Told of what happens: nanoseconds since the start of the run, and a few words."""


@dataclass(frozen=True, eq=False)
class Sent:
    """One step, and how it went out.

    Attributes
    ----------
    step : Step
    number : int or None
        The board's number of its sequence; None if the board was lost with it.
    latency_us : float
        From the frame in hand to the last byte written.
    work_us : float
        Processor time that it took the loop.
    """

    step: Step
    number: int | None
    latency_us: float
    work_us: float = 0.0


@contextmanager
def settled(pipeline: Pipeline) -> Iterator[None]:
    """Do what takes long before a board is open: it would take the delay for a lost host."""
    pipeline.warm_up()
    gc.collect()
    gc.freeze()
    threads = cv2.getNumThreads()
    # Images are small: a second thread costs more than it saves, and takes the other core.
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)
        gc.unfreeze()


def run(
    sensor: Sensor,
    pipeline: Pipeline,
    board: Board,
    *,
    stop: StopRequest,
    tally: Tally,
    seconds: float | None = None,
    observers: Sequence[Callable[[Sent], None]] = (),
    controls: Controls | None = None,
    force: ForceSource | None = None,
    tell: Tell = lambda _time_ns, _words: None,
    regulator: Regulator | None = None,
    clock: Clock | None = None,
) -> None:
    """Let the finger feel what the sensor sees until the sensor ends.

    The sensor is asked for a frame at each deadline; the next deadline is one
    sequence later, so a frame that needs longer to scan lowers the rate and
    nothing queues. A late loop moves its schedule and never hurries.

    Parameters
    ----------
    sensor, pipeline, board
        An open sensor, a fresh pipeline, an open board. The caller closes them.
    stop : StopRequest
        Ends the run early, and says why.
    tally : Tally
        Filled as the run goes, so that it is there after a fault.
    seconds : float, optional
        Longest run by the clock.
    observers : sequence of callable
        Told of every step, also of one that was lost with the board.
    controls : Controls, optional
        What the user wants; full intensity in the pipeline's mode if not given, which is for
        boards that no finger is on.
    force : ForceSource, optional
        How hard the finger presses; the sensor's own word if not given.
    tell : callable, optional
        Told of what users do and of what goes wrong.
    regulator : Regulator, optional
        What the board's own measurements do to the sequences.
    clock : Clock, optional
        The board's if not given.

    Raises
    ------
    BoardError
        If nobody says how strong it may be on a board that may have a finger on it, and
        whatever the board raises.
    """
    if controls is None and board.on_a_finger:
        raise BoardError(
            "there may be a finger on this board, and nobody says how strong it may be: give "
            "controls, for example Controls(Wish(mode, level=0)), and raise the level from there"
        )
    controls = controls or Controls(Wish(pipeline.mode))
    inputs = _Inputs(sensor, force, board, pipeline, controls, tally, tell)
    loop = _Loop(inputs, regulator or Regulator(), stop, observers, clock or board.clock)
    with contextlib.nullcontext(Pace()) if board.waits_for_nothing else paced() as pace:
        tally.real_time = pace.real_time
        for note in pace.notes if board.on_a_finger else ():
            tell(0, note)
        loop.run(seconds)
    tell(loop.elapsed_ns, stop.reason or "the end of what the sensor sees")


@dataclass
class _Inputs:
    """What comes into the loop, and what is made of it where something is not known."""

    sensor: Sensor
    force: ForceSource | None
    board: Board
    pipeline: Pipeline
    controls: Controls
    tally: Tally
    tell: Tell
    _told: Wish | None = None
    _blind: bool = False
    _lifted_until_ns: int = 0

    def look(self, time_ns: int) -> Frame | None:
        """Return the frame with the force that counts: zero where it or the image is unknown."""
        frame = self.sensor.read(time_ns)
        if frame is None:
            return None
        self.tally.see(frame)
        force_n = self._force_n(frame, time_ns)
        blind = frame.stale or math.isnan(force_n)
        self.tally.blind += blind
        if blind is not self._blind:
            what = "the image is stale" if frame.stale else "the force is not known"
            self.tell(time_ns, f"{what}: no current" if blind else "image and force are known")
            self._blind = blind
        counts_n = 0.0 if blind else force_n
        return frame if counts_n == frame.force_n else replace(frame, force_n=counts_n)

    def _force_n(self, frame: Frame, time_ns: int) -> float:
        """Return the word of whom was asked, NaN if they do not know; the board may lower it."""
        on_board = self.board.force_n
        if self.force is not None:
            force_n = self.force.read(time_ns)
        elif self.sensor.knows_force or on_board is None:
            force_n = frame.force_n
        else:
            force_n = on_board
        if on_board is None or math.isnan(force_n):
            return force_n
        return min(force_n, on_board)

    def wish(self, time_ns: int) -> Wish:
        """Return what the user wants; tell of what has changed."""
        wish, told = self.controls.wish(time_ns), self._told
        if wish != told:
            if told is None or wish.level != told.level:
                self.tell(time_ns, f"intensity {wish.level:.2f}")
            if wish.paused != (told is not None and told.paused):
                self.tell(time_ns, "paused" if wish.paused else "goes on")
            if told is None or wish.mode is not told.mode:
                self.tell(time_ns, f"mode {wish.mode}")
            self._told = wish
        if wish.mode is not self.pipeline.mode:
            self.pipeline.change_mode(wish.mode)
        return wish

    def heed_lifts(self, time_ns: int, now_ns: int) -> None:
        """Feel nothing for a while after the board found the finger lifted."""
        if self.board.lifted and now_ns >= self._lifted_until_ns:
            # Only a pulse can tell whether the finger is back: try again, from zero.
            self.board.lifted = False
            self.tally.lifts += 1
            self.tell(time_ns, "the finger is lifted")
            self._lifted_until_ns = now_ns + LIFT_NS
        if now_ns < self._lifted_until_ns:
            self.pipeline.restart_softly()


@dataclass
class _Loop:
    inputs: _Inputs
    regulator: Regulator
    stop: StopRequest
    observers: Sequence[Callable[[Sent], None]]
    clock: Clock
    elapsed_ns: int = 0
    _shift_ns: int = 0
    _before_ns: int | None = None
    _period_ns: int = 0
    _over_ns: int = 0

    def run(self, seconds: float | None) -> None:
        tally, clock, stop = self.inputs.tally, self.clock, self.stop
        start_ns = clock.now_ns()
        while not stop.event.is_set():
            deadline_ns = start_ns + self.elapsed_ns + self._shift_ns
            clock.wait_until(deadline_ns, stop.event)
            if stop.event.is_set():
                break
            # In this order: a pause of the computer between the two makes the frame late.
            board_ns, now_ns = self.inputs.board.clock.now_ns(), clock.now_ns()
            tally.seconds = (now_ns - start_ns) / 1e9
            if seconds is not None and tally.seconds >= seconds:
                stop.ask(f"{seconds:g} s are over", at_once=False)
                break
            late_ns = now_ns - deadline_ns
            if not self._step(now_ns, late_ns, board_ns):
                break
        self.inputs.board.drain()
        tally.seconds = (clock.now_ns() - start_ns) / 1e9

    def _step(self, now_ns: int, late_ns: int, board_ns: int) -> bool:
        """Let one frame be felt; return False where there is none any more."""
        # The skin waits since the sequence before was over, whatever the plan says.
        waits_ns = max(0, late_ns, now_ns - self._over_ns if self._over_ns else 0)
        stalled = waits_ns > LATE_NS
        # After a stall the plan is a new one.
        due_ns = board_ns if stalled else board_ns - waits_ns
        inputs, clock, elapsed_ns = self.inputs, self.clock, self.elapsed_ns
        pipeline, tally = inputs.pipeline, inputs.tally
        if stalled:
            # The board may have fallen silent.
            pipeline.restart_softly()
        frame = inputs.look(elapsed_ns)
        if frame is None:
            return False
        wish = inputs.wish(elapsed_ns)
        inputs.heed_lifts(elapsed_ns, now_ns)
        in_hand_ns, worked_ns = clock.now_ns(), time.thread_time_ns()
        step = self.regulator.regulate(pipeline.process(frame, wish.current_level), inputs.board)
        sending_ns = clock.now_ns()
        try:
            number = self._send(step, due_ns)
        except BoardStoppedError:
            if not self.stop.event.is_set():
                raise
            return False
        sent_ns = clock.now_ns()
        work_us = (time.thread_time_ns() - worked_ns) / 1000
        sent = Sent(step, number, (sent_ns - in_hand_ns) / 1000, work_us)
        period_ns = 1000 * step.sequence.period_us
        if number is None:
            self._shift_ns += sent_ns - now_ns
            self._before_ns = None
            self._over_ns = 0
        else:
            self._count(sent, now_ns)
            self._over_ns = sent_ns + period_ns
            waited_ns = sent_ns - sending_ns
            if HELD_UP_NS < waited_ns < LATE_NS:
                # The board's clock is behind: frames taken later reach the skin as soon, and
                # fresher.
                self._shift_ns += waited_ns
            if late_ns > period_ns:
                tally.late += 1
                self._shift_ns += late_ns
        self.elapsed_ns += period_ns
        for observe in self.observers:
            observe(sent)
        return True

    def _send(self, step: Step, due_ns: int) -> int | None:
        """Send; return the board's number of the sequence, None if it is to begin anew."""
        inputs = self.inputs
        try:
            return inputs.board.send(step.sequence, due_ns=due_ns)
        except BoardRestartedError as lost:
            inputs.tally.restarts += not isinstance(lost, SequenceLateError)
            inputs.tell(self.elapsed_ns, str(lost))
            inputs.pipeline.restart_softly()
            return None

    def _count(self, sent: Sent, now_ns: int) -> None:
        tally, sequence = self.inputs.tally, sent.step.sequence
        tally.feel(sent.step.frame)
        tally.slots += sequence.slots
        tally.weigh(sequence.proof)
        tally.slowed += sequence.period_us > sent.step.asked_us
        tally.asked_us += sent.step.asked_us
        tally.lowest_rate_hz = min(tally.lowest_rate_hz, sequence.rate_hz)
        tally.scan_us += sequence.period_us
        tally.latency.add(sent.latency_us)
        tally.motion_to_bytes.add(sent.latency_us + sent.step.frame.age_ns / 1000)
        tally.work.add(sent.work_us)
        activation = sent.step.tactile.activation
        tally.active += np.count_nonzero(activation.any(axis=0)) / activation.shape[1]
        if self._before_ns is not None:
            tally.period_error.add(abs(now_ns - self._before_ns - self._period_ns) / 1000)
        self._before_ns, self._period_ns = now_ns, 1000 * sequence.period_us
