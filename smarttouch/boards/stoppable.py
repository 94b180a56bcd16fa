"""Parts of this process that a stop must reach: its open boards and its runs.

``smarttouch stop`` asks on a named pipe, which works with any threads and signal handlers; SIGTERM
and SIGHUP do the same where the program does not handle them. Commands of the command line have
their own handler (`SignalWatch`).
"""

import atexit
import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Protocol

from smarttouch.base.errors import BoardError, BoardStoppedError, SmartTouchError
from smarttouch.base.posix import fcntl, set_nonblocking
from smarttouch.base.stopping import SIGNALS, ZERO_WITHIN_S, RunStopped, StopRequest
from smarttouch.boards.announced import Announcement, stopped_since_start

RUNS_END_WITHIN_S = 2.0  # for runs to end and close recordings while a stop waits
_ENDING = tuple(number for number in SIGNALS if number != signal.SIGINT)
"""Signals that end a process at once where nothing handles them."""


class _Stoppable(Protocol):
    """Interface of boards to this module."""

    _halted: bool
    _opened: bool
    _stopped: threading.Event

    @property
    def announced(self) -> bool: ...
    @property
    def budget_ua(self) -> int: ...
    def halt(self) -> None: ...


def _require_posix() -> None:
    """Raise where other programs could not stop what drives a board with a line."""
    if fcntl is None:
        raise BoardError(
            "boards with a line need Linux or macOS, where smarttouch stop can find them: use "
            "simulated: or memory: here"
        )


class _Program:
    """The boards, runs and commands of this process, and their one announcement."""

    def __init__(self) -> None:
        self._changed = threading.Condition(threading.RLock())
        self._announcement: Announcement | None = None
        # Also those that nothing else refers to any more: they may go on.
        self._boards: dict[_Stoppable, int] = {}
        self._runs: list[StopRequest] = []
        self._commands = 0
        self._ended = ""

    @property
    def ended(self) -> bool:
        """Whether it was stopped for good."""
        return bool(self._ended)

    def enter_command(self) -> None:
        with self._changed:
            self._commands += 1
            try:
                self._announce()
            except BaseException:
                self.leave_command()
                raise

    def leave_command(self) -> None:
        with self._changed:
            self._commands -= 1
            self._withdraw_if_idle()

    def enter_run(self, stop: StopRequest) -> None:
        _require_posix()
        with self._changed:
            self._runs.append(stop)
            try:
                self._announce()
                self._refuse_if_ended()
            except BaseException:
                self.leave_run(stop)
                raise

    def leave_run(self, stop: StopRequest) -> None:
        with self._changed:
            # By identity, as equal requests compare equal.
            self._runs = [each for each in self._runs if each is not stop]
            self._withdraw_if_idle()
            self._changed.notify_all()

    def enter_board(self, board: _Stoppable) -> None:
        _require_posix()
        with self._changed:
            if board in self._boards:
                # The thread that fails would withdraw the board that the other has open.
                raise BoardError("another thread opens or closes the board: try again")
            self._boards[board] = board.budget_ua
            try:
                self._announce()
                # In this order: a stop leaves its mark before it looks for announcements.
                self._refuse_if_ended()
                self._refuse_beyond_budget(board.budget_ua)
            except BaseException:
                self.leave_board(board)
                raise

    def leave_board(self, board: _Stoppable, at_zero: bool = True) -> None:
        with self._changed:
            if self._boards.pop(board, None) is not None:
                if self._announcement is not None and not at_zero:
                    self._announcement.report_lost()
                self._declare()
                self._withdraw_if_idle()

    def end(self, reason: str) -> None:
        """Put every open board at zero for good, and end runs; no board opens any more."""
        with self._changed:
            self._ended = self._ended or reason
            runs, boards = list(self._runs), list(self._boards)
        for run in runs:
            # Its board is put at zero below.
            run.ask(reason, at_once=False)
        at_zero: list[_Stoppable] = []
        halts = [
            threading.Thread(target=_halt, args=(board, at_zero), daemon=True) for board in boards
        ]
        for each in halts:
            each.start()
        for each in halts:
            each.join(ZERO_WITHIN_S)
        self.await_runs()
        with self._changed:
            # An unconfirmed board stays announced until it is closed, so that a stop reports it.
            for board in at_zero:
                self._boards.pop(board, None)
            if not self._boards:
                self._withdraw()

    def await_runs(self) -> None:
        """Wait a while for runs that were asked to end."""
        with self._changed:
            if self._ended:
                self._changed.wait_for(lambda: not self._runs, RUNS_END_WITHIN_S)

    def leave_to_parent(self) -> None:
        """In a forked process, release the boards, which are the parent's."""
        for board in self._boards:
            # Not open here: closing one must not write to its line.
            board._opened, board._halted = False, True
            board._stopped.set()
        if self._announcement is not None:
            self._announcement.close_inherited()

    def _announce(self) -> None:
        if self._announcement is None and not self._ended and fcntl is not None:
            asked = None if self._commands else lambda: self.end("smarttouch stop")
            self._announcement = Announcement(asked)
        if self._announcement is not None and not self._commands:
            # Again each time: only the main thread can.
            _signals.install()

    def _withdraw_if_idle(self) -> None:
        if not (self._boards or self._runs or self._commands):
            self._withdraw()

    def _withdraw(self) -> None:
        if self._announcement is not None:
            self._announcement.withdraw()
            self._announcement = None
            _signals.restore()

    def _declare(self) -> int:
        total_ua = sum(self._boards.values())
        if self._announcement is not None:
            self._announcement.declare(total_ua)
        return total_ua

    def _refuse_if_ended(self) -> None:
        if self._ended or stopped_since_start():
            raise BoardStoppedError(
                f"this program was stopped by {self._ended or 'smarttouch stop'}, and drives no "
                "board any more: start it again"
            )

    def _refuse_beyond_budget(self, own_ua: int) -> None:
        """Declare first, then check, so that of two boards that open at once at least one is
        refused."""
        # Imported here, so that the program's help loads no profile.
        from smarttouch.profile.ceilings import CEILING_USER_MA

        total_ua = self._declare()
        if not own_ua or self._announcement is None:
            return
        total_ua += self._announcement.others_ua()
        if total_ua > 1000 * CEILING_USER_MA:
            raise BoardError(
                f"the displays of this user could drive {total_ua / 1000:g} mA together with this "
                f"one, which may drive {own_ua / 1000:g} mA: {CEILING_USER_MA:g} mA are allowed, "
                "so close another display or lower limits.total_ma in the profile"
            )


class _Signals:
    """Handler of SIGTERM and SIGHUP where the program has none. Without a lock: a thread reads
    signal numbers from a pipe and ends boards and runs, whatever the main thread does, which then
    ends by `RunStopped`."""

    def __init__(self) -> None:
        self.number = 0  # of the signal that ends the process once the main thread's run has ended
        self.orderly = False  # whether the main thread is in a run, which ends by itself
        self._count = 0
        self._pipe: tuple[int, int] | None = None

    def install(self) -> None:
        """Handle the signals that would end the process at once; only the main thread can."""
        if threading.current_thread() is not threading.main_thread():
            return
        free = [number for number in _ENDING if signal.getsignal(number) == signal.SIG_DFL]
        if not free:
            return
        if self._pipe is None:
            self._pipe = os.pipe()
            set_nonblocking(self._pipe[1])
            threading.Thread(target=self._watch, name="signals", daemon=True).start()
            atexit.register(_program.await_runs)
        # Even if the main thread is busy; an event loop's own wakeup descriptor is kept.
        before = signal.set_wakeup_fd(self._pipe[1], warn_on_full_buffer=False)
        if before not in (-1, self._pipe[1]):
            signal.set_wakeup_fd(before)
        for number in free:
            signal.signal(number, _on_signal)

    def restore(self) -> None:
        """Handle none any more. Outside the main thread handlers stay, and still end the
        process."""
        if self._pipe is None or threading.current_thread() is not threading.main_thread():
            return
        if self._count:
            return
        for number in _ENDING:
            if signal.getsignal(number) == _on_signal:
                signal.signal(number, signal.SIG_DFL)
        now = signal.set_wakeup_fd(-1)
        if now not in (-1, self._pipe[1]):
            signal.set_wakeup_fd(now)

    def handle(self, number: int) -> None:
        """In the main thread, let its run end, or interrupt whatever else it does."""
        self._count += 1
        if self._pipe is not None:
            # Explicitly: an event loop may have replaced the pipe since.
            with contextlib.suppress(BlockingIOError):
                os.write(self._pipe[1], bytes([number]))
        if self.orderly:
            self.number = self.number or number
        elif self._count == 1:
            # Only the first: its unwinding must not be interrupted.
            raise RunStopped(number)

    def _watch(self) -> None:
        assert self._pipe is not None
        while True:
            for number in os.read(self._pipe[0], 64):
                # A handler that the program has set meanwhile is left alone.
                if number in _ENDING and signal.getsignal(number) == _on_signal:
                    _program.end(SIGNALS[signal.Signals(number)])
                    if self._count > 1:
                        # A second one ends the process at once: every board is at zero.
                        os._exit(128 + number)


def _on_signal(number: int, _frame: FrameType | None) -> None:
    _signals.handle(number)


def _halt(board: _Stoppable, at_zero: list[_Stoppable]) -> None:
    with contextlib.suppress(SmartTouchError, OSError):
        board.halt()
        at_zero.append(board)


def _after_fork() -> None:
    """Give a forked process boards, runs and signals of its own, and none of its parent's."""
    global _program, _signals
    if _signals._pipe is not None:
        with contextlib.suppress(ValueError):
            _signals.restore()
        for end in _signals._pipe:
            os.close(end)
    _program.leave_to_parent()
    _program, _signals = _Program(), _Signals()


_program, _signals = _Program(), _Signals()
if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_after_fork)


def enter(board: _Stoppable) -> None:
    """Announce a board that is about to be opened, if a stop must reach it."""
    if board.announced:
        _program.enter_board(board)


def leave(board: _Stoppable, at_zero: bool = True) -> None:
    """Withdraw a board that is closed; a stop reports one that has not confirmed zero."""
    _program.leave_board(board, at_zero)


@contextmanager
def announced() -> Iterator[None]:
    """Announce a command, which signals end in order, for a block."""
    _program.enter_command()
    try:
        yield
    finally:
        _program.leave_command()


@contextmanager
def stoppable_run(stop: StopRequest, board: _Stoppable) -> Iterator[Callable[[], None]]:
    """Announce a run for a block, which ends by RunStopped after a signal in the main thread; what
    it yields lets the block end in its own time."""
    if not board.announced:
        yield lambda: None
        return
    main = threading.current_thread() is threading.main_thread()

    def to_its_end() -> None:
        _signals.orderly = main or _signals.orderly

    _program.enter_run(stop)
    try:
        yield to_its_end
    finally:
        _program.leave_run(stop)
        if main:
            _signals.orderly = False
            if _signals.number:
                raise RunStopped(_signals.number)
