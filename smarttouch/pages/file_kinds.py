"""What files hold: texts, documents, pages, cells of Braille, or what is not read, by name."""

import codecs
import re
import zipfile
from enum import StrEnum
from pathlib import Path

from smarttouch.base.errors import PageError
from smarttouch.base.files import MOST_DOCUMENT_BYTES, decoded, open_file, read_bytes

_MOST_TEXT_BYTES = 50_000_000
_BEGINNING_BYTES = 4096
_NO_TEXT = bytes({*range(0x20), 0x7F} - {*b"\t\n\f\r\x1b"})
_BRF = frozenset([".brf", ".brl", ".ueb", ".bfm"])
_MARKDOWN = "commonmark_x"
_BY_NAME = {
    ".md": _MARKDOWN, ".markdown": _MARKDOWN, ".html": "html", ".htm": "html", ".xhtml": "html",
}  # fmt: skip
_HTML = re.compile(
    rb"\s*(<\?xml[^>]*>\s*)?(<!--.*?-->\s*)*<(!doctype\s+html|html)\b", re.IGNORECASE | re.DOTALL
)
_PDF = "save it as PDF"
_TO_DOCX = "save it as DOCX or PDF"
_HEADER = rb"(?:[\w-]+:[^\n]*\n(?:[ \t][^\n]*\n)*)*?"
_REFUSED = (
    (rb"\{\\rtf", "an RTF document", _TO_DOCX),
    (rb"(?:<\?xml|<!--|<!doctype svg).*<svg\b|\s*<svg\b", "a drawing (SVG)", _PDF),
    (rb".*<pef\b", "a PEF file", "convert it to .brf"),
    (rb"(?:From [^\n]*\n)?" + _HEADER + rb"(?:received|return-path|mime-version|message-id): ",
     "an e-mail", "print it to a PDF, or save its text"),
    (rb"%!PS", "a PostScript file", "convert it to PDF"),
    (rb"AT&TFORM", "a DjVu document", _PDF),
    (rb".{60}BOOKMOBI", "an e-book of Mobipocket or Kindle", "convert it to EPUB"),
    (rb"\s*(?:%[^\n]*\n\s*)*\\(?:documentclass|documentstyle|begin\{)", "a LaTeX source",
     "typeset it to PDF"),
    (rb"BEGIN:V(?:CARD|CALENDAR)", "a contact or calendar", "save its text"),
    (rb"\s*\{.*\"(?:nbformat|cells)\"\s*:", "a notebook (Jupyter)", "save it as HTML"),
    (rb"<\?xml(?!.*<html)", "an XML document", "save it as HTML, DOCX or PDF"),
    (rb"ID3|OggS|fLaC|RIFF.{4}WAVE|\xff[\xf2\xf3\xfb]|MThd", "a sound", "give a text or a page"),
    (rb"RIFF.{4}AVI |\x1aE\xdf\xa3|.{4}ftyp(?!hei|mif1|msf1|avif)", "a video",
     "give one of its pictures"),
    (rb".{4}ftyp(?:hei|mif1|msf1)", "a photograph in HEIC", "save it as JPEG"),
    (rb"7z\xbc\xaf|Rar!|\x1f\x8b|BZh|\xfd7zXZ|\x28\xb5\x2f\xfd", "a packed file", "unpack it"),
    (rb"MZ[^\n]{0,64}\x00|\x7fELF|SQLite format 3", "a program or its data",
     "give a text or a page"),
)  # fmt: skip
"""Beginnings of what is not read, its name, and what to do."""
_REFUSED_NAMES = {".eml": _REFUSED[3], ".svg": _REFUSED[1], ".pef": _REFUSED[2]}
_ZIPPED = (
    (r"\[Content_Types\]\.xml|word/.*", "docx"), (r"ppt/.*", "a presentation"),
    (r"xl/.*", "a spreadsheet"), (r".*\.fpage", "an XPS document"),
    (r"Index/.*\.iwa|Index\.zip", "a document of Pages, Numbers or Keynote"),
)  # fmt: skip
_MIMETYPES = {
    "application/epub+zip": "epub", "application/vnd.oasis.opendocument.text": "odt",
    "application/vnd.oasis.opendocument.spreadsheet": "a spreadsheet",
    "application/vnd.oasis.opendocument.presentation": "a presentation",
    "application/vnd.oasis.opendocument.graphics": "a drawing",
}  # fmt: skip
_FONTS = re.compile(rb"2008/embedding|pdf/enc#RC")  # how an EPUB hides its fonts
_OLD_OFFICE = b"\xd0\xcf\x11\xe0"


class FileKind(StrEnum):
    """Kind of material that a file holds."""

    TEXT = "text"
    BRF = "brf"
    STRUCTURED = "structured"
    """HTML, Markdown, EPUB, DOCX or ODT."""
    PAGES = "pages"
    """Images or a PDF."""


def file_kind(path: Path) -> FileKind:
    """Return the kind of a file by its first bytes; only Braille, .txt and .md, and HTML without
    its beginning, are known by their names. Raise where nothing here reads it."""
    suffix = path.suffix.lower()
    data = _beginning(path)
    if not data:
        raise PageError(f"{path} is empty: give another file")
    if suffix in _BRF:
        return FileKind.BRF
    if format_of(path) is not None:
        return FileKind.STRUCTURED
    if suffix == ".txt" or _utf16(data):
        return FileKind.TEXT
    if b"%PDF-" in data or data.translate(None, _NO_TEXT) != data:
        return FileKind.PAGES
    return FileKind.TEXT


def read_plain_text(path: Path) -> str:
    """Return a text file in UTF-8 or UTF-16, with newlines only, and no byte-order mark."""
    data = read_bytes(path, PageError, _MOST_TEXT_BYTES)
    if encoding := _utf16(data):
        data = data.decode(encoding, "replace").encode()
    text = decoded(data, path, PageError)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _utf16(data: bytes) -> str | None:
    """Return the encoding of a text in UTF-16, with a mark or mostly of Latin letters, or None."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    data = data[:_BEGINNING_BYTES]
    zeros = [data[side::2].count(0) for side in (0, 1)]
    if 3 * max(zeros) > len(data) > 0 and min(zeros) == 0:
        return "utf-16-le" if zeros[1] else "utf-16-be"
    return None


def format_of(path: Path) -> str | None:
    """Return pandoc's name of a document's format, by its content where that shows it; None if
    pandoc does not read it. Raise where nothing here reads it."""
    data = _beginning(path).removeprefix(codecs.BOM_UTF8)
    if data.startswith(b"PK\x03\x04"):
        return _format_of_zip(path)
    if data.startswith(_OLD_OFFICE):
        raise _refused_office(path)
    if _HTML.match(data):
        return "html"
    suffix = path.suffix.lower()
    for pattern, kind, remedy in _REFUSED if suffix != ".txt" else ():
        if re.match(pattern, data, re.IGNORECASE | re.DOTALL):
            raise _refused(path, kind, remedy)
    if suffix in _REFUSED_NAMES:
        raise _refused(path, *_REFUSED_NAMES[suffix][1:])
    return None if b"\x00" in data else _BY_NAME.get(suffix)


def _format_of_zip(path: Path) -> str | None:
    """Return the format of a packed document; raise if it is locked or another one."""
    try:
        with zipfile.ZipFile(path) as packed:
            names = packed.namelist()
            locked = any(member.flag_bits & 1 for member in packed.infolist())
            mimetype = packed.read("mimetype") if "mimetype" in names and not locked else b""
            keys = [
                b"" if locked else packed.read(name) for name in
                ("META-INF/encryption.xml", "META-INF/manifest.xml") if name in names
            ]  # fmt: skip
    except (OSError, RuntimeError, zipfile.BadZipFile) as error:
        raise PageError(f"{path} is damaged ({error}): get it again") from None
    if locked or any(b":encryption-data" in key for key in keys):
        raise _locked(path)
    methods = re.findall(rb'Algorithm="([^"]*)"', b"".join(keys[:1]))
    if "META-INF/rights.xml" in names or any(not _FONTS.search(method) for method in methods):
        raise PageError(
            f"{path} is protected against copying (DRM), and cannot be read: get it without"
        )
    kind = _MIMETYPES.get(mimetype.decode("ascii", "replace").strip())
    for pattern, name in _ZIPPED[1:] + _ZIPPED[:1]:
        if kind is None and any(re.fullmatch(pattern, each) for each in names):
            kind = name
    if kind is None or " " in kind:
        raise _refused(path, kind or "a packed file (ZIP)", _PDF if kind else "unpack it")
    return kind


def _refused_office(path: Path) -> PageError:
    data = read_bytes(path, PageError, MOST_DOCUMENT_BYTES)
    if "EncryptedPackage".encode("utf-16-le") in data:
        return _locked(path)
    return _refused(path, "an old Office document, or a mail of Outlook", _TO_DOCX)


def _refused(path: Path, kind: str, remedy: str) -> PageError:
    return PageError(f"{path} is {kind}, which is not read: {remedy}")


def _locked(path: Path) -> PageError:
    return PageError(f"{path} is locked by a password: save it without one, or as PDF")


def _beginning(path: Path) -> bytes:
    with open_file(path, PageError, MOST_DOCUMENT_BYTES) as file:
        return file.read(_BEGINNING_BYTES)
