"""Clocks, and waiting for a time."""

import threading
import time
from typing import Protocol

LATE_NS = 100_000_000
"""Delay after which nothing is sent to a board any more, and intensity restarts at zero."""

_CLOCK: int | None = getattr(time, "CLOCK_BOOTTIME", getattr(time, "CLOCK_MONOTONIC", None))
"""Clock that runs on while the machine is suspended, if there is one."""


def now_ns() -> int:
    """Return nanoseconds since the machine was started, with its time of sleep."""
    return time.monotonic_ns() if _CLOCK is None else time.clock_gettime_ns(_CLOCK)


class Clock(Protocol):
    """Interface of a loop's clock; tests use one of their own."""

    def now_ns(self) -> int: ...

    def wait_until(self, deadline_ns: int, stop: threading.Event) -> None: ...


class MonotonicClock:
    """The machine's clock, for threads that sleep to a deadline.

    It never goes back, and runs on while the machine is suspended: what was due before that is late
    after it.
    """

    now_ns = staticmethod(now_ns)

    def wait_until(self, deadline_ns: int, stop: threading.Event) -> None:
        while (left_ns := deadline_ns - self.now_ns()) > 0 and not stop.wait(left_ns / 1e9):
            pass


class SimulatedClock:
    """Simulated time that passes only by waiting: a run takes as long as its computation."""

    def __init__(self) -> None:
        self._now_ns = 0

    def now_ns(self) -> int:
        return self._now_ns

    def wait_until(self, deadline_ns: int, stop: threading.Event) -> None:
        self._now_ns = max(self._now_ns, deadline_ns)
