"""Which runs there are on this machine, so that a second process can stop them."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from platformdirs import user_state_path

from smarttouch.errors import SmartTouchError


def _folder() -> Path:
    return user_state_path("smarttouch", appauthor=False, ensure_exists=True)


@contextmanager
def announced() -> Iterator[None]:
    """Let other processes know of this one as long as the block runs.

    Raises
    ------
    SmartTouchError
        If they cannot: a run that could not be stopped from elsewhere does not begin.
    """
    try:
        path = _folder() / f"{os.getpid()}.run"
        hidden = path.with_suffix(".new")
        file = hidden.open("w")
        # Held as long as we live, however we end: a file that nobody holds means nothing.
        fcntl.flock(file, fcntl.LOCK_EX)
        hidden.replace(path)
    except OSError as error:
        raise SmartTouchError(
            f"cannot write {error.filename}, by which smarttouch stop would find this run: "
            f"{error.strerror}"
        ) from None
    try:
        yield
    finally:
        path.unlink(missing_ok=True)
        file.close()


def running() -> list[int]:
    """Return the process numbers of all runs; files of runs that were killed are removed."""
    found = []
    for path in sorted(_folder().glob("*.run")):
        try:
            with path.open() as file:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.unlink(missing_ok=True)
        except BlockingIOError:
            found.append(int(path.stem))
        except FileNotFoundError:
            continue
    return found
