"""Files of cells and texts, read whole."""

import codecs
from enum import StrEnum
from pathlib import Path

from smarttouch.errors import BrailleError
from smarttouch.files import MOST_DOCUMENT_BYTES, decoded, open_file, read_bytes

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
    with open_file(path, BrailleError, MOST_DOCUMENT_BYTES) as file:
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


def read_plain_text(path: Path) -> str:
    """Return a text file in UTF-8, with newlines only, and no byte-order mark."""
    text = decoded(read_bytes(path, BrailleError, MOST_BYTES), path, BrailleError)
    return text.replace("\r\n", "\n").replace("\r", "\n")
