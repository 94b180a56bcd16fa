"""Shutdown of this process: what a signal or ``smarttouch stop`` must bring to zero and end.

A process has one entry in the run registry, for its open boards, its runs and a command that will
open a board. While there is one, SIGTERM, SIGHUP and Ctrl-C bring all boards to zero from a thread,
whatever the main thread does, and then end the process.
"""

import os
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from queue import Empty, SimpleQueue
from types import FrameType
from typing import TYPE_CHECKING, Any

from smarttouch.base.errors import BoardError, BoardStoppedError, SmartTouchError
from smarttouch.base.posix import fcntl
from smarttouch.base.stopping import SIGNALS, RunStopped, StopRequest, interrupt
from smarttouch.boards.run_registry import RunEntry, stopped_since_start

if TYPE_CHECKING:
    from smarttouch.boards.board import Board

ZERO_WITHIN_S = 2.0  # time for boards to confirm zero
ENDS_WITHIN_S = 5.0  # for a command to end once its boards are at zero


class Command:
    """A command of the command line while it runs.

    If ``orderly``, it ends by itself once ``stop`` is asked, within ``patience_s``; otherwise a
    signal raises `RunStopped` in it.
    """

    def __init__(self, give_up: Callable[[int], None]) -> None:
        self.stop: StopRequest = StopRequest()
        self.orderly = self.opens_a_board = False
        self.patience_s = ENDS_WITHIN_S
        self.give_up: Callable[[int], None] = give_up

    @property
    def number(self) -> int:
        """Number of the signal that ends it, 0 if none does."""
        return 0 if _process.signals is None else _process.signals.number


class _Process:
    """Boards, runs and command of this process, its entry in the registry and its signals."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        # Also boards that nothing else refers to any more: they may go on.
        self.boards: dict[Board, int] = {}
        self.runs: list[StopRequest] = []
        self.command: Command | None = None
        self.signals: _Signals | None = None
        self.in_run = False  # whether the main thread is in a run, which ends by itself
        self.reason = ""  # for which this process drives no board any more
        self._entry: RunEntry | None = None
        self._losses = 0  # number of boards that were closed and had not confirmed zero
        self._earlier_losses = 0  # those of earlier entries

    def announce(self) -> None:
        """Announce this process, and refuse what it begins if it was stopped."""
        if self._entry is None and not self.reason:
            self._entry = RunEntry(self._stop_requested)
        self.handle_signals()
        # In this order: a stop leaves its mark before it looks for runs.
        asked = self._entry is not None and self._entry.is_asked
        if self.reason or asked or stopped_since_start():
            raise BoardStoppedError(
                f"this program was stopped by {self.reason or 'smarttouch stop'}, and drives no "
                "board any more: start it again"
            )

    def handle_signals(self) -> None:
        if threading.current_thread() is threading.main_thread():
            self.signals = self.signals or _Signals(self.command)
            if self._entry is not None:
                self.signals.wake_at_once()

    def declare(self, own_ua: int) -> None:
        """Enter the current of all boards, unless that is too much with those of other runs."""
        # Imported here, so that the program's help loads no profile.
        from smarttouch.profile.ceilings import CEILING_USER_MA

        assert self._entry is not None
        most_ua = round(1000 * CEILING_USER_MA)
        total_ua = self._entry.declare(sum(self.boards.values()), most_ua)
        if own_ua and total_ua > most_ua:
            raise BoardError(
                f"the displays of this user could drive {total_ua / 1000:g} mA together with this "
                f"one, which may drive {own_ua / 1000:g} mA: {CEILING_USER_MA:g} mA are allowed, "
                "so close another display or lower limits.total_ma in the profile"
            )

    def leave(self, board: "Board | None", run: StopRequest | None, at_zero: bool) -> None:
        with self.lock:
            self._losses += board in self.boards and not at_zero
            if board is not None and self.boards.pop(board, 0) and self._entry is not None:
                with suppress(SmartTouchError):
                    self._entry.declare(sum(self.boards.values()))
            # By identity, as equal requests compare equal.
            self.runs = [each for each in self.runs if each is not run]
            command = self.command
            if self.boards or self.runs or (command is not None and command.opens_a_board):
                return
            if self._entry is not None:
                self._entry.withdraw(at_zero=self._losses == self._earlier_losses)
                # The next run of this process answers for its own boards.
                self._entry, self._earlier_losses = None, self._losses
            if command is None and self.signals is not None and self.signals.close():
                self.signals = None

    def end(self, reason: str, *, for_good: bool = True) -> bool:
        """Bring all boards to zero and ask all runs to end; return whether all boards have
        confirmed zero. ``for_good``: no board opens any more."""
        with self.lock:
            if for_good:
                self.reason = self.reason or reason
            runs, boards, command = [*self.runs], [*self.boards], self.command
            earlier_losses = self._earlier_losses
        for run in [*runs, *([] if command is None else [command.stop])]:
            # Before its board refuses.
            run.ask(reason, at_once=False)
        at_zero: list[Board] = []

        def bring_to_zero(board: "Board") -> None:
            with suppress(SmartTouchError, OSError):
                (board.halt if for_good else board.stop)()
                at_zero.append(board)

        threads = [threading.Thread(target=bring_to_zero, args=(board,)) for board in boards]
        for thread in threads:
            thread.daemon = True
            thread.start()
        deadline_s = time.monotonic() + ZERO_WITHIN_S
        for thread in threads:
            thread.join(max(0.0, deadline_s - time.monotonic()))
        for board in at_zero:
            self.leave(board, None, at_zero=True)
        while self.boards and time.monotonic() < deadline_s:
            # The run that ends may still confirm it, when it closes its board.
            time.sleep(0.01)
        # A board that has not confirmed zero stays announced until it is closed.
        return not self.boards and self._losses == earlier_losses

    def forget(self) -> None:
        """Leave boards, entry and signals to the parent of this forked process."""
        if self._entry is not None:
            self._entry.close_inherited()
        if self.signals is not None:
            self.signals.close(inherited=True)

    def _stop_requested(self, reason: str, answer: Callable[[bool], None]) -> None:
        answer(self.end(reason))
        if self.command is None:
            return
        if hasattr(signal, "pthread_kill"):
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)
        else:
            signal.raise_signal(signal.SIGTERM)


class _Signals:
    """Handler of the signals that would end this process, or raise KeyboardInterrupt in it.

    It locks nothing: it puts the number into a queue, from which a thread takes it. With a board
    open, another thread learns of signals also while the main thread cannot run a handler.
    """

    def __init__(self, command: Command | None) -> None:
        self.number = 0  # of the first signal
        self._raised, self._command = False, command
        self._numbers: SimpleQueue[tuple[str, int]] = SimpleQueue()
        self._pipe: tuple[int, int] | None = None
        self._before: dict[int, Any] = {}
        for number in SIGNALS:
            before = signal.getsignal(number)
            # What a program handles by itself, and what it ignores, stays as it is.
            if before in (signal.SIG_DFL, signal.default_int_handler):
                self._before[number] = before
                signal.signal(number, self._handle)
        threading.Thread(target=self._work, name="signals", daemon=True).start()

    def wake_at_once(self) -> None:
        """Learn of signals whatever the main thread does."""
        if fcntl is None:  # Windows takes a socket
            return
        if self._pipe is None:
            self._pipe = os.pipe()
            os.set_blocking(self._pipe[1], False)
            threading.Thread(target=self._read, name="wakeup", daemon=True).start()
        _replace_wakeup(self._pipe[1], -1)

    def close(self, inherited: bool = False) -> bool:
        """Handle signals no more; return False if that is impossible or a command is ending."""
        ending = self._command is not None and self.number and not inherited
        if ending or threading.current_thread() is not threading.main_thread():
            return False
        for number, before in self._before.items():
            if signal.getsignal(number) == self._handle:
                signal.signal(number, before)
        self._numbers.put(("", 0))
        if self._pipe is not None:
            reading, writing = self._pipe
            _replace_wakeup(-1, writing)
            if inherited:
                # The parent reads from the same pipe.
                os.close(reading)
            else:
                os.write(writing, b"\0")
            os.close(writing)
        return True

    def raise_pending(self) -> None:
        """Raise what ends the main thread, now that its run has ended."""
        if self.number and not self._raised:
            self._raised = True
            raise self._error(self.number)

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        if _is_typed(number):
            interrupt(KeyboardInterrupt())
            return
        self.number = self.number or number
        self._numbers.put(("handler", number))
        orderly = _process.in_run if self._command is None else self._command.orderly
        # Once: what it unwinds must not be cut short.
        if not (self._raised or orderly):
            self._raised = True
            interrupt(self._error(number))

    def _error(self, number: int) -> BaseException:
        if number == signal.SIGINT and self._command is None:
            return KeyboardInterrupt()
        return RunStopped(number, _process.reason or None)

    def _read(self) -> None:
        assert self._pipe is not None
        reading = self._pipe[0]
        while 0 not in (numbers := os.read(reading, 64)):
            for number in numbers:
                if signal.getsignal(number) == self._handle and not _is_typed(number):
                    self._numbers.put(("wakeup", number))
        os.close(reading)

    def _work(self) -> None:
        command, deadline_s = self._command, None
        counts: Counter[str] = Counter()
        # A signal may come both ways; only a second one ends the process at once.
        while max(counts.values(), default=0) < 2:
            left_s = None if deadline_s is None else max(0.0, deadline_s - time.monotonic())
            try:
                way, number = self._numbers.get(timeout=left_s)
            except Empty:
                break
            if not number:
                return
            counts[way] += 1
            if counts.total() == 1:
                self.number = self.number or number
                again = command is None and number == signal.SIGINT
                _process.end(SIGNALS[signal.Signals(number)], for_good=not again)
                if command is not None:
                    deadline_s = time.monotonic() + command.patience_s
        # Every board is at zero, or that is unknown: what still blocks the end is cut off.
        if command is not None:
            command.give_up(self.number)
        os._exit(128 + self.number)


def _replace_wakeup(new: int, old: int) -> None:
    """Set the descriptor that is written to on signals, unless an event loop has set its own."""
    now = signal.set_wakeup_fd(new, warn_on_full_buffer=False)
    if now not in (-1, new, old):
        signal.set_wakeup_fd(now)


def _is_typed(number: int) -> bool:
    """Return whether a signal is Ctrl-C in an interpreter or notebook, where a person goes on."""
    return number == signal.SIGINT and hasattr(sys, "ps1")


def _after_fork() -> None:
    """Give a forked process boards, runs and signals of its own, and none of its parent's."""
    global _process
    _process.forget()
    _process = _Process()


_process = _Process()
if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_after_fork)


def enter(board: "Board") -> None:
    """Announce a board that is about to be opened, if a stop must reach it; raise BoardError if
    this program was stopped, or the displays of this user could drive too much together."""
    if not board.announced:
        return
    if fcntl is None:
        raise BoardError(
            "boards with a line need Linux or macOS so far: use simulated: or memory: here"
        )
    with _process.lock:
        if board in _process.boards:
            # The thread that fails would withdraw the board that the other has open.
            raise BoardError("another thread opens or closes the board: try again")
        _process.boards[board] = board.budget_ua
        try:
            _process.announce()
            _process.declare(board.budget_ua)
        except BaseException:
            leave(board)
            raise


def leave(board: "Board", at_zero: bool = True) -> None:
    """Withdraw a board that is closed; a stop reports one that has not confirmed zero."""
    _process.leave(board, None, at_zero)


def expect(board: "Board") -> None:
    """Announce the command that runs, if it will open a board that a stop must reach."""
    command = _process.command
    if command is not None and board.announced:
        with _process.lock:
            command.opens_a_board = True
            _process.announce()


def current_command() -> Command | None:
    """Return the command that runs in this process, if there is one."""
    return _process.command


@contextmanager
def running_command(give_up: Callable[[int], None]) -> Iterator[Command]:
    """Let signals and stops end a command in a block; ``give_up`` ends the process if something
    blocks the end."""
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
        _process.command = None
        _process.leave(None, None, at_zero=True)


@contextmanager
def stoppable_run(stop: StopRequest, board: "Board") -> Iterator[Callable[[], None]]:
    """Announce a run for a block; after a signal in the main thread, RunStopped or
    KeyboardInterrupt ends the block, or follows it once what it yields was called."""
    if not board.announced:
        yield lambda: None
        return
    main = threading.current_thread() is threading.main_thread()

    def to_its_end() -> None:
        _process.in_run = main or _process.in_run

    signals = None
    try:
        with _process.lock:
            _process.runs.append(stop)
            _process.announce()
        signals = _process.signals
        yield to_its_end
    finally:
        if main:
            _process.in_run = False
        _process.leave(None, stop, at_zero=True)
        if main and signals is not None and _process.command is None:
            signals.raise_pending()
