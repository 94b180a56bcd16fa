"""Timing of a board: stops from any thread at any time, and refusal of late sequences."""

import threading
from typing import ClassVar, final

from smarttouch.boards.seal import Sealed
from smarttouch.clock import LATE_NS, Clock, MonotonicClock
from smarttouch.errors import BoardFaultError, BoardStoppedError, SequenceLateError


class Timely(Sealed):
    """Base class that tracks stops and refuses late sequences.

    It uses the machine's own clock, whatever clock a program passes.
    """

    simulated_time: ClassVar[bool] = False
    """Whether its time is simulated, without waiting."""
    dropped_late: int = 0
    """Number of sequences that were not sent because they were too late."""

    def __init__(self) -> None:
        self._clock: Clock = MonotonicClock()
        self._due_ns = 0
        """Planned start of the present sequence, by the clock."""
        self._stopped = threading.Event()
        self._halted = False
        self._fault_found: BoardFaultError | None = None
        """Fault that latched the board."""

    @property
    @final
    def clock(self) -> Clock:
        """Clock of planned sequences."""
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
            if self._fault_found is not None:
                raise self._fault_found
            again = "open a new display" if self._halted else "open it again"
            raise BoardStoppedError(
                f"the board was stopped, all electrodes are at zero: {again} before sending",
                about="board",
                problem="stopped",
            )

    def _pause(self, seconds: float) -> None:
        """Wait while the board is being opened; raise if it is stopped meanwhile."""
        self._stopped.wait(seconds)
        self._go_on_unless_stopped()

    @final
    def _is_late(self, due_ns: int) -> bool:
        return self.clock.now_ns() - due_ns > LATE_NS

    @final
    def _refuse_late(self, due_ns: int) -> None:
        """Drop a sequence whose planned start is too long ago."""
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
