"""Files of text: their kind by name and content, plain texts, and what pandoc reads."""

import codecs
import io
import re
import shutil
import subprocess
import zipfile
import zlib
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path

from smarttouch.base.errors import PageError
from smarttouch.base.files import MOST_DOCUMENT_BYTES, decoded, open_file, read_bytes

INSTALL = "apt install pandoc"
MOST_BYTES, MOST_UNPACKED_BYTES = 50_000_000, 500_000_000
"""Largest file, and largest content of a packed one."""
_TIMEOUT_S, _MEMORY = 120.0, "1500M"
_FILTER = Path(__file__).with_name("pandoc_text.lua")
_BEGINNING_BYTES = 4096
_NO_TEXT = bytes({*range(0x20), 0x7F} - {*b"\t\n\f\r\x1b"})
_BRF = frozenset([".brf", ".brl", ".ueb", ".bfm"])
_BY_NAME = {".md": "commonmark_x", ".markdown": "commonmark_x"} | dict.fromkeys(
    [".html", ".htm", ".xhtml"], "html"
)
_HTML = rb"\s*(<\?xml[^>]*>\s*)?(<!--.*?-->\s*)*<(!doctype\s+html|html)\b"
_FOREIGN = {
    "an RTF document": rb"\{\\rtf",
    "a PEF file": rb".*<pef\b",
    "an XML document, as drawings in SVG are": rb"\s*<(?:\?xml|svg\b|!--|!doctype svg)(?!.*<html)",
    "an e-mail": rb"(?:From [^\n]*\n)?(?:[\w-]+:[^\n]*\n(?:[ \t][^\n]*\n)*)*?"
    rb"(?:received|return-path|mime-version|message-id): ",
    "a PostScript file": rb"%!PS",
    "a LaTeX source": rb"\s*(?:%[^\n]*\n\s*)*\\(?:documentclass|documentstyle|begin\{)",
    "a contact or calendar": rb"BEGIN:V(?:CARD|CALENDAR)",
    "a notebook (Jupyter)": rb"\s*\{.*\"(?:nbformat|cells)\"\s*:",
    "an old or locked Office document, or a mail of Outlook": rb"\xd0\xcf\x11\xe0",
}
"""Kinds that are not read, and how they begin."""
_ODF = "mimetypeapplication/vnd.oasis.opendocument."
_IN_ZIP = {
    "word/": "docx", "mimetypeapplication/epub+zip": "epub", f"{_ODF}text": "odt",
    "ppt/": "a presentation", f"{_ODF}presentation": "a presentation",
    "xl/": "a spreadsheet", f"{_ODF}spreadsheet": "a spreadsheet", f"{_ODF}graphics": "a drawing",
    "Documents/1/": "an XPS document", "Index/": "a document of Pages, Numbers or Keynote",
}  # fmt: skip
"""Beginnings of the names of members of packed documents, and what their mimetype says."""
_FORMULAS = dict.fromkeys(["html", "epub"], "+tex_math_dollars+tex_math_single_backslash")
"""Extensions of pandoc by which TeX in a text is a formula."""
_TEX = re.compile(r"\\\((.{,500}?[\\^_].{,500}?)\\\)|\\\[(.{,500}?[\\^_].{,500}?)\\\]", re.DOTALL)
"""Formulas in Markdown that pandoc knows between dollars only."""
_EMBEDDED = re.compile(
    rb"<(?:iframe|video|audio|canvas|object|embed|wps:txbx|w:object|c:chart|dgm:relIds)\b|"
    rb"<draw:frame\b[^>]*>\s*<draw:object\b.*?</draw:frame>",
    re.DOTALL | re.IGNORECASE,
)
"""Elements of HTML, DOCX and ODT that pandoc drops without a word."""
_CONTENT = re.compile(r"word/document\.xml|content\.xml")
_HEADS = re.compile(r"word/(?:header|footer)\d*\.xml|styles\.xml")
_HEAD_TEXT = rb"<w:t\b|<style:(?:header|footer)\b[^>]*>(?:\s*<[^>]*>)*[^<\s]"
"""Members of DOCX and ODT with the text and with the heads of pages, and text in these."""


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
    if _format_of(path) is not None:
        return FileKind.STRUCTURED
    is_text = data.translate(None, _NO_TEXT) == data and b"%PDF-" not in data
    return FileKind.TEXT if is_text or suffix == ".txt" or _utf16(data) else FileKind.PAGES


def read_plain_text(path: Path) -> str:
    """Return a text file in UTF-8 or UTF-16, with newlines only, and no byte-order mark."""
    data = read_bytes(path, PageError, MOST_BYTES)
    if encoding := _utf16(data):
        data = data.decode(encoding, "replace").encode()
    text = decoded(data, path, PageError)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_document_text(path: Path, note: Callable[[str], None]) -> str:
    """Return the text of DOCX, EPUB, HTML, Markdown or ODT: a line for each paragraph, list item
    and row of a table.

    Cells of a row are separated by semicolons, and an empty one is a hyphen. ``note`` gets a
    sentence for each kind of content that is left out. Nothing else is opened; no script is run.
    """
    kind = str(_format_of(path))
    program = shutil.which("pandoc")
    if program is None:
        raise PageError(f"{path}: this kind of document needs pandoc: {INSTALL}")
    data = read_bytes(path, PageError, MOST_BYTES)
    try:
        data, embedded, has_heads = _prepared(path, kind, data)
        done = subprocess.run(
            [program, "+RTS", f"-M{_MEMORY}", "-RTS", "--sandbox",
             "-f", kind + _FORMULAS.get(kind, ""), "-t", "plain",
             "--wrap=none", f"--lua-filter={_FILTER}"],
            input=data, capture_output=True, timeout=_TIMEOUT_S, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        message = f"{path} was not read within {_TIMEOUT_S:g} s: give a smaller document"
        raise PageError(message) from None
    except (OSError, RuntimeError, KeyError, zipfile.BadZipFile, zlib.error) as error:
        raise PageError(f"{path} is damaged or locked ({error}): save it again") from None
    if done.returncode:
        reason = done.stderr.decode("utf-8", "replace").split("\n")[0] or "pandoc failed"
        raise PageError(f"{path} cannot be read, it may be locked: {reason}")
    text, _, notes = done.stdout.decode("utf-8").rpartition("\f")
    for words in filter(None, notes.splitlines()):
        note(words)
    if has_heads:
        note("headers and footers of its pages are left out")
    if embedded:
        note(f"embedded objects (formulas, charts, text boxes, frames) are left out: {embedded}")
    lines = [re.sub(r"[ \t\f]+", " ", line).strip() for line in text.split("\n")]
    return "\n".join(filter(None, lines))


def _format_of(path: Path) -> str | None:
    """Return pandoc's name of a document's format, by its content where that shows it; None if
    pandoc does not read it. Raise where nothing here reads it."""
    data, suffix = _beginning(path).removeprefix(codecs.BOM_UTF8), path.suffix.lower()
    if data.startswith(b"PK\x03\x04"):
        return _format_of_zip(path)
    if re.match(_HTML, data, re.IGNORECASE | re.DOTALL):
        return "html"
    for kind, beginning in _FOREIGN.items():
        if suffix != ".txt" and re.match(beginning, data, re.IGNORECASE | re.DOTALL):
            raise _not_read(path, kind)
    return None if b"\x00" in data else _BY_NAME.get(suffix)


def _format_of_zip(path: Path) -> str:
    """Return the format of a packed document; raise if it is another one."""
    try:
        with zipfile.ZipFile(path) as packed:
            names = packed.namelist()
            if "mimetype" in names:
                names.append("mimetype" + packed.read("mimetype").decode("ascii", "replace"))
    except (OSError, RuntimeError, zipfile.BadZipFile) as error:
        raise PageError(f"{path} is damaged or locked ({error}): save it again") from None
    for beginning, kind in _IN_ZIP.items():
        if any(name.startswith(beginning) for name in names):
            if " " in kind:
                raise _not_read(path, kind)
            return kind
    raise _not_read(path, "a packed file (ZIP)")


def _not_read(path: Path, kind: str) -> PageError:
    remedy = "convert it to .brf" if "PEF" in kind else "save it as PDF, DOCX or plain text"
    return PageError(f"{path} is {kind}, which is not read: {remedy}")


def _prepared(path: Path, kind: str, data: bytes) -> tuple[bytes, int, bool]:
    """Return a document as pandoc reads it best, the number of its embedded objects, and whether it
    has headers or footers with text.

    Raises if it is not in UTF-8, or would fill the memory when unpacked.
    """
    if not data.startswith(b"PK"):
        text = decoded(data, path, PageError)
        if kind not in _FORMULAS:
            return _TEX.sub(lambda match: f"${match[1] or match[2]}$", text).encode(), 0, False
        return text.encode(), len(_EMBEDDED.findall(data)), False
    count, has_heads, file = 0, False, io.BytesIO()
    mark = b"(embedded object)" if kind == "odt" else rb"\g<0>"
    with zipfile.ZipFile(io.BytesIO(data)) as packed, zipfile.ZipFile(file, "w") as copy:
        size = sum(member.file_size for member in packed.infolist())
        if size > MOST_UNPACKED_BYTES:
            raise PageError(
                f"{path} would unpack to {size // 10**6} MB, above the limit of "
                f"{MOST_UNPACKED_BYTES // 10**6}: give a smaller document"
            )
        for member in packed.infolist():
            content, name = packed.read(member), member.filename
            if _CONTENT.fullmatch(name):
                content, count = _EMBEDDED.subn(mark, content)
                # pandoc drops the heads of an ODT's tables.
                content = re.sub(rb"</?table:table-header-rows[^>]*>", b"", content)
            has_heads |= bool(_HEADS.fullmatch(name) and re.search(_HEAD_TEXT, content))
            copy.writestr(member, content)
    return file.getvalue(), count, has_heads


def _utf16(data: bytes) -> str | None:
    """Return the encoding of a text in UTF-16, with a mark or mostly of Latin letters, or None."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    data = data[:_BEGINNING_BYTES]
    zeros = [data[side::2].count(0) for side in (0, 1)]
    if 3 * max(zeros) > len(data) > 0 and min(zeros) == 0:
        return "utf-16-le" if zeros[1] else "utf-16-be"
    return None


def _beginning(path: Path) -> bytes:
    with open_file(path, PageError, MOST_DOCUMENT_BYTES) as file:
        return file.read(_BEGINNING_BYTES)
