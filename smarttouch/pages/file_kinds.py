"""What files hold that can be read: texts, documents, pages, and cells of Braille."""

import codecs
from enum import StrEnum
from pathlib import Path

from smarttouch.base.errors import BrailleError
from smarttouch.base.files import MOST_DOCUMENT_BYTES, decoded, open_file, read_bytes
from smarttouch.pages.pandoc_text import format_of

_MOST_TEXT_BYTES = 50_000_000
_BEGINNING_BYTES = 4096
_NO_TEXT = bytes({*range(0x20), 0x7F} - {*b"\t\n\f\r\x1b"})


class FileKind(StrEnum):
    """Kind of material that a file holds."""

    TEXT = "text"
    BRF = "brf"
    STRUCTURED = "structured"
    """HTML, Markdown, EPUB, DOCX or ODT."""
    PAGES = "pages"
    """Images or a PDF, or nothing that can be read."""


def file_kind(path: Path) -> FileKind:
    """Return the kind of a file by its first bytes; only .brf, .txt and .md, and HTML without its
    beginning, are known by their names."""
    suffix = path.suffix.lower()
    with open_file(path, BrailleError, MOST_DOCUMENT_BYTES) as file:
        data = file.read(_BEGINNING_BYTES)
    if suffix == ".brf":
        return FileKind.BRF
    if b"<pef" in data or suffix == ".pef":
        raise BrailleError(f"{path} is a PEF file, which is not read: convert it to .brf")
    if suffix == ".txt":
        return FileKind.TEXT
    if format_of(path) is not None:
        return FileKind.STRUCTURED
    if b"%PDF-" in data or data.translate(None, _NO_TEXT) != data:
        return FileKind.PAGES
    try:
        # The last character may be cut.
        codecs.getincrementaldecoder("utf-8")().decode(data)
    except UnicodeDecodeError:
        return FileKind.PAGES
    return FileKind.TEXT


def read_plain_text(path: Path) -> str:
    """Return a text file in UTF-8, with newlines only, and no byte-order mark."""
    text = decoded(read_bytes(path, BrailleError, _MOST_TEXT_BYTES), path, BrailleError)
    return text.replace("\r\n", "\n").replace("\r", "\n")
