"""POSIX features: modules, flags of `os.open`, file locks, users and real-time priority.

On other systems these modules are None, the flags are 0, and the functions do nothing. Everything
then works except terminals and the watchdog process.
"""

import ctypes
import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # type checkers reject a module that can be None
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
    """Lock an open file until it is closed; return False if another process holds the lock. Return
    True on file systems without locks."""
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
    """Return the effective user ID; None on systems without user IDs."""
    return os.geteuid() if hasattr(os, "geteuid") else None


if HAS_POSIX:
    # write(2), called without releasing the interpreter lock, so that no other thread delays it. It
    # returns the number of bytes written, or -1.
    write_now = ctypes.PyDLL(None, use_errno=True).write
    write_now.argtypes = (ctypes.c_int, ctypes.c_char_p, ctypes.c_size_t)
    write_now.restype = ctypes.c_ssize_t


# Busy processes do not delay a thread with real-time priority (``SCHED_FIFO``). Linux grants it to
# root, and to users whose limit ``rtprio`` allows it.
PRIORITY = 1  # lowest real-time priority, for threads that pace runs and send to boards
_FIFO: int | None = getattr(os, "SCHED_FIFO", None)
_RESET: int = getattr(os, "SCHED_RESET_ON_FORK", 0)


def priority_advice() -> str:
    """Return a sentence on how to allow real-time priority."""
    if _FIFO is None:
        return "this system has no real-time priority: packets may be late while it is busy"
    return (
        "real-time priority is not allowed, so packets may be some ms late while the machine is "
        "busy: to allow it, write '* - rtprio 5' into /etc/security/limits.d/smarttouch.conf and "
        "log in again"
    )


@contextmanager
def prioritized() -> Iterator[bool]:
    """Run the block with real-time priority if the system allows it; yield whether it does.

    Threads and processes that the block starts have normal priority.
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
        # Keep SCHED_RESET_ON_FORK set: only root may clear it.
        os.sched_setscheduler(0, before[0] | _RESET, before[1])
