"""What only POSIX has: modules, flags of `os.open`, file locks, and the user's number.

On other systems modules are None and flags 0, so that all that needs no line, terminal or lock
works.
"""

import errno
import os
import signal
import sys
import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # a module cannot be None for a type checker; users of one check first
    import fcntl
    import pty
    import resource
    import termios
    import tty
else:
    try:
        import fcntl
        import pty
        import resource
        import termios
        import tty
    except ImportError:
        fcntl = pty = resource = termios = tty = None

__all__ = ["fcntl", "pty", "resource", "termios", "tty"]

O_NOCTTY, O_NONBLOCK, O_NOFOLLOW, O_CLOEXEC, O_BINARY = (
    getattr(os, name, 0)
    for name in ("O_NOCTTY", "O_NONBLOCK", "O_NOFOLLOW", "O_CLOEXEC", "O_BINARY")
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


def interrupt_main_thread() -> None:
    """Send SIGTERM to the main thread of this process, so that it ends what it waits for."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)
    else:
        signal.raise_signal(signal.SIGTERM)
