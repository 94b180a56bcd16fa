"""Requests to end a run: by a signal, a key or another thread."""

import contextlib
import math
import os
import select
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Self

from smarttouch.errors import SmartTouchError

ENDS_WITHIN_S = 0.7
"""Time limit from a signal to the end of the process."""
RUNS_ON_S = 5.0
"""Additional time for a process that is not blocked, but slow or on a busy machine."""
PROGRAM_ENDS_WITHIN_S = 5.0
"""Time limit from a signal to the end of a program that handles none itself."""
ZERO_WITHIN_S = 5.0
"""Time to wait at the end for a board that does not confirm zero."""
SIGNALS = {
    signal.SIGINT: "Ctrl-C",
    signal.SIGTERM: "SIGTERM",
}
if hasattr(signal, "SIGHUP"):  # not on Windows
    SIGNALS[signal.SIGHUP] = "SIGHUP"


_LOOKS, _LOOK_S = 5, 0.01


def thread_states() -> Iterator[tuple[int, str]]:
    """Yield the id and state of each thread of this process, R if it runs."""
    with contextlib.suppress(OSError):
        for task in Path("/proc/self/task").iterdir():
            with contextlib.suppress(OSError):
                yield int(task.name), (task / "stat").read_text().rpartition(") ")[2][0]


class RunStopped(BaseException):
    """A signal, or what counts as one, ended the program before a board was open.

    Attributes
    ----------
    number : int
        Of the signal.
    """

    def __init__(self, number: int, by: str | None = None) -> None:
        super().__init__(by or SIGNALS[signal.Signals(number)])
        self.number = number


@dataclass
class StopRequest:
    """Request to end a run, set once from any thread; never from a signal's handler.

    Attributes
    ----------
    event : threading.Event
        Set by the request.
    reason : str
        Source of the first request.
    """

    event: threading.Event = field(default_factory=threading.Event)
    reason: str = ""
    _told: list[Callable[[], None]] = field(default_factory=list, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def ask(self, reason: str, *, at_once: bool = True) -> None:
        """Request the end of the run.

        Parameters
        ----------
        reason : str
        at_once : bool
            Whether boards go to zero before this returns; else what was sent is still felt.
        """
        with self._lock:
            # The first reason is the true one: a second Ctrl-C changes nothing.
            self.reason = self.reason or reason
            told = self._told.copy() if at_once else []
        self.event.set()
        for tell in told:
            # A board that cannot be reached is reported by its own thread when it is closed.
            with contextlib.suppress(SmartTouchError):
                tell()

    @contextmanager
    def telling(self, tell: Callable[[], None]) -> Iterator[None]:
        """Call a function once the end is requested, during the block or before it."""
        with self._lock:
            self._told.append(tell)
        try:
            if self.event.is_set():
                tell()
            yield
        finally:
            with self._lock:
                self._told.remove(tell)


class SignalWatch:
    """Handler by which SIGINT, SIGTERM and SIGHUP end a run in order, and in time.

    Handlers lock nothing: the system writes a signal's number into a pipe, and a thread
    that waits for it asks for the stop, whatever the main thread is doing. A process that
    has not ended soon after is ended by force.

    Parameters
    ----------
    stop : StopRequest
        Request to set.
    give_up : callable
        Ends the process by force, given the number of the signal.
    numbers : iterable of Signals
        Signals to handle: all of `SIGNALS` if not given.

    Attributes
    ----------
    number : int
        Of the first signal; 0 if there was none.
    orderly : bool
        Whether the main thread ends by itself what it does when asked to stop; else a signal
        raises `RunStopped` in it.
    patience_s : float
        From a signal to the end by force.
    """

    def __init__(
        self,
        stop: StopRequest,
        give_up: Callable[[int], None],
        numbers: Iterable[signal.Signals] = tuple(SIGNALS),
    ) -> None:
        self._numbers = frozenset(numbers)
        self.number = 0
        self.orderly = False
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
        os.set_blocking(self._write_end, False)
        self._thread = threading.Thread(target=self._watch, name="signals", daemon=True)
        self._thread.start()
        self._wakeup_before = signal.set_wakeup_fd(self._write_end, warn_on_full_buffer=False)
        self._before = {number: signal.signal(number, self._handle) for number in self._numbers}
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
                if number not in self._numbers:
                    continue
                # A second one ends what takes long.
                again = not math.isinf(ends_s)
                within_s = min(ENDS_WITHIN_S, self.patience_s) if again else self.patience_s
                ends_s = min(ends_s, time.monotonic() + within_s)
                if not again:
                    self.number = self.number or number
                    threading.Thread(target=self._ask, args=(number,), daemon=True).start()
        # By force only when boards are at zero, or nobody can know; and nothing goes on.
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


@contextmanager
def ended_by_signals(stop: StopRequest) -> Iterator[None]:
    """Let SIGTERM and SIGHUP end a run in order, in a program that leaves them as they are.

    A program that handles them itself, or runs in another thread, keeps what it has.

    Raises
    ------
    SystemExit
        After the block, if one has come.
    """
    wakeup = -2
    if threading.current_thread() is threading.main_thread():
        wakeup = signal.set_wakeup_fd(-1)
        signal.set_wakeup_fd(wakeup)
    usual = [each for each in SIGNALS if signal.getsignal(each) is signal.SIG_DFL]
    if wakeup != -1 or not usual:
        yield
        return
    with SignalWatch(stop, lambda number: os._exit(128 + number), usual) as watch:
        watch.orderly, watch.patience_s = True, PROGRAM_ENDS_WITHIN_S
        try:
            yield
        except SmartTouchError:
            if not watch.number:
                raise
    if watch.number:
        raise SystemExit(128 + watch.number)
