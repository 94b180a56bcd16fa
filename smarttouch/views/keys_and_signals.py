"""Keys and signals of a command in a terminal: it can be stopped at any instant."""

import functools
import os
import select
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from smarttouch.base.posix import termios, tty
from smarttouch.base.stopping import RunStopped, StopRequest
from smarttouch.boards.shutdown import current_command, running_command

if TYPE_CHECKING:
    pass

LOST = ""  # key that stands for a terminal that is gone
JOIN_S = 0.3  # longest time that the end waits for a key that is being handled
_before: list[list[Any]] = []  # the terminal's own settings, while they are changed


def restore() -> None:
    """Restore the terminal's settings without waiting for it."""
    if _before:
        # A terminal that is gone has nothing to restore.
        with suppress(termios.error):
            termios.tcsetattr(sys.stdin, termios.TCSANOW, _before.pop())


@contextmanager
def keyboard_listener(on_key: Callable[[str], None]) -> Iterator[None]:
    """Pass every key to a function, from a thread, until the block ends: arrow keys as ``up``,
    ``down``, ``left`` and ``right``, a lost terminal as `LOST`."""
    if termios is None or not sys.stdin.isatty():
        yield
        return
    over = threading.Event()
    thread = threading.Thread(target=_listen, args=(on_key, over), name="keyboard", daemon=True)
    _before.append(termios.tcgetattr(sys.stdin))
    try:
        # Now, not after pending output, which may never be read.
        tty.setcbreak(sys.stdin, termios.TCSANOW)
        thread.start()
        yield
    finally:
        over.set()
        if thread.ident is not None:
            thread.join(JOIN_S)
        restore()


def _listen(on_key: Callable[[str], None], over: threading.Event) -> None:
    number = sys.stdin.fileno()
    while not over.is_set():
        if not select.select([number], [], [], 0.1)[0]:
            continue
        try:
            data = os.read(number, 64)
        except OSError:
            data = b""
        try:
            for key in _keys(data.decode("utf-8", "replace")):
                on_key(key)
        except BaseException:
            # Otherwise this thread dies, and even `q` stops working.
            on_key(LOST)
            raise
        if not data:
            on_key(LOST)
            return


def _keys(text: str) -> Iterator[str]:
    names = {"A": "up", "B": "down", "C": "right", "D": "left"}
    arrows = {f"\x1b{mode}{end}": name for mode in "[O" for end, name in names.items()}
    while text:
        arrow = arrows.get(text[:3])
        yield arrow or text[0]
        text = text[3:] if arrow else text[1:]


_P = ParamSpec("_P")
_T = TypeVar("_T")
_CURSOR_ON = b"\x1b[?25h"


def drives_a_board(command: Callable[_P, _T]) -> Callable[_P, _T]:
    """Let signals and ``smarttouch stop`` end a command."""

    @functools.wraps(command)
    def stoppable(*arguments: _P.args, **options: _P.kwargs) -> _T:
        try:
            with running_command(_give_up):
                return command(*arguments, **options)
        except RunStopped as stopped:
            print(f"smarttouch: ended by {stopped}; no board is open", file=sys.stderr)
            raise

    return stoppable


def command_stop() -> StopRequest:
    """Return the stop request of the command that runs."""
    return current_command().stop


def by_signal() -> bool:
    """Return whether a signal ends the command that runs."""
    return bool(current_command().number)


@contextmanager
def ending_in_order(patience_s: float | None = None) -> Iterator[None]:
    """Let the block end by itself when a stop is requested, within ``patience_s`` of a signal;
    elsewhere a signal interrupts."""
    command = current_command()
    command.patience_s = patience_s or command.patience_s
    before, command.orderly = command.orderly, True
    try:
        yield
    finally:
        command.orderly = before


def _give_up(number: int) -> None:
    """End the process now: every board is at zero, and something blocks the rest."""
    restore()
    with suppress(OSError, ValueError):
        for descriptor in (1, 2):
            if os.isatty(descriptor):
                os.set_blocking(descriptor, False)
                try:
                    os.write(descriptor, _CURSOR_ON)
                finally:
                    os.set_blocking(descriptor, True)
    os._exit(128 + number)
