"""Requests to end a run, by a signal, a key or another thread; base of what is closed."""

import contextlib
import math
import os
import select
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Self

from smarttouch.base.errors import SmartTouchError
from smarttouch.base.posix import set_nonblocking

ENDS_WITHIN_S = 0.7  # time limit from a signal to the end of the process
RUNS_ON_S = 5.0  # additional time for a process that is not blocked, but slow or on a busy machine
ZERO_WITHIN_S = 5.0  # time to wait at the end for a board that does not confirm zero
SIGNALS = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM"}
if hasattr(signal, "SIGHUP"):  # not on Windows
    SIGNALS[signal.SIGHUP] = "SIGHUP"


_LOOKS, _LOOK_S = 5, 0.01


def thread_states() -> Iterator[tuple[int, str]]:
    """Yield the id and state of each thread of this process, R if it runs."""
    with contextlib.suppress(OSError):
        for task in Path("/proc/self/task").iterdir():
            with contextlib.suppress(OSError):
                yield int(task.name), (task / "stat").read_text().rpartition(") ")[2][0]


class RunStopped(SystemExit):
    """A signal, or what counts as one, ends the program: with 128 and the signal's number."""

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
            # All of them, whatever one raises.
            for call in reversed(calls):
                stack.callback(_call, call)

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


def _call(tell: Callable[[], None]) -> None:
    # A board that cannot be reached is reported by its own thread when it is closed.
    with contextlib.suppress(SmartTouchError):
        tell()


class SignalWatch:
    """Handler by which SIGINT, SIGTERM and SIGHUP end a run in order, and in time.

    Handlers lock nothing: the system writes a signal's number into a pipe, and a thread that waits
    for it asks for the stop, whatever the main thread is doing. A process that has not ended within
    ``patience_s`` is ended by force, by ``give_up`` with the number of the signal. If ``orderly``,
    the main thread ends by itself; else a signal raises `RunStopped` in it.
    """

    def __init__(self, stop: StopRequest, give_up: Callable[[int], None]) -> None:
        self.number: int = 0
        self.orderly: bool = False
        self.patience_s = ENDS_WITHIN_S
        self._stop, self._give_up = stop, give_up
        self._at_zero = threading.Event()

    @contextmanager
    def ending_in_order(self) -> Iterator[None]:
        """Let the block end by itself when a stop is requested."""
        before, self.orderly = self.orderly, True
        try:
            yield
        finally:
            self.orderly = before

    def __enter__(self) -> Self:
        self._read_end, self._write_end = os.pipe()
        set_nonblocking(self._write_end)
        self._thread = threading.Thread(target=self._watch, name="signals", daemon=True)
        self._thread.start()
        self._wakeup_before = signal.set_wakeup_fd(self._write_end, warn_on_full_buffer=False)
        self._before = {number: signal.signal(number, self._handle) for number in SIGNALS}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._wakeup_before)
        if self.number:
            # The end is near, and watched until it has come.
            return
        os.write(self._write_end, b"\0")
        self._thread.join(ENDS_WITHIN_S)
        if not self._thread.is_alive():
            os.close(self._read_end)
            os.close(self._write_end)

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        self.number = self.number or number
        if not self.orderly:
            # Only the first: what it unwinds is not to be cut short.
            self.orderly = True
            raise RunStopped(number)

    def _watch(self) -> None:
        ends_s = math.inf
        while True:
            left_s = None if math.isinf(ends_s) else max(0.0, ends_s - time.monotonic())
            if not select.select([self._read_end], [], [], left_s)[0]:
                break
            for number in os.read(self._read_end, 64):
                if number == 0:
                    return
                if number not in SIGNALS:
                    continue
                # A second one ends what takes long.
                again = not math.isinf(ends_s)
                within_s = min(ENDS_WITHIN_S, self.patience_s) if again else self.patience_s
                ends_s = min(ends_s, time.monotonic() + within_s)
                if not again:
                    self.number = self.number or number
                    threading.Thread(target=self._ask, args=(number,), daemon=True).start()
        # By force only when boards are at zero, or that is unknown; and nothing goes on.
        self._at_zero.wait(ZERO_WITHIN_S)
        last_s = time.monotonic() + RUNS_ON_S
        while self._goes_on() and time.monotonic() < last_s:
            pass
        self._give_up(self.number)

    def _goes_on(self) -> bool:
        """Return whether a thread of this process runs, or would if there were a free processor."""
        own = threading.get_native_id()
        for _ in range(_LOOKS):
            if any(state == "R" for thread, state in thread_states() if thread != own):
                return True
            time.sleep(_LOOK_S)
        return False

    def _ask(self, number: int) -> None:
        try:
            self._stop.ask(SIGNALS[signal.Signals(number)])
        finally:
            self._at_zero.set()


class Closing:
    """Closes itself at the end of its ``with`` block, whatever has happened in it."""

    def close(self) -> None:
        """Release everything held open; a second call does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
