"""Request to a session: a pattern, its level and duration, and its outcome."""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.board import Board
from smarttouch.running.step import StepResult
from smarttouch.sources.source_contract import Frame

STEADY = 0.98  # part of a level that counts as reached
FAINT = 0.01  # activation of pulses that open a level: those of threshold
SILENT_US = 20_000  # period of a silence that is asked for, and of pulses that open a level


Level = float | Callable[[float], float | None]
"""Part of an intensity, in [0, 1]; or a function of the seconds since a pattern began, which ends
it by None."""


@dataclass(eq=False)
class Show:
    """A requested pattern or silence, and its outcome.

    Without seconds a pattern is its level alone, and a silence lasts until its level is None.
    """

    pattern: NDArray[np.float32] | Frame | None
    level: Level
    seconds: float | None
    opens: float | None = None  # level that must be open before it begins
    patience_s: float | None = None
    at_ns: int | None = None
    period_us: int | None = None
    exact: bool = False  # whether neither force nor the user's level may lower it
    least: float = STEADY  # part of what is asked below which its level is lost
    over: threading.Event = field(default_factory=threading.Event)
    fault: str = ""
    began: bool = False
    asked_ns: int | None = None
    time_ns: int = 0
    clock_ns: int = 0
    first: int | None = None  # number of its first sequence
    board_us: int | None = None
    ramped_ns: int = 0
    sequences: int = 0
    pulses: int = 0
    lowest: float | None = None
    current_ma: float = 0.0  # strongest of its last pulses
    faint: float = FAINT

    def level_at(self, since_ns: int) -> float | None:
        """Return its level a while after it began; None where that ends it."""
        return self.level(since_ns / 1e9) if callable(self.level) else self.level

    def is_past(self, time_ns: int, least_ns: int) -> bool:
        """Return whether it is over; no silence is shorter than ``least_ns``."""
        if not self.began or self.seconds is None:
            return bool(self.fault)
        left_ns = self.time_ns + round(1e9 * self.seconds) - time_ns
        return bool(self.fault) or left_ns < (least_ns if self.pattern is None else 1)

    def silence_us(self, time_ns: int, usual_us: int, least_us: int) -> int:
        """Return the next part of a silence, which ends at its end to the microsecond."""
        if self.seconds is None:
            return usual_us
        left_us = (self.time_ns + round(1e9 * self.seconds) - time_ns) // 1000
        return left_us if left_us <= usual_us + least_us else usual_us

    def note(self, result: StepResult, asked: float) -> None:
        """Note a step of it, or of the pulses before it, that requested an intensity."""
        step, sequence = result.step, result.step.sequence
        if not self.began:
            if 0 < STEADY * asked <= sequence.intensity:
                # Claimed in full, and not open: pulses this weak do not open that much, and where
                # the strongest are none, there is nothing to open.
                if self.faint == 1 and not sequence.slots:
                    self.opens = None
                self.faint = min(1.0, 2 * self.faint)
            return
        self.first = result.number if self.first is None else self.first
        self.sequences += 1
        self.pulses += sequence.slots
        self.lowest = min(sequence.intensity, math.inf if self.lowest is None else self.lowest)
        if sequence.slots:
            self.current_ma = float(np.abs(sequence.current_ua).max()) / 1000
        lost = result.number is None or step.restarted or (asked == 0 and not self.exact)
        if lost or sequence.intensity < self.least * asked:
            self.fault = (
                f"its level was lost after {self.sequences} sequences: the finger was lifted, the "
                "session paused, or the board lost"
            )

    def note_start(self, board: Board) -> None:
        """Note when its first pulse began, if the board reports it."""
        start = None if self.first is None else board.start_of(self.first)
        if start is not None:
            self.board_us = start.board_us
            if not board.simulated_time:
                # The board's clock may run while the machine sleeps, the program's does not.
                self.clock_ns = time.monotonic_ns() - (board.clock.now_ns() - start.time_ns)

    def end(self, why: str) -> None:
        """End it before its time."""
        self.fault = why
        self.over.set()
