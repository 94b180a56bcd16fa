"""The loop: one clock, absolute deadlines, and an orderly end whatever happens."""

import gc
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from types import FrameType

import numpy as np

from smarttouch.boards.board import Board
from smarttouch.clock import Clock, MonotonicClock
from smarttouch.errors import BoardRestartedError
from smarttouch.pipeline import Pipeline, Step
from smarttouch.scan.adaptation import Adaptation
from smarttouch.scan.ledger import ChargeLedger
from smarttouch.sensing.frame import Frame, Sensor

STALL_NS = 100_000_000
"""After such a delay the board may have fallen silent: intensity starts from zero again."""
HELD_UP_NS = 1_000_000
"""A send that takes longer than this has waited for the board."""
LIFT_NS = 300_000_000
"""After a lifted finger: so long there is no current, then it rises from zero again."""


@dataclass
class StopRequest:
    """Set from a signal, another thread or the keyboard to end a run."""

    event: threading.Event = field(default_factory=threading.Event)
    reason: str = ""

    def ask(self, reason: str) -> None:
        # The first reason is the true one: a second Ctrl-C changes nothing.
        self.reason = self.reason or reason
        self.event.set()


@contextmanager
def stop_on_signals(stop: StopRequest) -> Iterator[None]:
    """Let SIGINT, SIGTERM and SIGHUP end the run in order."""
    names = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM", signal.SIGHUP: "SIGHUP"}

    def ask(number: int, _frame: FrameType | None) -> None:
        stop.ask(names[signal.Signals(number)])

    before = {number: signal.signal(number, ask) for number in names}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@dataclass(frozen=True)
class Sent:
    """One frame that went out."""

    step: Step
    number: int
    """The board's number of its sequence."""
    latency_us: float
    """From the frame in hand to the last byte written."""


@dataclass
class Tally:
    """What a run adds up to, kept as it goes."""

    frames: int = 0
    slots: int = 0
    slowed: int = 0
    """Sequences longer than the period asked for."""
    lowest_rate_hz: float = float("inf")
    late: int = 0
    """Frames that came more than a period after their time."""
    restarts: int = 0
    """How often the board was lost and started anew."""
    lifts: int = 0
    """How often the board found the finger lifted."""
    active: float = 0.0
    latency_us: list[float] = field(default_factory=list)
    seconds: float = 0.0

    def count(self, sent: Sent, asked_period_us: int) -> None:
        sequence = sent.step.sequence
        self.frames += 1
        self.slots += sequence.slots
        self.slowed += sequence.period_us > asked_period_us
        self.lowest_rate_hz = min(self.lowest_rate_hz, sequence.rate_hz)
        activation = sent.step.tactile.activation
        self.active += np.count_nonzero(activation.any(axis=0)) / activation.shape[1]
        self.latency_us.append(sent.latency_us)

    def latency(self) -> dict[str, float]:
        """Return p50, p99 and maximum latency, µs."""
        if not self.latency_us:
            return {"p50": 0.0, "p99": 0.0, "max": 0.0}
        p50, p99 = np.percentile(self.latency_us, (50, 99))
        return {"p50": float(p50), "p99": float(p99), "max": max(self.latency_us)}


@contextmanager
def settled(pipeline: Pipeline) -> Iterator[None]:
    """Do what takes long before a board is open: it would take the delay for a lost host."""
    pipeline.warm_up()
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


@dataclass
class Regulator:
    """Closes the loop from what the board measured to what it is sent next.

    Parameters
    ----------
    adaptation : Adaptation, optional
        Holds charge or energy against drifting impedance.
    ledger : ChargeLedger, optional
        Turns the polarity of a sequence where that brings net charge to zero.
    """

    adaptation: Adaptation | None = None
    ledger: ChargeLedger | None = None

    def regulate(self, step: Step, board: Board) -> Step:
        """Return the step with its sequence as it is to be sent."""
        if self.adaptation is not None:
            for sequence, volts in board.take_volts():
                self.adaptation.observe(sequence, volts)
            step = replace(step, sequence=self.adaptation.apply(step.sequence))
        if self.ledger is not None:
            step = replace(step, sequence=self.ledger.balancing(step.sequence))
            self.ledger.add(step.sequence)
        return step

    def notes(self) -> list[str]:
        """Return what a user should know after the run."""
        limited = () if self.adaptation is None else self.adaptation.limited
        if not limited:
            return []
        return [f"charge could not be held at {len(limited)} sites: pulses are at their longest"]


def run(
    sensor: Sensor,
    pipeline: Pipeline,
    board: Board,
    *,
    stop: StopRequest,
    tally: Tally,
    seconds: float | None = None,
    observers: Sequence[Callable[[Sent], None]] = (),
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
        Told of every frame sent.
    regulator : Regulator, optional
        What the board's own measurements do to the sequences.
    clock : Clock, optional
        The machine's if not given.
    """
    clock = clock or MonotonicClock()
    regulator = regulator or Regulator()
    start = clock.now_ns()
    elapsed = 0
    shift = 0
    lifted_until = start
    while not stop.event.is_set():
        clock.wait_until(start + elapsed + shift, stop.event)
        if stop.event.is_set():
            break
        now = clock.now_ns()
        tally.seconds = (now - start) / 1e9
        if seconds is not None and tally.seconds >= seconds:
            stop.ask(f"{seconds:g} s are over")
            break
        late = now - (start + elapsed + shift)
        if late > STALL_NS:
            pipeline.restart_softly()
        frame = sensor.read(elapsed)
        if frame is None:
            break
        if board.lifted and now >= lifted_until:
            # Only a pulse can tell whether the finger is back: try again, from zero.
            board.lifted = False
            tally.lifts += 1
            lifted_until = now + LIFT_NS
        if now < lifted_until:
            pipeline.restart_softly()
        in_hand = clock.now_ns()
        step = regulator.regulate(pipeline.process(_pressed(frame, board)), board)
        sending = clock.now_ns()
        try:
            number = board.send(step.sequence)
        except BoardRestartedError:
            tally.restarts += 1
            pipeline.restart_softly()
            shift += clock.now_ns() - now
            elapsed += step.sequence.period_us * 1000
            continue
        sent = Sent(step, number, (clock.now_ns() - in_hand) / 1000)
        waited = clock.now_ns() - sending
        if HELD_UP_NS < waited < STALL_NS:
            # The board's clock is behind: frames taken later reach the skin as soon, and fresher.
            shift += waited
        tally.count(sent, pipeline.period_us)
        for observe in observers:
            observe(sent)
        period_ns = step.sequence.period_us * 1000
        if late > period_ns:
            tally.late += 1
            shift += late
        elapsed += period_ns
    board.drain()
    tally.seconds = (clock.now_ns() - start) / 1e9


def _pressed(frame: Frame, board: Board) -> Frame:
    """Return the frame with the force that the board measures, if that is less."""
    if board.force_n is None or board.force_n >= frame.force_n:
        return frame
    return replace(frame, force_n=board.force_n)
