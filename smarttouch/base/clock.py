"""Clocks, waiting for a time, and real-time priority, so that packets leave on time.

Processes that only compute do not hold up a thread of real-time priority (``SCHED_FIFO``), and
what is locked in memory is never waited for from a disk. Linux gives both to root, and to users
whose limits ``rtprio`` and ``memlock`` allow it.
"""

import contextlib
import ctypes
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final, Protocol

from smarttouch.base.posix import resource, user_number

LOOP: Final = 1  # priority of the threads that pace and send: the lowest above all ordinary ones

_LOCK_NOW, _LOCK_LATER, _LOCK_TOUCHED = 1, 2, 4
_FIFO: int | None = getattr(os, "SCHED_FIFO", None)
_RESET: int = getattr(os, "SCHED_RESET_ON_FORK", 0)
_LIMIT: int | None = getattr(resource, "RLIMIT_RTPRIO", None)


@dataclass(frozen=True)
class Pace:
    """Real-time resources granted to a run: the thread's priority, and locked memory."""

    real_time: bool = False
    locked: bool = False

    @property
    def notes(self) -> list[str]:
        """One sentence on what is missing and how to allow it; empty if nothing is."""
        if self.real_time:
            return []
        if _FIFO is None:
            return ["this system has no real-time priority: packets may be late while it is busy"]
        return [
            "without real-time priority packets may be some ms late while the machine is busy: to "
            "allow it, write '* - rtprio 5' into /etc/security/limits.d/smarttouch.conf and log "
            "in again"
        ]


@contextmanager
def paced() -> Iterator[Pace]:
    """Give this thread real-time priority and lock the memory, as long as the block runs.

    Both are given back at the end. Threads and processes that begin meanwhile have the usual
    priority. Where the system does not allow one of them, the block runs without it.
    """
    with prioritized(LOOP) as real_time, _locked_memory() as locked:
        yield Pace(real_time, locked)


@contextmanager
def prioritized(level: int = LOOP) -> Iterator[bool]:
    """Give this thread real-time priority, 1 to 99, in the block; yield whether that is allowed."""
    before = _scheduling()
    given = before is not None and _give(level)
    try:
        yield given
    finally:
        if given and before is not None:
            policy, parameters = before
            # Without this flag only root may set it: it stays, whatever this thread does.
            os.sched_setscheduler(0, policy | _RESET, parameters)


def is_prioritized() -> bool:
    """Return whether the calling thread has real-time priority."""
    return _FIFO is not None and os.sched_getscheduler(0) & ~_RESET == _FIFO


def _scheduling() -> "tuple[int, os.sched_param] | None":
    if _FIFO is None:
        return None
    return os.sched_getscheduler(0) & ~_RESET, os.sched_getparam(0)


def _give(level: int) -> bool:
    return _set(level) or (_raise_own_limit(level) and _set(level))


def _set(level: int) -> bool:
    assert _FIFO is not None
    try:
        os.sched_setscheduler(0, _FIFO | _RESET, os.sched_param(level))
    except OSError:
        return False
    return True


def _raise_own_limit(level: int) -> bool:
    """Raise the limit to what an administrator allows, if the session has not."""
    if _LIMIT is None:
        return False
    soft, most = resource.getrlimit(_LIMIT)
    if not soft < level <= most:
        return False
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(_LIMIT, (level, most))
    return True


@contextmanager
def _locked_memory() -> Iterator[bool]:
    """Lock present memory, and later memory once it is used.

    Not where only a part may be locked: memory asked for later would be refused.
    """
    library = ctypes.CDLL(None, use_errno=True)
    locked = (
        hasattr(library, "mlockall")
        and _may_lock_all()
        and library.mlockall(_LOCK_NOW | _LOCK_LATER | _LOCK_TOUCHED) == 0
    )
    try:
        yield locked
    finally:
        if locked:
            library.munlockall()


def _may_lock_all() -> bool:
    unlimited = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
    return unlimited or user_number() == 0


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

    def now_ns(self) -> int:
        # As `now_ns`: one call, as a frame reads the time some ten times.
        return time.clock_gettime_ns(_CLOCK)

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
