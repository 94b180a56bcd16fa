"""Passwords of PDFs: from a file, from standard input, or asked for at a terminal."""

import getpass
import sys
from pathlib import Path

from smarttouch.base.errors import PageError
from smarttouch.base.files import read_text
from smarttouch.pages.document import LockedError, open_document

_MOST_BYTES = 4096
_TRIES = 3


def password_of(path: Path, password_file: str | None = None) -> str | None:
    """Return the password of a document; None if it needs none.

    It is the first line of a file, or of standard input for ``-``; without one it is asked for
    where somebody sits at a terminal.
    """
    if password_file is not None:
        text = sys.stdin.readline() if password_file == "-" else read_text(
            Path(password_file), PageError, _MOST_BYTES
        )  # fmt: skip
        password = text.split("\n")[0].rstrip("\r")
        if not password:
            name = "standard input" if password_file == "-" else password_file
            raise PageError(f"{name} has no password in its first line: write it there")
        return password
    password = None
    for attempt in range(_TRIES + 1):
        try:
            open_document(path, password=password).close()
        except LockedError:
            if attempt == _TRIES or not sys.stdin.isatty():
                raise
            password = getpass.getpass(f"Password of {path.name}: ")
        else:
            break
    return password
