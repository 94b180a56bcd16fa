"""Runs on this machine: a second process can find and stop them, also while they start."""

import contextlib
import os
import signal
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from platformdirs import user_state_path

from smarttouch.clock import now_ns
from smarttouch.errors import SmartTouchError
from smarttouch.posix import fcntl
from smarttouch.stopping import RunStopped

_MARK = "stopped"
_MARK_BYTES = 200
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
_OWN_STAT = Path("/proc/self/stat")
_STARTED = 19
"""Place of the process's start, after the name of its program."""
_IMPORTED_NS = now_ns()


@contextmanager
def announced() -> Iterator[None]:
    """Let other processes know of this one as long as the block runs.

    Raises
    ------
    SmartTouchError
        If they cannot: a run that could not be stopped from elsewhere does not begin.
    """
    try:
        path = state_folder() / f"{os.getpid()}.run"
        number, hidden = _new_file()
        try:
            # Held as long as we live, however we end: a file that nobody holds means nothing.
            fcntl.flock(number, fcntl.LOCK_EX)
            hidden.replace(path)
        except OSError:
            os.close(number)
            hidden.unlink(missing_ok=True)
            raise
    except OSError as error:
        file = Path(error.filename2 or error.filename or path)
        raise SmartTouchError(
            f"cannot write {file}, by which smarttouch stop would find this run: "
            f"{error.strerror}; move what is there out of the way",
            about="file",
            problem="unwritable",
            value=file,
        ) from None
    try:
        yield
    finally:
        path.unlink(missing_ok=True)
        os.close(number)


def running() -> list[int]:
    """Return the process numbers of all runs; files of runs that were killed are removed.

    Whatever else lies in their folder is passed over.
    """
    found = []
    for path in listed():
        process, dot, ending = path.name.partition(".")
        if not (process.isascii() and process.isdigit() and dot + ending == ".run"):
            continue
        with regular(path) as number:
            if number is None:
                continue
            try:
                fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                found.append(int(process))
            else:
                with contextlib.suppress(OSError):
                    path.unlink()
    return found


def leave_mark() -> int:
    """Let no process that has been started until now begin current; return the time, ns.

    Raises
    ------
    SmartTouchError
        If there is no place for the mark.
    """
    time_ns = now_ns()
    try:
        mark = state_folder() / _MARK
        number, hidden = _new_file()
        with os.fdopen(number, "w") as file:
            file.write(f"{_boot()} {time_ns}")
        try:
            hidden.replace(mark)
        except OSError:
            hidden.unlink(missing_ok=True)
            raise
    except OSError as error:
        place = Path(error.filename2 or error.filename or mark)
        raise SmartTouchError(
            f"cannot write {place}, which keeps runs that are just starting from beginning: "
            f"{error.strerror}; move what is there out of the way and stop again",
            about="file",
            problem="unwritable",
            value=place,
        ) from None
    return time_ns


def refuse_if_stopped() -> None:
    """Raise if ``smarttouch stop`` came after this process was started.

    Raises
    ------
    RunStopped
        As if it had been in time to be asked by a signal: no current is to begin.
    """
    if is_stopped():
        raise RunStopped(signal.SIGTERM, "smarttouch stop")


def is_stopped() -> bool:
    """Return whether ``smarttouch stop`` came after this process was started."""
    mark_ns = _mark_ns()
    return mark_ns is not None and started_ns() < mark_ns <= now_ns()


def started_ns() -> int:
    """Return when this process was started, by the clock of `now_ns`; never too late."""
    try:
        fields = _OWN_STAT.read_text().rpartition(")")[2].split()
        return int(fields[_STARTED]) * 1_000_000_000 // os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return _IMPORTED_NS


def _mark_ns() -> int | None:
    """Return the time of the last stop since the machine was started, None if there was none."""
    with regular(state_folder() / _MARK) as number:
        if number is None:
            return None
        words = os.read(number, _MARK_BYTES).decode("ascii", "replace").split()
    if len(words) != 2 or words[0] != _boot() or not words[1].isdecimal():
        return None
    return int(words[1])


def _boot() -> str:
    """Return what distinguishes this start of the machine from others."""
    try:
        return _BOOT_ID.read_text().strip() or "-"
    except OSError:
        return "-"


def state_folder() -> Path:
    """Return the folder of this user's runs and open boards, which nobody else can enter.

    Raises
    ------
    SmartTouchError
        If it cannot be made.
    """
    try:
        folder = user_state_path("smarttouch", appauthor=False, ensure_exists=True)
        if folder.stat().st_mode & 0o077:
            folder.chmod(0o700)
        return folder
    except OSError as error:
        message = f"cannot make the folder {error.filename} for the state of runs: {error.strerror}"
        raise SmartTouchError(
            message, about="folder", problem="unwritable", value=error.filename
        ) from None


def listed() -> list[Path]:
    """Return all files of that folder."""
    try:
        return sorted(state_folder().iterdir())
    except OSError as error:
        message = f"cannot look for runs in {error.filename}: {error.strerror}"
        raise SmartTouchError(
            message, about="folder", problem="unreadable", value=error.filename
        ) from None


def _new_file() -> tuple[int, Path]:
    """Return a new file's descriptor and its path, a name that nothing else has."""
    number, path = tempfile.mkstemp(prefix=".", suffix=".new", dir=state_folder())
    return number, Path(path)


@contextmanager
def regular(path: Path) -> Iterator[int | None]:
    """Open a file for reading; None for what is no file, cannot be read, or would block."""
    try:
        number = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError:
        yield None
        return
    try:
        yield number if stat.S_ISREG(os.fstat(number).st_mode) else None
    finally:
        os.close(number)
