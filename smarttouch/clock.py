"""Time, and waiting for a point in it."""

import threading
import time
from typing import Protocol

SPIN_NS = 300_000
"""The end of each wait is spun: a sleep alone wakes 0.1 to 0.2 ms late."""


class Clock(Protocol):
    """What a loop knows of time; tests give it one of their own."""

    def now_ns(self) -> int: ...

    def wait_until(self, deadline_ns: int, stop: threading.Event) -> None: ...


class MonotonicClock:
    """The machine's monotonic clock: sleeps to a deadline, then spins the last bit.

    Parameters
    ----------
    spin_ns : int
        How much of a wait is spun.
    """

    def __init__(self, spin_ns: int = SPIN_NS) -> None:
        self._spin_ns = spin_ns

    def now_ns(self) -> int:
        return time.perf_counter_ns()

    def wait_until(self, deadline_ns: int, stop: threading.Event) -> None:
        left = deadline_ns - self.now_ns()
        if left > self._spin_ns and stop.wait((left - self._spin_ns) / 1e9):
            return
        while self.now_ns() < deadline_ns and not stop.is_set():
            pass


class SimulatedClock:
    """Time that passes only by being waited for: a run takes as long as its computing does."""

    def __init__(self) -> None:
        self._now_ns = 0

    def now_ns(self) -> int:
        return self._now_ns

    def wait_until(self, deadline_ns: int, stop: threading.Event) -> None:
        self._now_ns = max(self._now_ns, deadline_ns)
