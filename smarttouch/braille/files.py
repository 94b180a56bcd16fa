"""Files of cells and texts, read whole."""

import codecs
from enum import StrEnum
from pathlib import Path

from smarttouch import files
from smarttouch.errors import BrailleError

MOST_BYTES = 50_000_000
"""Largest file; a book has a few million cells."""

_BEGINNING_BYTES = 4096
_NO_TEXT = bytes({*range(0x20), 0x7F} - {*b"\t\n\f\r\x1b"})


class Kind(StrEnum):
    """Kind of material that a file holds."""

    TEXT = "text"
    BRF = "brf"
    PEF = "pef"
    PAGES = "pages"
    """Images or a PDF, or nothing that can be read."""


def kind_of(path: Path) -> Kind:
    """Return the kind of a file by its first bytes; only .brf and .txt are known by their names."""
    suffix = path.suffix.lower()
    with files.open_file(path, BrailleError, files.MOST_DOCUMENT_BYTES) as file:
        data = file.read(_BEGINNING_BYTES)
    if suffix == ".brf":
        return Kind.BRF
    if b"<pef" in data or suffix == ".pef":
        return Kind.PEF
    if suffix == ".txt":
        return Kind.TEXT
    if b"%PDF-" in data or data.translate(None, _NO_TEXT) != data:
        return Kind.PAGES
    try:
        # The last character may be cut.
        codecs.getincrementaldecoder("utf-8")().decode(data)
    except UnicodeDecodeError:
        return Kind.PAGES
    return Kind.TEXT


def read_bytes(path: Path) -> bytes:
    """Return the content of a file.

    Raises
    ------
    BrailleError
        If it cannot be read, or is far too large.
    """
    return files.read_bytes(path, BrailleError, MOST_BYTES)


def read_text(path: Path) -> str:
    """Return a text file in UTF-8, with newlines only, and no byte-order mark."""
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
