"""Decorators and contexts by which every command that drives a board can be stopped at any
instant."""

import contextlib
import functools
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, ParamSpec, TypeVar

from smarttouch.boards.announced import refuse_if_stopped
from smarttouch.boards.stoppable import announced
from smarttouch.errors import BoardError, BoardStoppedError
from smarttouch.monitor.keyboard import restore
from smarttouch.outlet import never_waiting
from smarttouch.stopping import RunStopped, SignalWatch, StopRequest

if TYPE_CHECKING:
    from smarttouch.boards.board import Board

_P = ParamSpec("_P")
_T = TypeVar("_T")
_CURSOR_ON = b"\x1b[?25h"

_watches: list[tuple[StopRequest, SignalWatch]] = []


def drives_a_board(command: Callable[_P, _T]) -> Callable[_P, _T]:
    """Let a command that may make current be stopped, by signals and by ``smarttouch stop``."""

    @functools.wraps(command)
    def surrounded(*arguments: _P.args, **options: _P.kwargs) -> _T:
        with _stoppable(), announced():
            refuse_if_stopped()
            return command(*arguments, **options)

    return surrounded


def asks_a_board(command: Callable[_P, _T]) -> Callable[_P, _T]:
    """Let a command that makes no current be stopped by signals."""

    @functools.wraps(command)
    def surrounded(*arguments: _P.args, **options: _P.kwargs) -> _T:
        with _stoppable():
            return command(*arguments, **options)

    return surrounded


def the_stop() -> StopRequest:
    """Return the stop request of the command that runs."""
    return _watches[-1][0] if _watches else StopRequest()


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
    with ending_in_order(), (stop or the_stop()).telling(board.halt):
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
            raise BoardStoppedError(str(error), about=error.about) from None
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
