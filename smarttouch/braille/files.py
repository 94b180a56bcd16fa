"""Files of cells and texts, read whole; each fault is an error with one sentence."""

from pathlib import Path

from smarttouch import files
from smarttouch.errors import BrailleError

MOST_BYTES = 50_000_000
"""Largest file; a book has a few million cells."""


def read_bytes(path: Path) -> bytes:
    """Return the content of a file.

    Raises
    ------
    BrailleError
        If it cannot be read, or is far too large.
    """
    return files.read_bytes(path, BrailleError, MOST_BYTES)


def read_text(path: Path) -> str:
    """Return a text file in UTF-8, with newlines only, and no byte-order mark.

    Raises
    ------
    BrailleError
        If it cannot be read, or is not UTF-8.
    """
    text = files.read_text(path, BrailleError, MOST_BYTES)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file.

    Raises
    ------
    BrailleError
        If it cannot be written.
    """
    files.write_bytes(path, data, BrailleError)
