"""Processes that drive boards, announced so that others can stop them and add up their current."""

import contextlib
import os
import re
import signal
import stat
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from platformdirs import user_state_path

from smarttouch.base.clock import now_ns
from smarttouch.base.errors import SmartTouchError
from smarttouch.base.posix import O_CLOEXEC, O_NOFOLLOW, O_NONBLOCK, fcntl
from smarttouch.base.stopping import RunStopped

ENDED_WITHIN_S = 3.0  # of being asked by `stop_all`
_STOP, _WAKE = b"\0", b"\1"  # bytes on the pipe: a request to stop, and the process's own end
_NAME = re.compile(r"[0-9]+-[0-9]+\.run")
_TOTAL_BYTES = 12
_LOST = b"lost"  # behind the total
_MARK = "stopped"
_MARK_NAME = re.compile(rf"{_MARK}-[0-9]{{1,20}}")
_MARK_BYTES = 200
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
_OWN_STAT = Path("/proc/self/stat")
_STARTED = 19  # place of the process's start, after the name of its program
_IMPORTED_NS = now_ns()


class Announcement:
    """File that announces this process to others, and the named pipe on which they ask it to stop.

    A request on the pipe calls ``on_request`` in a thread of its own; without it, the process is
    asked by a signal. It raises where the file cannot be written: what others could not stop does
    not begin.
    """

    def __init__(self, on_request: Callable[[], None] | None = None) -> None:
        self._withdrawn, self._lock = False, threading.Lock()
        # A name of its own each time: whoever removes the file of a run that has ended must not
        # remove that of the next one.
        self._path = _folder() / f"{os.getpid()}-{now_ns()}.run"
        self._pipe = None if on_request is None else self._path.with_suffix(".stop")
        try:
            if self._pipe is not None:
                # First: a process that finds the file must find the pipe.
                os.mkfifo(self._pipe, 0o600)
                # For writing too: it never reaches its end, and `withdraw` can wake its reader.
                flags = os.O_RDWR | O_NOFOLLOW | O_CLOEXEC
                self._requests = os.open(self._pipe, flags)
            self._number, hidden = _new_file()
            try:
                # Locked until this process ends, however it ends; an unlocked file means nothing.
                fcntl.flock(self._number, fcntl.LOCK_EX)
                hidden.replace(self._path)
            except OSError:
                os.close(self._number)
                hidden.unlink(missing_ok=True)
                raise
        except OSError as error:
            file = Path(error.filename2 or error.filename or self._path)
            raise SmartTouchError(
                f"cannot write {file}, by which smarttouch stop would find this run: "
                f"{error.strerror}; move what is there out of the way"
            ) from None
        if on_request is not None:
            threading.Thread(
                target=self._wait, args=(on_request,), name="stop requests", daemon=True
            ).start()

    def declare(self, total_ua: int) -> None:
        """State the largest total current of all boards that this process has open, µA."""
        os.pwrite(self._number, f"{total_ua:<{_TOTAL_BYTES}}".encode("ascii"), 0)

    def report_lost(self) -> None:
        """State that a board was closed that has not confirmed zero, for who stops this process."""
        os.pwrite(self._number, _LOST, _TOTAL_BYTES)

    def others_ua(self) -> int:
        """Return the sum of what all other processes have declared, µA."""
        return sum(total for path, total in _held().items() if path != self._path)

    def withdraw(self) -> None:
        """Remove the file and the pipe."""
        self._path.unlink(missing_ok=True)
        os.close(self._number)
        if self._pipe is not None:
            self._pipe.unlink(missing_ok=True)
            with self._lock:
                self._withdrawn = True
                os.write(self._requests, _WAKE)

    def close_inherited(self) -> None:
        """Close the descriptors in a forked process; the announcement remains the parent's."""
        os.close(self._number)
        if self._pipe is not None:
            os.close(self._requests)

    def _wait(self, on_request: Callable[[], None]) -> None:
        while True:
            asked = _STOP in os.read(self._requests, 64)
            with self._lock:
                if self._withdrawn:
                    os.close(self._requests)
                    return
            if asked:
                on_request()


def running() -> list[int]:
    """Return the process ids of all runs; remove files of runs that were killed, and ignore other
    files."""
    return [_process(path) for path in _held()]


def _process(path: Path) -> int:
    """Return the id of the process that a file announces."""
    return int(path.name.partition("-")[0])


def _held() -> dict[Path, int]:
    """Return the files of announced processes, with the current that each has declared, µA."""
    found = {}
    for path in _listed():
        if not _NAME.fullmatch(path.name):
            continue
        with _regular(path) as number:
            if number is None:
                continue
            try:
                # Shared: two processes that look at once must not take each other for a run.
                fcntl.flock(number, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                declared = os.pread(number, _TOTAL_BYTES, 0).strip()
                found[path] = int(declared) if declared.isdigit() else 0
            else:
                for each in (path, path.with_suffix(".stop")):
                    with contextlib.suppress(OSError):
                        each.unlink()
    return found


def stop_all() -> int:
    """End every run of this user with all electrodes at zero, and keep runs that are just starting
    from beginning; return how many were running."""
    # First the mark: a process not listed yet finds it before it begins.
    no_mark: SmartTouchError | None = None
    try:
        leave_mark()
    except SmartTouchError as error:
        no_mark = error
    asked = _held()
    with contextlib.ExitStack() as stack:
        # Open, they can be read when they are withdrawn.
        files = {path: stack.enter_context(_regular(path)) for path in asked}
        for path in asked:
            _ask_to_stop(path)
        deadline = time.monotonic() + ENDED_WITHIN_S
        while (left := running()) and time.monotonic() < deadline:
            time.sleep(0.02)
        lost = [
            _process(path)
            for path, number in files.items()
            if number is not None and os.pread(number, len(_LOST), _TOTAL_BYTES) == _LOST
        ]
    if left:
        raise SmartTouchError(
            f"{len(left)} of {len(asked)} runs have not ended within {ENDED_WITHIN_S:g} s (process "
            f"{left[0]}): switch the board off"
        )
    if lost:
        raise SmartTouchError(
            f"a board has not confirmed that it is at zero (of process {lost[0]}, which has "
            "ended): switch it off"
        )
    if no_mark is not None:
        raise no_mark
    # Start times come in steps of 10 ms: processes started from now on are later than the mark.
    time.sleep(0.02)
    return len(asked)


def _ask_to_stop(path: Path) -> None:
    """Ask an announced process to stop: on its pipe, or by a signal where it has none."""
    try:
        flags = os.O_WRONLY | O_NONBLOCK | O_NOFOLLOW | O_CLOEXEC
        number = os.open(path.with_suffix(".stop"), flags)
    except OSError:
        number = -1
    try:
        if number >= 0 and stat.S_ISFIFO(os.fstat(number).st_mode):
            # A full pipe holds enough requests.
            with contextlib.suppress(BlockingIOError, BrokenPipeError):
                os.write(number, _STOP)
        elif path.exists():
            # The pipe is withdrawn after the file: this one has none.
            with contextlib.suppress(ProcessLookupError):
                os.kill(_process(path), signal.SIGTERM)
    finally:
        if number >= 0:
            os.close(number)


def leave_mark() -> int:
    """Keep all processes that have started by now from beginning current; return the time, ns."""
    time_ns = now_ns()
    try:
        # A file of its own: of two stops at once, the older could replace the newer one's.
        mark = _folder() / f"{_MARK}-{time_ns}"
        number, hidden = _new_file()
        with os.fdopen(number, "w") as file:
            file.write(_boot())
        try:
            hidden.replace(mark)
        except OSError:
            hidden.unlink(missing_ok=True)
            raise
    except OSError as error:
        place = Path(error.filename2 or error.filename or mark)
        raise SmartTouchError(
            f"cannot write {place}, which keeps runs that are just starting from beginning: "
            f"{error.strerror}; move what is there out of the way and stop again"
        ) from None
    for path, earlier_ns in _marks().items():
        if earlier_ns < time_ns:
            with contextlib.suppress(OSError):
                path.unlink()
    return time_ns


def refuse_if_stopped() -> None:
    """Raise RunStopped if ``smarttouch stop`` came after this program was started."""
    if stopped_since_start():
        raise RunStopped(signal.SIGTERM, "smarttouch stop")


def stopped_since_start() -> bool:
    """Return whether ``smarttouch stop`` came after this program was started."""
    return _begun_ns < max(_marks().values(), default=-1)


def started_ns() -> int:
    """Return when this process started, by the clock of `now_ns`, or a time before that."""
    try:
        fields = _OWN_STAT.read_text().rpartition(")")[2].split()
        return int(fields[_STARTED]) * 1_000_000_000 // os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return _IMPORTED_NS


_begun_ns = started_ns()  # of the program: what it forks after a stop is stopped as it is


def _marks() -> dict[Path, int]:
    """Return the marks of all stops with their times, ns; −1 for what is none since the machine
    booted."""
    found, boot = {}, _boot().encode()
    for path in _listed():
        if _MARK_NAME.fullmatch(path.name):
            with _regular(path) as number:
                counts = number is not None and os.read(number, _MARK_BYTES) == boot
            time_ns = int(path.name.rpartition("-")[2])
            found[path] = time_ns if counts and time_ns <= now_ns() else -1
    return found


def _boot() -> str:
    """Return an id of this boot of the machine."""
    try:
        return _BOOT_ID.read_text().strip() or "-"
    except OSError:
        return "-"


def _folder() -> Path:
    try:
        path = user_state_path("smarttouch", appauthor=False, ensure_exists=True)
        if path.stat().st_mode & 0o077:
            # No other user may see runs or stop them.
            path.chmod(0o700)
        return path
    except OSError as error:
        message = f"cannot make the folder {error.filename} for the state of runs: {error.strerror}"
        raise SmartTouchError(message) from None


def _listed() -> list[Path]:
    try:
        return sorted(_folder().iterdir())
    except OSError as error:
        message = f"cannot look for runs in {error.filename}: {error.strerror}"
        raise SmartTouchError(message) from None


def _new_file() -> tuple[int, Path]:
    """Return the descriptor and the unique path of a new file."""
    number, path = tempfile.mkstemp(prefix=".", suffix=".new", dir=_folder())
    return number, Path(path)


@contextmanager
def _regular(path: Path) -> Iterator[int | None]:
    """Open a regular file for reading; None if it is none, cannot be read, or would block."""
    try:
        number = os.open(path, os.O_RDONLY | O_NONBLOCK | O_NOFOLLOW | O_CLOEXEC)
    except OSError:
        yield None
        return
    try:
        yield number if stat.S_ISREG(os.fstat(number).st_mode) else None
    finally:
        os.close(number)
