"""What only POSIX has: modules, flags of `os.open`, and the user's number.

On other systems modules are None and flags 0, so that all that needs no line, terminal or lock
works.
"""

import os
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

O_NOCTTY, O_NONBLOCK, O_NOFOLLOW, O_CLOEXEC, O_DIRECTORY, O_BINARY = (
    getattr(os, name, 0)
    for name in ("O_NOCTTY", "O_NONBLOCK", "O_NOFOLLOW", "O_CLOEXEC", "O_DIRECTORY", "O_BINARY")
)


def set_nonblocking(number: int) -> None:
    """Let no read or write of an open file wait, where the system can do so."""
    if hasattr(os, "set_blocking"):
        os.set_blocking(number, False)


def user_number() -> int | None:
    """Return the number of this process's user; None where users have none."""
    return os.geteuid() if hasattr(os, "geteuid") else None
