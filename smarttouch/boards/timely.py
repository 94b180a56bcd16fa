"""Timing of a board: stops from any thread at any time, and refusal of late sequences."""

import contextlib
import threading
from abc import abstractmethod
from collections.abc import Iterator
from typing import ClassVar, final

from smarttouch.boards.seal import Sealed
from smarttouch.clock import LATE_NS, Clock, MonotonicClock
from smarttouch.errors import BoardFaultError, BoardStoppedError, SequenceLateError

WRITE_S = 0.6  # longest time that a stop waits for one write: ports give up after .5 s


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
        # Reentrant: a signal handler may stop while its own thread is writing.
        self._writing = threading.RLock()
        self._writes = 0
        self._overtaken = False
        """Whether a stop did not wait for the write under way."""
        self._zeroed = False
        """Whether a stop has put the board at zero."""

    @property
    @final
    def clock(self) -> Clock:
        """Clock of planned sequences."""
        return self._clock

    @final
    def _begin_unless_halted(self) -> None:
        self._overtaken = self._zeroed = False
        self._stopped.clear()
        # In this order: a halt from another thread is seen here or comes later.
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
            )

    @final
    @contextlib.contextmanager
    def _driving(self) -> Iterator[None]:
        """Hold the lock of `stop` for one write that makes current; nothing else waits within.

        A stop takes effect before the write, which is then refused, or after it. A write that
        lasts longer than `WRITE_S`, or in which a signal handler stops the board, is followed by
        zero.

        Raises
        ------
        BoardStoppedError
            If the board was stopped.
        """
        with self._writing:
            self._go_on_unless_stopped()
            self._writes += 1
            try:
                yield
            finally:
                self._writes -= 1
                if self._overtaken and not self._writes:
                    self._overtaken = False
                    self._stop()

    @final
    def _bar(self) -> None:
        """Refuse all current from now on, and wait for the end of the write under way."""
        self._stopped.set()
        self._interrupt()
        free = self._writing.acquire(timeout=WRITE_S)
        self._overtaken = not free or self._writes > 0
        if free:
            self._writing.release()

    def _interrupt(self) -> None:
        """End work that a stop would have to wait for, such as a write in pieces."""

    @abstractmethod
    def _stop(self) -> None:
        """Put all electrodes at zero, from any thread."""

    def _pause(self, seconds: float) -> None:
        """Wait while the board opens or measures; raise if it is stopped meanwhile."""
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
        )
