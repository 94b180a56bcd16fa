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
_BY_NAME = {
    ".md": "commonmark_x", ".markdown": "commonmark_x",
    ".html": "html", ".htm": "html", ".xhtml": "html",
}  # fmt: skip
_HTML = rb"\s*(<\?xml[^>]*>\s*)?(<!--.*?-->\s*)*<(!doctype\s+html|html)\b"
_HEADER = rb"(?:[\w-]+:[^\n]*\n(?:[ \t][^\n]*\n)*)*?"
_PDF, _DOCX = "save it as PDF", "save it as DOCX or PDF"
_REFUSED = {
    "an RTF document": (rb"\{\\rtf", _DOCX),
    "a drawing (SVG)": (rb"(?:<\?xml|<!--|<!doctype svg).*<svg\b|\s*<svg\b", _PDF),
    "a PEF file": (rb".*<pef\b", "convert it to .brf"),
    "an e-mail": (
        rb"(?:From [^\n]*\n)?" + _HEADER + rb"(?:received|return-path|mime-version|message-id): ",
        "print it to a PDF, or save its text",
    ),
    "a PostScript file": (rb"%!PS", "convert it to PDF"),
    "a DjVu document": (rb"AT&TFORM", _PDF),
    "an e-book of Mobipocket or Kindle": (rb".{60}BOOKMOBI", "convert it to EPUB"),
    "a LaTeX source": (
        rb"\s*(?:%[^\n]*\n\s*)*\\(?:documentclass|documentstyle|begin\{)", "typeset it to PDF"
    ),
    "a contact or calendar": (rb"BEGIN:V(?:CARD|CALENDAR)", "save its text"),
    "a notebook (Jupyter)": (rb"\s*\{.*\"(?:nbformat|cells)\"\s*:", "save it as HTML"),
    "an XML document": (rb"<\?xml(?!.*<html)", "save it as HTML, DOCX or PDF"),
    "a sound": (rb"ID3|OggS|fLaC|RIFF.{4}WAVE|\xff[\xf2\xf3\xfb]|MThd", "give a text or a page"),
    "a video": (
        rb"RIFF.{4}AVI |\x1aE\xdf\xa3|.{4}ftyp(?!hei|mif1|msf1|avif)", "give one of its pictures"
    ),
    "a photograph in HEIC": (rb".{4}ftyp(?:hei|mif1|msf1)", "save it as JPEG"),
    "a packed file": (rb"7z\xbc\xaf|Rar!|\x1f\x8b|BZh|\xfd7zXZ|\x28\xb5\x2f\xfd", "unpack it"),
    "a program or its data": (
        rb"MZ[^\n]{0,64}\x00|\x7fELF|SQLite format 3", "give a text or a page"
    ),
    "an old Office document, or a mail of Outlook": (rb"\xd0\xcf\x11\xe0", _DOCX),
}  # fmt: skip
"""Kinds that are not read: how they begin, and what to do."""
_REFUSED_NAMES = {".eml": "an e-mail", ".svg": "a drawing (SVG)", ".pef": "a PEF file"}
_IN_ZIP = (
    ("ppt/", "a presentation"), ("xl/", "a spreadsheet"), ("Documents/1/", "an XPS document"),
    ("Index/", "a document of Pages, Numbers or Keynote"), ("word/", "docx"),
)  # fmt: skip
"""Beginnings of the names of members of packed documents."""
_ODF = "application/vnd.oasis.opendocument."
_MIMETYPES = {
    "application/epub+zip": "epub", f"{_ODF}text": "odt", f"{_ODF}spreadsheet": "a spreadsheet",
    f"{_ODF}presentation": "a presentation", f"{_ODF}graphics": "a drawing",
}  # fmt: skip
_LOCKED_OFFICE = "EncryptedPackage".encode("utf-16-le")
_FONTS = rb"2008/embedding|pdf/enc#RC"  # how an EPUB hides its fonts


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
    suffix, data = path.suffix.lower(), _beginning(path)
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


def format_of(path: Path) -> str | None:
    """Return pandoc's name of a document's format, by its content where that shows it; None if
    pandoc does not read it. Raise where nothing here reads it."""
    data, suffix = _beginning(path).removeprefix(codecs.BOM_UTF8), path.suffix.lower()
    if data.startswith(b"PK\x03\x04"):
        return _format_of_zip(path)
    if re.match(_HTML, data, re.IGNORECASE | re.DOTALL):
        return "html"
    kinds = [_REFUSED_NAMES[suffix]] if suffix in _REFUSED_NAMES else []
    if suffix != ".txt":
        kinds = [
            kind for kind, (beginning, _) in _REFUSED.items()
            if re.match(beginning, data, re.IGNORECASE | re.DOTALL)
        ] + kinds  # fmt: skip
    if kinds and kinds[0].startswith("an old Office") and _LOCKED_OFFICE in read_bytes(
        path, PageError, MOST_DOCUMENT_BYTES
    ):  # fmt: skip
        raise _locked(path)
    if kinds:
        raise PageError(f"{path} is {kinds[0]}, which is not read: {_REFUSED[kinds[0]][1]}")
    return None if b"\x00" in data else _BY_NAME.get(suffix)


def _format_of_zip(path: Path) -> str:
    """Return the format of a packed document; raise if it is locked or another one."""
    try:
        with zipfile.ZipFile(path) as packed:
            names = packed.namelist()
            is_locked = any(member.flag_bits & 1 for member in packed.infolist())
            mimetype, rights, manifest = (
                packed.read(name) if name in names and not is_locked else b""
                for name in ("mimetype", "META-INF/encryption.xml", "META-INF/manifest.xml")
            )
    except (OSError, RuntimeError, zipfile.BadZipFile) as error:
        raise PageError(f"{path} is damaged ({error}): get it again") from None
    if is_locked or b":encryption-data" in rights + manifest:
        raise _locked(path)
    methods = re.findall(rb'Algorithm="([^"]*)"', rights)
    if "META-INF/rights.xml" in names or not all(re.search(_FONTS, each) for each in methods):
        raise PageError(
            f"{path} is protected against copying (DRM), and cannot be read: get it without"
        )
    kind = _MIMETYPES.get(mimetype.decode("ascii", "replace").strip(), "")
    for beginning, name in _IN_ZIP:
        if not kind and any(each.startswith(beginning) for each in names):
            kind = name
    if not kind:
        raise PageError(f"{path} is a packed file (ZIP), which is not read: unpack it")
    if " " in kind:
        raise PageError(f"{path} is {kind}, which is not read: save it as PDF")
    return kind


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


def _locked(path: Path) -> PageError:
    return PageError(f"{path} is locked by a password: save it without one, or as PDF")


def _beginning(path: Path) -> bytes:
    with open_file(path, PageError, MOST_DOCUMENT_BYTES) as file:
        return file.read(_BEGINNING_BYTES)
