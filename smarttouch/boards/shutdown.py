"""Shutdown of this process by a signal or by ``smarttouch stop``.

A process has an entry in the run registry while it has open boards, has runs, or executes a command
that will open a board. During this time, SIGTERM, SIGHUP and Ctrl-C set all boards to zero and then
end the process. A thread sets the boards to zero, even if the main thread is blocked.
"""

import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from types import FrameType
from typing import TYPE_CHECKING, Any

from smarttouch.base.errors import BoardError, BoardStoppedError, SmartTouchError
from smarttouch.base.stopping import SIGNALS, RunStopped, StopRequest, interrupt
from smarttouch.boards.run_registry import RunEntry, registry_folder, stopped_since_start

if TYPE_CHECKING:
    from smarttouch.boards.board import Board

ZERO_WITHIN_S = 2.0  # time for boards to confirm zero
ENDS_WITHIN_S = 5.0  # time for a command to end after its boards are at zero


@dataclass(eq=False)
class Command:
    """A ``smarttouch`` command of this process.

    If ``orderly``, the command ends by itself when ``stop`` asks it to. Otherwise a signal raises
    `RunStopped`. If ending takes longer than ``patience_s``, ``give_up`` is called.
    """

    give_up: Callable[[int], None]  # ends the process; the argument is the number of the signal
    stop: StopRequest = field(default_factory=StopRequest)
    orderly: bool = False
    patience_s: float = ENDS_WITHIN_S

    @property
    def number(self) -> int:
        """Number of the signal that ends the command, or 0."""
        return 0 if _process.signals is None else _process.signals.number


class _Process:
    """Boards, runs, command, registry entry and signals of this process."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        # Keep references: a board that the program has dropped may still deliver pulses.
        self.boards: dict[Board, int] = {}
        self.runs: list[StopRequest] = []  # one per run, and one per command that opens a board
        self.command: Command | None = None
        self.signals: _Signals | None = None
        self.in_run = False  # whether a run in the main thread will end by itself after a signal
        self.reason = ""  # reason why this process may no longer open boards
        self.entry: RunEntry | None = None

    def forget(self) -> None:
        """In a forked process, leave boards, runs and signals to the parent."""
        if self.entry is not None:
            self.entry.close()
        if self.signals is not None:
            self.signals.close(forked=True)
        vars(self).update(vars(_Process()))

    def announce(self) -> None:
        """Register this process and the total current of its boards. Raises BoardError if the
        process was stopped, or if the current of all runs together is too large."""
        # Import late, so that help does not load profiles.
        from smarttouch.profile.project_ceilings import CEILING_USER_MA

        self.handle_signals()
        most_ua = round(1000 * CEILING_USER_MA)
        try:
            if self.entry is None and not self.reason:
                self.entry = RunEntry(self._stop_requested)
            # Register first, then check for a stop: an earlier stop has not seen this entry.
            if self.reason or self.entry is None or self.entry.is_asked or stopped_since_start():
                raise BoardStoppedError(
                    f"this program was stopped by {self.reason or 'smarttouch stop'}, and can "
                    "open no more boards: start it again"
                )
            total_ua = self.entry.declare(sum(self.boards.values()), most_ua)
        except OSError as error:
            raise SmartTouchError(
                f"cannot write {error.filename or registry_folder()}, where smarttouch stop looks "
                f"for this run: {error.strerror}; set XDG_STATE_HOME to a folder that you can "
                "write to"
            ) from None
        if total_ua > most_ua:
            raise BoardError(
                f"all displays of this user together could drive {total_ua / 1000:g} mA, more than "
                f"the allowed {CEILING_USER_MA:g} mA: close another display or reduce "
                "limits.total_ma in the profile"
            )

    def handle_signals(self) -> None:
        if threading.current_thread() is threading.main_thread():
            self.signals = self.signals or _Signals(self.command)

    def withdraw(self) -> None:
        """Update the registry entry, or remove it if no boards and runs are left."""
        entry = self.entry
        if self.boards or self.runs:
            if entry is not None:
                with suppress(SmartTouchError, OSError):
                    entry.declare(sum(self.boards.values()))
            return
        if entry is not None:
            self.entry = None
            entry.withdraw()
        if self.command is None and self.signals is not None and self.signals.close():
            self.signals = None

    def end(self, reason: str, *, for_good: bool = True) -> bool:
        """Set all boards to zero and ask all runs to end; return whether all boards have confirmed
        zero. With ``for_good``, no board can be opened afterwards."""
        # Do not take the lock: a thread that waits for the disk may hold it. Set `reason` before
        # reading `boards`: `announce` then refuses each board that is registered later.
        if for_good:
            self.reason = self.reason or reason
        boards, entry = [*self.boards], self.entry
        for request in [*self.runs, *([self.command.stop] if self.command else [])]:
            # Ask runs to end before their boards reject sequences.
            request.ask(reason, at_once=False)

        def bring_to_zero(board: "Board") -> None:
            # If stopping raises an error, the board has not confirmed zero and stays registered.
            with suppress(Exception):
                (board.halt if for_good else board.stop)()
                leave(board)

        for board in boards:
            threading.Thread(target=bring_to_zero, args=(board,), daemon=True).start()
        deadline_s = time.monotonic() + ZERO_WITHIN_S
        # Wait until each board is at zero. A thread started above stops it, or its run closes it.
        while self.boards and time.monotonic() < deadline_s:
            time.sleep(0.002)
        # A board that has not confirmed zero stays in the run registry until it is closed.
        return not (self.boards or (entry is not None and entry.lost_a_board))

    def _stop_requested(self, reason: str) -> bool:
        at_zero = self.end(reason)
        if self.command is not None:
            # Send a signal, which interrupts a main thread that is waiting.
            if hasattr(signal, "pthread_kill"):
                signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)
            else:
                signal.raise_signal(signal.SIGTERM)
        return at_zero


class _Signals:
    """Handler of signals that would end this process or raise KeyboardInterrupt.

    Python writes the number of each signal to a socket, even while the main thread is blocked, and
    a thread reads the numbers. If Python writes the numbers to an event loop instead, the handler
    itself writes to the socket. The handler takes no locks.
    """

    def __init__(self, command: Command | None) -> None:
        self.number = 0  # number of the first signal
        self._raised, self._command = False, command
        self._hears, self._wakes = socket.socketpair()
        self._wakes.setblocking(False)
        self._set_wakeup(self._wakes.fileno())
        self._before: dict[int, Any] = {}
        for number in SIGNALS:
            # Do not replace the program's own handlers. Signals that it ignores stay ignored.
            if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
                self._before[number] = signal.signal(number, self._handle)
        threading.Thread(target=self._work, name="signals", daemon=True).start()

    def close(self, *, forked: bool = False) -> bool:
        """Stop handling signals. If this is not the main thread, or a command is ending, do nothing
        and return False."""
        ending = self._command is not None and self.number and not forked
        if ending or threading.current_thread() is not threading.main_thread():
            return False
        for number in filter(self._is_ours, self._before):
            signal.signal(number, self._before[number])
        self._set_wakeup(-1)
        self._wakes.close()  # ends the thread that reads signals
        if forked:
            self._hears.close()
        return True

    def end_main_thread(self) -> None:
        """Raise the exception for a received signal, in the main thread."""
        if self.number == signal.SIGINT and self._command is None:
            self.number = 0
            interrupt(KeyboardInterrupt())
        elif self.number and not self._raised:
            # Raise only once, so that cleanup is not interrupted.
            self._raised = True
            interrupt(RunStopped(self.number, _process.reason or None))

    def _set_wakeup(self, descriptor: int) -> bool:
        """Let Python write each signal's number to ``descriptor``, unless an event loop receives
        the numbers. Return whether this object was the receiver before the call."""
        before = signal.set_wakeup_fd(descriptor, warn_on_full_buffer=False)
        if before not in (-1, self._wakes.fileno()):
            signal.set_wakeup_fd(before)
        return before == self._wakes.fileno()

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        first, self.number = not self.number, self.number or number
        if not self._set_wakeup(self._wakes.fileno()):
            self._wakes.send(bytes([number]))
        # Without a command, the first signal only asks a run to end; the second interrupts the run.
        orderly = self._command.orderly if self._command else _process.in_run and first
        if not orderly:
            self.end_main_thread()

    def _is_ours(self, number: int) -> bool:
        return number in SIGNALS and signal.getsignal(number) == self._handle

    def _work(self) -> None:
        while numbers := self._hears.recv(64):
            for number in filter(self._is_ours, numbers):
                again = self._command is None and number == signal.SIGINT
                _process.end(SIGNALS[signal.Signals(number)], for_good=not again)
                if self._command is not None:
                    # Whether or not all boards are at zero, end the process: it may be blocked.
                    time.sleep(self._command.patience_s)
                    self._command.give_up(number)
        self._hears.close()


_process = _Process()
if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_process.forget)


def enter(board: "Board") -> None:
    """If a stop must reach a board, register it before it is opened. Raises BoardError if this
    program was stopped, or if all displays of the user together could drive too much current."""
    if not board.announced:
        return
    with _process.lock:
        if board in _process.boards:
            # Do not register the board twice: the first `leave` would remove it for both threads.
            raise BoardError("another thread is opening or closing the board: try again")
        _process.boards[board] = board.budget_ua
        try:
            _process.announce()
        except BaseException:
            leave(board)
            raise


def leave(board: "Board", at_zero: bool = True) -> None:
    """Unregister a closed board; ``at_zero`` is whether it has confirmed zero."""
    with _process.lock:
        if _process.boards.pop(board, None) is not None and _process.entry is not None:
            _process.entry.lost_a_board |= not at_zero
        _process.withdraw()


def expect(board: "Board") -> None:
    """Register the running command before it opens ``board``, if a stop must reach the board."""
    if _process.command is not None and board.announced:
        with _process.lock:
            _process.runs.append(_process.command.stop)
            _process.announce()


def current_command() -> Command:
    """Return the running command of this process. If there is none, return a new command."""
    return _process.command or Command(os._exit)


@contextmanager
def running_command(give_up: Callable[[int], None]) -> Iterator[Command]:
    """Let signals and stops end a command while the ``with`` block runs. If the command does not
    end, ``give_up`` ends the process."""
    _process.command = command = Command(give_up)
    _process.handle_signals()
    try:
        yield command
    except BoardStoppedError:
        if command.number or _process.reason or stopped_since_start():
            reason = _process.reason or (None if command.number else "smarttouch stop")
            raise RunStopped(command.number or signal.SIGTERM, reason) from None
        raise
    finally:
        with _process.lock:
            _process.command = None
            _process.runs = [stop for stop in _process.runs if stop is not command.stop]
            _process.withdraw()


@contextmanager
def stoppable_run(stop: StopRequest, board: "Board") -> Iterator[Callable[[], None]]:
    """Register a run during the ``with`` block. If the run is in the main thread, a signal raises
    RunStopped or KeyboardInterrupt in the block at once. Yield a function that defers this: once it
    is called, the first signal raises the exception only at the end of the block."""
    if not board.announced:
        yield lambda: None
        return
    main = threading.current_thread() is threading.main_thread()

    def to_its_end() -> None:
        _process.in_run = main or _process.in_run

    signals = None
    _process.runs.append(stop)
    try:
        with _process.lock:
            _process.announce()
        signals = _process.signals
        yield to_its_end
    finally:
        if main:
            _process.in_run = False
        with _process.lock:
            _process.runs.remove(stop)
            _process.withdraw()
        if main and signals is not None and _process.command is None:
            signals.end_main_thread()
