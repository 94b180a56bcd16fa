"""Keys and signals of a command in a terminal: it can be stopped at any instant."""

import contextlib
import functools
import os
import select
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from smarttouch.base.errors import BoardError, BoardStoppedError
from smarttouch.base.posix import termios, tty
from smarttouch.base.stopping import RunStopped, SignalWatch, StopRequest
from smarttouch.base.terminal import never_waiting
from smarttouch.boards.announced import refuse_if_stopped
from smarttouch.boards.stoppable import announced

if TYPE_CHECKING:
    from smarttouch.boards.board import Board

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
                try:
                    on_key(key)
                except BaseException:
                    # No key would be heard any more, neither one that ends the run.
                    on_key(LOST)
                    raise

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


_P = ParamSpec("_P")
_T = TypeVar("_T")
_CURSOR_ON = b"\x1b[?25h"

_watches: list[tuple[StopRequest, SignalWatch]] = []


def drives_a_board(command: Callable[_P, _T]) -> Callable[_P, _T]:
    """Let a command that may make current be stopped, by signals and by ``smarttouch stop``."""

    def driving(*arguments: _P.args, **options: _P.kwargs) -> _T:
        with announced():
            refuse_if_stopped()
            return command(*arguments, **options)

    return asks_a_board(functools.wraps(command)(driving))


def asks_a_board(command: Callable[_P, _T]) -> Callable[_P, _T]:
    """Let a command that makes no current be stopped by signals."""

    @functools.wraps(command)
    def surrounded(*arguments: _P.args, **options: _P.kwargs) -> _T:
        with _stoppable():
            return command(*arguments, **options)

    return surrounded


def command_stop() -> StopRequest:
    """Return the stop request of the command that runs."""
    return _watches[-1][0] if _watches else StopRequest()


def by_signal() -> bool:
    """Return whether a signal ends the command that runs."""
    return bool(_watches and _watches[-1][1].number)


@contextmanager
def ending_in_order(patience_s: float | None = None) -> Iterator[None]:
    """Let the block end by itself when a stop is requested, within ``patience_s`` of a signal;
    elsewhere a signal interrupts."""
    if not _watches:
        yield
        return
    watch = _watches[-1][1]
    if patience_s is not None:
        watch.patience_s = patience_s
    with watch.ending_in_order():
        yield


@contextmanager
def opened(board: "Board", stop: StopRequest | None = None) -> Iterator["Board"]:
    """Open a board for a block; a stop puts it at zero at once, also while it opens, and sending
    raises BoardStoppedError after it."""
    with ending_in_order(), (stop or command_stop()).on_stop(board.halt):
        if _watches:
            refuse_if_stopped()
        with contextlib.ExitStack() as stack:
            _open(board)
            stack.push(board)
            if _watches:
                refuse_if_stopped()
            yield board


def _open(board: "Board") -> None:
    """Open a board; a failure after a signal counts as a stop."""
    try:
        board.open()
    except BoardError as error:
        if _watches and _watches[-1][1].number:
            raise BoardStoppedError(str(error)) from None
        raise


@contextmanager
def _stoppable() -> Iterator[None]:
    stop = StopRequest()
    watch = SignalWatch(stop, _give_up)
    with watch, never_waiting(stop.event.is_set):
        _watches.append((stop, watch))
        try:
            with _raising_as_stopped(watch):
                yield
        except RunStopped as stopped:
            # Here, where a terminal that has stopped reading blocks nothing.
            print(
                f"smarttouch: ended by {stopped} before it began: all electrodes are off",
                file=sys.stderr,
            )
            raise
        finally:
            _watches.pop()


@contextmanager
def _raising_as_stopped(watch: SignalWatch) -> Iterator[None]:
    try:
        yield
    except BoardStoppedError:
        if watch.number:
            raise RunStopped(watch.number) from None
        # The mark is there, the signal on its way.
        refuse_if_stopped()
        raise


def _give_up(number: int) -> None:
    """End the process now: every board is at zero, and something blocks the rest."""
    restore()
    with contextlib.suppress(OSError, ValueError):
        for stream in (sys.__stdout__, sys.__stderr__):
            place = -1 if stream is None else stream.fileno()
            if place >= 0 and os.isatty(place):
                os.set_blocking(place, False)
                try:
                    os.write(place, _CURSOR_ON)
                finally:
                    os.set_blocking(place, True)
    os._exit(128 + number)
