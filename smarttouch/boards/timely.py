"""A board in time: stopped from any thread at any instant, and never sent what is too late."""

import threading
from typing import ClassVar, final

from smarttouch.clock import LATE_NS, Clock, MonotonicClock
from smarttouch.errors import BoardStoppedError, SequenceLateError


class Timely:
    """Knows whether a board was stopped, and whether a sequence comes too late.

    It goes by the machine's own clock, whatever a program would tell it.
    """

    waits_for_nothing: ClassVar[bool] = False
    """Whether its time is a simulated one, that need not be waited for."""
    dropped_late: int = 0
    """Sequences that were not sent because it was too late for them."""

    def __init__(self) -> None:
        self._clock: Clock = MonotonicClock()
        self._due_ns = 0
        """When the sequence at hand was to start, by the clock."""
        self._stopped = threading.Event()
        self._halted = False

    @property
    @final
    def clock(self) -> Clock:
        """Clock by which sequences are planned."""
        return self._clock

    @final
    def _begin_unless_halted(self) -> None:
        self._stopped.clear()
        # In this order: a halt from another thread is seen here, or comes after the clearing.
        if self._halted:
            self._stopped.set()
        self._go_on_unless_stopped()

    @final
    def _go_on_unless_stopped(self) -> None:
        if self._stopped.is_set():
            raise BoardStoppedError(
                "the board was stopped, all electrodes are at zero: open it again before sending",
                about="board",
                problem="stopped",
            )

    def _pause(self, seconds: float) -> None:
        """Wait while the board is being opened; raise if it is stopped meanwhile."""
        self._stopped.wait(seconds)
        self._go_on_unless_stopped()

    @final
    def _is_late(self, due_ns: int) -> bool:
        return not self.waits_for_nothing and self.clock.now_ns() - due_ns > LATE_NS

    @final
    def _refuse_late(self, due_ns: int) -> None:
        """Drop a sequence that was to start too long ago."""
        if self._is_late(due_ns):
            self.dropped_late += 1
            raise self._late()

    @final
    def _late(self) -> SequenceLateError:
        return SequenceLateError(
            f"this computer stood still for more than {LATE_NS // 1_000_000} ms: what was due then "
            "was not sent, and intensity begins at zero",
            about="board",
            problem="late",
            allowed=LATE_NS,
        )
