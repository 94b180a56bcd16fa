"""Requests to end a run, from a signal, a key or another thread; base class of closable objects."""

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
    """Exit of the program by a signal or a stop request, with status 128 plus the signal number."""

    def __init__(self, number: int, by: str | None = None) -> None:
        super().__init__(by or SIGNALS[signal.Signals(number)])
        self.number: int = number
        self.code: int = 128 + number


@dataclass
class StopRequest:
    """Request to end a run. Any thread can make it, but a signal handler must not."""

    event: threading.Event = field(default_factory=threading.Event)
    reason: str = ""
    _on_stop: list[Callable[[], None]] = field(default_factory=list, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def ask(self, reason: str, *, at_once: bool = True) -> None:
        """Request the end of the run. If ``at_once``, boards are at zero when this returns."""
        with self._lock:
            # Keep the first reason, also after a second Ctrl-C.
            self.reason = self.reason or reason
            # Set the event under the lock, so that no function is missed: either it is in the list,
            # or the thread that adds it in `on_stop` sees the event and calls it.
            self.event.set()
            calls = self._on_stop.copy() if at_once else []
        with contextlib.ExitStack() as stack:
            # Call all functions even if one raises. The error of a lost board is ignored here,
            # because the board's `close` reports the loss.
            for call in reversed(calls):
                stack.enter_context(contextlib.suppress(SmartTouchError))
                stack.callback(call)

    def always_on_stop(self, tell: Callable[[], None]) -> None:
        """Call a function when the end is requested. The function added last is called first: a
        run is added after its board, so that it ends before the board refuses sequences."""
        with self._lock:
            self._on_stop.insert(0, tell)

    @contextmanager
    def on_stop(self, tell: Callable[[], None]) -> Iterator[None]:
        """Call a function when the end is requested during the block. Call it at once if the end
        was requested before the block."""
        self.always_on_stop(tell)
        try:
            if self.event.is_set():
                tell()
            yield
        finally:
            with self._lock:
                self._on_stop.remove(tell)


_writes = 0  # number of `uninterrupted` blocks that the main thread is in
_pending: BaseException | None = None


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Delay exceptions that signal handlers raise with `interrupt` until the block ends. Otherwise
    they could cut a write to a board short."""
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
    """Raise an error from a signal handler, or at the end of the current `uninterrupted` block."""
    global _pending
    if not _writes:
        raise error
    _pending = _pending or error


class Closing:
    """Base of objects that are closed at the end of a ``with`` block."""

    def close(self) -> None:
        """Release all resources; a second call does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
