"""Open boards that a finger may be on: one budget for all, and a stop that reaches each.

Every process of a user that has such a board open listens on a socket of its own, in the folder of
`announced`. ``smarttouch stop`` connects to it, and is answered when all boards of the process
are at zero. Each board has a file there, locked as long as it is open, with the most current that
it may drive: together they stay below `CEILING_USER_MA`.
"""

import atexit
import contextlib
import os
import re
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from smarttouch.boards import announced
from smarttouch.errors import BoardError, BoardStoppedError, SmartTouchError
from smarttouch.posix import fcntl
from smarttouch.profile.ceilings import CEILING_USER_MA

ANSWERS_WITHIN_S = 3.0
"""Time in which a process that is asked to stop has its boards at zero."""
ENDED_WITHIN_S = 3.0
"""Time in which runs end that were asked to."""
_FILE = re.compile(r"(\d+)\.\d+\.board")
_AT_ZERO, _IDLE = b"zero", b"idle"
"""Answers of a process that had boards open, and of one that had none."""
_LEAST_MA = 1e-3

_lock = threading.RLock()
_halts: list[Callable[[], object]] = []
"""What puts boards of this process at zero for good, in the order in which it is called."""
_boards = 0
"""Boards opened by this process, for the names of files."""
_listening: dict[Path, socket.socket] = {}
"""Socket of this process in each folder; another only where the folder has been changed."""
_stopped = False
"""Whether ``smarttouch stop`` has reached this process."""


class OpenBoard:
    """Entry of an open board: it counts to the budget, and ``smarttouch stop`` halts it.

    Parameters
    ----------
    halt : callable
        Puts the board at zero for good.
    total_ma : float, mA
        Most current of all cathodes that it may drive; 0 where another entry has it.

    Raises
    ------
    BoardStoppedError
        If this program was stopped.
    BoardError
        If boards that are open already leave no room in the budget.
    """

    def __init__(self, halt: Callable[[], object], total_ma: float) -> None:
        refuse_after_stop()
        self._halt, self._file = halt, -1
        try:
            if total_ma:
                self._enter(total_ma)
            with _lock:
                _listen()
                _halts.append(halt)
            # A stop between the first look and this found nobody.
            refuse_after_stop()
        except OSError as error:
            self.close()
            raise BoardError(
                f"cannot write {error.filename}, by which smarttouch stop would find this board: "
                f"{error.strerror}; move what is there out of the way",
                about="file",
                problem="unwritable",
                value=error.filename,
            ) from None
        except BaseException:
            self.close()
            raise

    def _enter(self, total_ma: float) -> None:
        """Lock a file of its own if the budget has room for it."""
        global _boards
        folder = announced.state_folder()
        # One process at a time: two could each find room for itself.
        with (folder / "budget.lock").open("w") as budget:
            fcntl.flock(budget, fcntl.LOCK_EX)
            open_ma = sum(currents_ma())
            if open_ma + total_ma > CEILING_USER_MA + _LEAST_MA:
                raise BoardError(
                    f"this display may drive {total_ma:g} mA, and others that are open "
                    f"{open_ma:g} mA: together more than {CEILING_USER_MA:g} mA; close one, or "
                    "lower limits.total_ma of the profile",
                    about="limits.total_ma",
                    problem="too large",
                    value=open_ma + total_ma,
                    allowed=CEILING_USER_MA,
                    remedy="limits.total_ma",
                )
            with _lock:
                _boards += 1
                self._path = folder / f"{os.getpid()}.{_boards}.board"
            self._file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            fcntl.flock(self._file, fcntl.LOCK_EX)
            os.write(self._file, repr(total_ma).encode())

    def close(self) -> None:
        """Remove the entry; a second time does nothing."""
        with _lock:
            if self._halt in _halts:
                _halts.remove(self._halt)
        if self._file >= 0:
            self._path.unlink(missing_ok=True)
            os.close(self._file)
            self._file = -1


@contextmanager
def ending_a_run(ask: Callable[[], object]) -> Iterator[None]:
    """Call a function when this process is stopped, before its boards are halted."""
    with _lock:
        _halts.insert(0, ask)
    try:
        yield
    finally:
        with _lock:
            _halts.remove(ask)


def refuse_after_stop() -> None:
    """Raise if ``smarttouch stop`` came after this process was started.

    Raises
    ------
    BoardStoppedError
    """
    if _stopped or announced.is_stopped():
        raise BoardStoppedError(
            "smarttouch stop has ended what this program drives: start the program again to "
            "begin again",
            about="board",
            problem="stopped",
            remedy="start again",
        )


def currents_ma() -> Iterator[float]:
    """Yield the most current of each open board of this user, mA; entries of the dead are removed.

    An entry that cannot be read counts as a whole budget.
    """
    for path in announced.listed():
        if not _FILE.fullmatch(path.name):
            continue
        with announced.regular(path) as number:
            if number is None:
                continue
            try:
                fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                try:
                    yield float(os.read(number, 100))
                except ValueError:
                    yield CEILING_USER_MA
            else:
                with contextlib.suppress(OSError):
                    path.unlink()


def stop_all() -> int:
    """End every run of this user with all electrodes at zero; return how many there were.

    What was started before and has not begun yet does not begin.

    Raises
    ------
    SmartTouchError
        If some have not ended in time, or those that are just starting could not be kept from it.
    """
    # First the mark: who is not listed yet will find it before it begins.
    no_mark: SmartTouchError | None = None
    try:
        announced.leave_mark()
    except SmartTouchError as error:
        no_mark = error
    asked = announced.running()
    # Programs first: they are at zero when they have answered.
    programs, silent = stop_processes(set(asked))
    count = len(asked) + len(programs) + len(silent)
    for process in (*asked, *silent):
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, signal.SIGTERM)
    deadline = time.monotonic() + ENDED_WITHIN_S
    while (left := _left(silent)) and time.monotonic() < deadline:
        time.sleep(0.02)
    if left:
        raise SmartTouchError(
            f"{len(left)} of {count} runs have not ended within {ENDED_WITHIN_S:g} s (process "
            f"{left[0]}): switch the board off",
            about="runs",
            problem="late",
            value=tuple(left),
            allowed=ENDED_WITHIN_S,
        )
    if no_mark is not None:
        raise no_mark
    # Who is started after this is newer than the mark, in the system's steps of 10 ms too.
    time.sleep(0.02)
    return count


def _left(silent: list[int]) -> list[int]:
    """Return which processes have not ended, of runs and of those that did not answer."""
    return announced.running() + [each for each in silent if _lives(each)]


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except OSError:
        return False
    return True


def stop_processes(but: set[int]) -> tuple[list[int], list[int]]:
    """Put the boards of all processes of this user at zero, for good.

    Parameters
    ----------
    but : set of int
        Processes that are stopped by a signal.

    Returns
    -------
    stopped, left : list of int
        Processes that have answered, and those that have not.
    """
    stopped, left = [], []
    for path in announced.listed():
        number, dot, ending = path.name.partition(".")
        if not number.isascii() or not number.isdigit() or dot + ending != ".sock":
            continue
        process = int(number)
        if process in but:
            continue
        answer = _ask(path)
        if answer is None:
            path.unlink(missing_ok=True)
        elif answer == _AT_ZERO:
            stopped.append(process)
        elif answer != _IDLE:
            left.append(process)
    return stopped, left


def _ask(path: Path) -> bytes | None:
    """Return what a process answers to a stop; None if there is no process any more."""
    with socket.socket(socket.AF_UNIX) as line, _short(path.parent) as folder:
        line.settimeout(ANSWERS_WITHIN_S)
        try:
            line.connect(f"{folder}/{path.name}")
        except (ConnectionRefusedError, FileNotFoundError):
            return None
        except OSError:
            return b""
        try:
            return line.recv(len(_AT_ZERO), socket.MSG_WAITALL)
        except OSError:
            return b""


def _listen() -> None:
    """Begin to listen for a stop, once in a process."""
    folder = announced.state_folder()
    if folder in _listening:
        return
    path = folder / f"{os.getpid()}.sock"
    path.unlink(missing_ok=True)
    line = _listening[folder] = socket.socket(socket.AF_UNIX)
    try:
        with _short(folder) as short:
            line.bind(f"{short}/{path.name}")
        path.chmod(0o600)
        line.listen()
    except OSError as error:
        del _listening[folder]
        line.close()
        error.filename = error.filename or str(path)
        raise
    threading.Thread(target=_serve, args=(line,), name="stop listener", daemon=True).start()


@atexit.register
def _stop_listening() -> None:
    for folder in _listening:
        (folder / f"{os.getpid()}.sock").unlink(missing_ok=True)


def _begin_in_child() -> None:
    """Leave the boards and sockets of the process that was forked to it."""
    global _stopped
    _halts.clear()
    _listening.clear()
    _stopped = False


os.register_at_fork(after_in_child=_begin_in_child)


def _serve(line: socket.socket) -> None:
    while True:
        try:
            asking, _ = line.accept()
        except OSError:
            return
        with asking, contextlib.suppress(OSError):
            idle = not _halts
            confirmed = stop_this_process()
            asking.sendall(_IDLE if idle else _AT_ZERO if confirmed else b"left")


def stop_this_process() -> bool:
    """Put all boards of this process at zero, for good; return whether each has confirmed it."""
    global _stopped
    _stopped = True
    with _lock:
        halts = _halts.copy()
    confirmed = True
    for halt in halts:
        try:
            halt()
        except SmartTouchError:
            confirmed = False
    return confirmed


@contextmanager
def _short(folder: Path) -> Iterator[str]:
    """Yield a short name of a folder: names of sockets have some hundred characters at most."""
    number = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield f"/proc/self/fd/{number}"
    finally:
        os.close(number)
