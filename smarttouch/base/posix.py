"""What only POSIX has: modules, flags of `os.open`, file locks, users and real-time priority.

On other systems modules are None, flags 0 and the rest does nothing, so that all works that needs
no terminal and no watchdog process.
"""

import ctypes
import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # a module cannot be None for a type checker; users of one check first
    import fcntl
    import pty
    import termios
    import tty
else:
    try:
        import fcntl
        import pty
        import termios
        import tty
    except ImportError:
        fcntl = pty = termios = tty = None

__all__ = ["fcntl", "pty", "termios", "tty"]

HAS_POSIX: bool = fcntl is not None

O_NOCTTY, O_NONBLOCK, O_NOFOLLOW, O_BINARY = (
    getattr(os, name, 0) for name in ("O_NOCTTY", "O_NONBLOCK", "O_NOFOLLOW", "O_BINARY")
)


def try_lock(number: int, shared: bool = False) -> bool:
    """Lock an open file until it is closed; return False if another process has it locked.

    File systems without locks count as free.
    """
    try:
        if fcntl is not None:
            fcntl.flock(number, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        elif sys.platform == "win32":
            import msvcrt

            msvcrt.locking(number, msvcrt.LK_NBLCK, 1)
    except OSError as error:
        return error.errno not in (errno.EAGAIN, errno.EACCES, errno.EDEADLK)
    return True


def user_number() -> int | None:
    """Return the number of this process's user; None where users have none."""
    return os.geteuid() if hasattr(os, "geteuid") else None


def write_now(number: int, data: bytes) -> int:
    """Write to a descriptor while no other Python thread runs, so that nothing delays it; return
    the number of bytes written. POSIX only."""
    written = int(_write(number, data, len(data)))
    if written < 0:
        failure = ctypes.get_errno()
        raise OSError(failure, os.strerror(failure))
    return written


if HAS_POSIX:
    _write = ctypes.PyDLL(None, use_errno=True).write
    _write.argtypes = (ctypes.c_int, ctypes.c_char_p, ctypes.c_size_t)
    _write.restype = ctypes.c_ssize_t


# Processes that only compute do not hold up a thread of real-time priority (``SCHED_FIFO``). Linux
# gives it to root, and to users whose limit ``rtprio`` allows it.
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
