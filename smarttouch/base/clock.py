"""Clocks of runs, real and simulated."""

import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Protocol

LATE_NS = 100_000_000
"""Delay beyond which a sequence is dropped and the ramp restarts at zero."""

_CLOCK: int | None = getattr(time, "CLOCK_BOOTTIME", getattr(time, "CLOCK_MONOTONIC", None))
"""Clock that continues while the machine is suspended, if the system has one."""


now_ns: Callable[[], int] = (
    time.monotonic_ns if _CLOCK is None else partial(time.clock_gettime_ns, _CLOCK)
)
"""Returns nanoseconds since the machine started, including the time it was suspended."""


class Clock(Protocol):
    """Interface of the clock that paces a run."""

    def now_ns(self) -> int: ...

    def wait_until(self, deadline_ns: int, stop: threading.Event) -> None: ...


class MonotonicClock:
    """The machine's clock, for threads that wait for deadlines.

    It is monotonic and also runs while the machine is suspended: sequences that become due during
    the suspension are late.
    """

    now_ns = staticmethod(now_ns)

    def wait_until(self, deadline_ns: int, stop: threading.Event) -> None:
        while (left_ns := deadline_ns - self.now_ns()) > 0 and not stop.wait(left_ns / 1e9):
            pass


class SimulatedClock:
    """Simulated clock: `wait_until` sets it to the deadline at once, so that runs never wait."""

    def __init__(self) -> None:
        self._now_ns = 0

    def now_ns(self) -> int:
        return self._now_ns

    def wait_until(self, deadline_ns: int, stop: threading.Event) -> None:
        self._now_ns = max(self._now_ns, deadline_ns)
