"""Which runs there are on this machine, so that a second process can stop them."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from platformdirs import user_state_path


def _folder() -> Path:
    return user_state_path("smarttouch", appauthor=False, ensure_exists=True)


@contextmanager
def announced() -> Iterator[None]:
    """Let other processes know of this one as long as the block runs."""
    path = _folder() / f"{os.getpid()}.run"
    with path.open("w") as file:
        # Held as long as we live, however we end: a file that nobody holds means nothing.
        fcntl.flock(file, fcntl.LOCK_EX)
        try:
            yield
        finally:
            path.unlink(missing_ok=True)


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
