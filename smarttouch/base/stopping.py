"""Requests to end a run, by a signal, a key or another thread; base of what is closed."""

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Self

from smarttouch.base.errors import SmartTouchError

SIGNALS = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM"}
if hasattr(signal, "SIGHUP"):  # not on Windows
    SIGNALS[signal.SIGHUP] = "SIGHUP"


class RunStopped(SystemExit):
    """A signal, or a stop that counts as one, ends the program with 128 plus its number."""

    def __init__(self, number: int, by: str | None = None) -> None:
        super().__init__(by or SIGNALS[signal.Signals(number)])
        self.number: int = number
        self.code: int = 128 + number


@dataclass
class StopRequest:
    """Request to end a run, set once from any thread; never from a signal's handler."""

    event: threading.Event = field(default_factory=threading.Event)
    reason: str = ""
    _on_stop: list[Callable[[], None]] = field(default_factory=list, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def ask(self, reason: str, *, at_once: bool = True) -> None:
        """Request the end of the run; ``at_once``: boards go to zero before this returns."""
        with self._lock:
            # The first reason is the true one: a second Ctrl-C changes nothing.
            self.reason = self.reason or reason
            # Within: a function that is entered meanwhile is among these, or finds it set.
            self.event.set()
            calls = self._on_stop.copy() if at_once else []
        with contextlib.ExitStack() as stack:
            # All of them, whatever one raises. A board that cannot be reached is reported when its
            # thread closes it.
            for call in reversed(calls):
                stack.enter_context(contextlib.suppress(SmartTouchError))
                stack.callback(call)

    def always_on_stop(self, tell: Callable[[], None]) -> None:
        """Call a function whenever the end is requested from now on, before earlier functions: a
        run must be ended before its board refuses."""
        with self._lock:
            self._on_stop.insert(0, tell)

    @contextmanager
    def on_stop(self, tell: Callable[[], None]) -> Iterator[None]:
        """Call a function once the end is requested, during the block or before it."""
        self.always_on_stop(tell)
        try:
            if self.event.is_set():
                tell()
            yield
        finally:
            with self._lock:
                self._on_stop.remove(tell)


_writes = 0  # blocks of `uninterrupted` that the main thread is in
_pending: BaseException | None = None


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let no signal's exception be raised within the block, such as a write to a board's line: it
    is raised at the end of the block."""
    global _writes, _pending
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _writes += 1
    try:
        yield
    finally:
        _writes -= 1
        if _pending is not None and not _writes:
            error, _pending = _pending, None
            raise error


def interrupt(error: BaseException) -> None:
    """Raise an error in the main thread, from a signal's handler, but never within a write."""
    global _pending
    if not _writes:
        raise error
    _pending = _pending or error


class Closing:
    """Closes itself at the end of its ``with`` block, whatever has happened in it."""

    def close(self) -> None:
        """Release everything held open; a second call does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
