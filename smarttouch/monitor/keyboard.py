"""Single keys from the terminal, where there is one."""

import os
import select
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from smarttouch.posix import termios, tty

LOST = ""  # key that stands for a terminal that is gone
JOIN_S = 0.3  # longest time that the end waits for a key that is being handled


_before: list[list[Any]] = []  # the terminal's own settings, while they are changed


@contextmanager
def keyboard() -> Iterator[None]:
    """Let single keys through, if there is a keyboard."""
    if not sys.stdin.isatty():
        yield
        return
    _before.append(termios.tcgetattr(sys.stdin))
    # Now, not after pending output, which may never be read.
    tty.setcbreak(sys.stdin, termios.TCSANOW)
    try:
        yield
    finally:
        restore()


def restore() -> None:
    """Restore the terminal's settings without waiting for it."""
    # A terminal that is gone has nothing to restore.
    with suppress(termios.error, IndexError):
        termios.tcsetattr(sys.stdin, termios.TCSANOW, _before.pop())


@contextmanager
def keyboard_listener(on_key: Callable[[str], None]) -> Iterator[None]:
    """Pass every key to a function, from a thread, until the block ends: arrow keys as ``up``,
    ``down``, ``left`` and ``right``, a lost terminal as `LOST`."""
    if not sys.stdin.isatty():
        yield
        return
    over = threading.Event()

    def listen() -> None:
        number = sys.stdin.fileno()
        while not over.is_set():
            if not select.select([number], [], [], 0.1)[0]:
                continue
            try:
                data = os.read(number, 64)
            except OSError:
                data = b""
            if not data:
                on_key(LOST)
                return
            for key in _keys(data.decode("utf-8", "replace")):
                on_key(key)

    with keyboard():
        thread = threading.Thread(target=listen, name="keyboard", daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join(JOIN_S)


def _keys(text: str) -> Iterator[str]:
    names = {"A": "up", "B": "down", "C": "right", "D": "left"}
    arrows = {f"\x1b{mode}{end}": name for mode in "[O" for end, name in names.items()}
    while text:
        arrow = arrows.get(text[:3])
        yield arrow or text[0]
        text = text[3:] if arrow else text[1:]
