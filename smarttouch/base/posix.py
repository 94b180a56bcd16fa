"""Modules that only POSIX has; None on other systems, where what needs them cannot run.

From here they can be imported anywhere, so that all that needs no line, terminal or lock works.
"""

try:
    import fcntl
    import pty
    import resource
    import termios
    import tty
except ImportError:
    # A module cannot be None for a type checker; whoever needs one asks first.
    fcntl = pty = resource = termios = tty = None  # type: ignore[assignment]

__all__ = ["fcntl", "pty", "resource", "termios", "tty"]
