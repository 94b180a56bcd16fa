"""Clocks, waiting for a time, and real-time priority, so that packets leave on time.

Processes that only compute do not hold up a thread of real-time priority (``SCHED_FIFO``). Linux
gives it to root, and to users whose limit ``rtprio`` allows it.
"""

import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

PRIORITY = 1  # priority of the threads that pace and send: the lowest above all ordinary ones
_FIFO: int | None = getattr(os, "SCHED_FIFO", None)
_RESET: int = getattr(os, "SCHED_RESET_ON_FORK", 0)


def priority_advice() -> str:
    """Return a sentence on how to allow real-time priority."""
    if _FIFO is None:
        return "this system has no real-time priority: packets may be late while it is busy"
    return (
        "without real-time priority packets may be some ms late while the machine is busy: to "
        "allow it, write '* - rtprio 5' into /etc/security/limits.d/smarttouch.conf and log in "
        "again"
    )


@contextmanager
def prioritized() -> Iterator[bool]:
    """Give this thread real-time priority in the block; yield whether that is allowed.

    Threads and processes that begin meanwhile have the usual priority.
    """
    if _FIFO is None:
        yield False
        return
    before = os.sched_getscheduler(0) & ~_RESET, os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, _FIFO | _RESET, os.sched_param(PRIORITY))
    except OSError:
        yield False
        return
    try:
        yield True
    finally:
        # Without this flag only root may set it: it stays, whatever this thread does.
        os.sched_setscheduler(0, before[0] | _RESET, before[1])


def is_prioritized() -> bool:
    """Return whether the calling thread has real-time priority."""
    return _FIFO is not None and os.sched_getscheduler(0) & ~_RESET == _FIFO


SPIN_NS = 300_000  # spun end of each wait at real-time priority: a sleep alone wakes .1 ms late
LATE_NS = 100_000_000
"""Delay after which nothing is sent to a board any more, and intensity restarts at zero."""

_CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
"""Clock that runs on while the machine is suspended, if there is one."""


def now_ns() -> int:
    """Return nanoseconds since the machine was started, with its time of sleep."""
    return time.clock_gettime_ns(_CLOCK)


class Clock(Protocol):
    """Interface of a loop's clock; tests use one of their own."""

    def now_ns(self) -> int: ...

    def wait_until(self, deadline_ns: int, stop: threading.Event) -> None: ...


class MonotonicClock:
    """The machine's clock, for threads that sleep to a deadline.

    It never goes back, and runs on while the machine is suspended: what was due before that is late
    after it. The end of a wait is spun: `SPIN_NS` in threads of real-time priority and nothing in
    others, where it gains nothing that repeats.
    """

    def __init__(self, spin_ns: int | None = None) -> None:
        self._spin_ns = spin_ns

    now_ns = staticmethod(now_ns)

    def wait_until(self, deadline_ns: int, stop: threading.Event) -> None:
        spin_ns = self._spin_ns
        if spin_ns is None:
            spin_ns = SPIN_NS if is_prioritized() else 0
        left = deadline_ns - self.now_ns()
        if left > spin_ns and stop.wait((left - spin_ns) / 1e9):
            return
        while self.now_ns() < deadline_ns and not stop.is_set():
            pass


class SimulatedClock:
    """Simulated time that passes only by waiting: a run takes as long as its computation."""

    def __init__(self) -> None:
        self._now_ns = 0

    def now_ns(self) -> int:
        return self._now_ns

    def wait_until(self, deadline_ns: int, stop: threading.Event) -> None:
        self._now_ns = max(self._now_ns, deadline_ns)
