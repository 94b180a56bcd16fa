"""Text files: detection of their kind, plain text, and documents read by pandoc."""

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
"""Largest size of a file, and largest unpacked size of a ZIP file."""
_TIMEOUT_S, _MEMORY = 120.0, "1500M"
_FILTER = Path(__file__).with_name("pandoc_text.lua")
_BEGINNING_BYTES, _END_BYTES = 4096, 300_000
_UTF16 = re.compile(rb"\xff\xfe|\xfe\xff|(?:[\t-~]\0){4}|(?:\0[\t-~]){4}")
"""Start of a file in UTF-16: a byte-order mark, or four ASCII characters."""
_NO_TEXT = bytes({*range(0x20), 0x7F} - {*b"\t\n\f\r\x1b"})
_BRF = frozenset([".brf", ".brl", ".ueb", ".bfm"])
_TEX = "+tex_math_dollars+tex_math_single_backslash"  # TeX formulas in Markdown
_MARKDOWN = (
    "markdown-markdown_in_html_blocks-raw_tex-task_lists-example_lists"
    f"+lists_without_preceding_blankline{_TEX}"
)
_BY_NAME = dict.fromkeys([".md", ".markdown"], _MARKDOWN) | dict.fromkeys(
    [".html", ".htm", ".xhtml"], f"html{_TEX}"
)
_ODF = rb"PK.{28}mimetypeapplication/vnd\.oasis\.opendocument\."
_LISTED = rb"PK.*PK\x01\x02.{42}"  # matches a ZIP file up to a file name in its directory
_KINDS = {
    rb"\s*(<\?xml[^>]*>\s*)?(<!--.*?-->\s*)*<(!doctype\s+html|html)\b": f"html{_TEX}",
    _LISTED + rb"word/": "docx",
    rb"PK.{28}mimetypeapplication/epub\+zip": f"epub{_TEX}",
    _ODF + rb"text": "odt",
    _LISTED + rb"ppt/|" + _ODF + rb"presentation": "a presentation",
    _LISTED + rb"xl/|" + _ODF + rb"spreadsheet": "a spreadsheet",
    rb"PK\x03\x04": "a packed file (a ZIP archive, or from a drawing program or Apple Pages)",
    rb"\{\\rtf": "an RTF document",
    rb".*<pef\b": "a PEF file",
    rb"\s*<(?:\?xml|svg\b|!--|!doctype svg)(?!.*<html)": "an XML document (such as an SVG drawing)",
    rb"(?:From [^\n]*\n)?(?:[\w-]+:[^\n]*\n(?:[ \t][^\n]*\n)*)*?"
    rb"(?:received|return-path|mime-version|message-id): ": "an e-mail",
    rb"%!PS": "a PostScript file",
    rb"\s*(?:%[^\n]*\n\s*)*\\(?:documentclass|documentstyle|begin\{)": "a LaTeX source",
    rb"BEGIN:V(?:CARD|CALENDAR)": "a contact or calendar",
    rb"\s*\{.*\"(?:nbformat|cells)\"\s*:": "a notebook (Jupyter)",
    rb"\xd0\xcf\x11\xe0": "an old or locked Office document, or an Outlook mail",
}
"""Formats by byte patterns. A name without spaces is pandoc's. Files of other formats are rejected,
except a .txt file that does not start with PK."""
_OBJECT = re.compile(rb"<draw:frame\b[^>]*>\s*<draw:object\b.*?</draw:frame>", re.DOTALL)
_DROPPED = {
    "headers and footers of its pages are left out": rb"<w:(?:hdr|ftr)\b.*?<w:t\b|"
    rb"<style:(?:header|footer)\b[^>]*>(?:\s*<[^>]*>)*[^<\s]",
    "embedded objects (formulas, charts, text boxes, frames) are left out": _OBJECT.pattern
    + rb"|<(?:iframe|video|audio|canvas|object|embed|wps:txbx|w:object|c:chart|dgm:relIds)\b",
}
"""Elements of HTML, DOCX and ODT that pandoc silently drops."""


class FileKind(StrEnum):
    """Kind of a file: plain text, Braille (BRF), document for pandoc, or pages (image or PDF)."""

    TEXT = "text"
    BRF = "brf"
    STRUCTURED = "structured"
    PAGES = "pages"


def file_kind(path: Path) -> FileKind:
    """Return the kind of a file from its first bytes. Braille, .txt, .md and incomplete HTML are
    recognized by the file's name. Raises PageError for unsupported kinds."""
    return _kind_and_format(path)[0]


def read_plain_text(path: Path) -> str:
    """Read a text file in UTF-8 or UTF-16, with normalized newlines and without byte-order mark."""
    data = read_bytes(path, PageError, MOST_BYTES)
    if _UTF16.match(data):
        encoding = "utf-16-be" if data.startswith(b"\0") else "utf-16"
        data = data.decode(encoding, "replace").encode()
    text = decoded(data, path, PageError)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_document_text(path: Path, note: Callable[[str], None]) -> str:
    """Return the text of DOCX, EPUB, HTML, Markdown or ODT.

    Each paragraph, list item and table row is a line. Cells of a row are separated by semicolons;
    an empty cell is a hyphen. ``note`` receives a sentence for each kind of omitted content. No
    other files are opened, and no scripts are run.
    """
    kind, program = _kind_and_format(path)[1], shutil.which("pandoc")
    if program is None:
        raise PageError(f"{path}: this kind of document needs pandoc: {INSTALL}")
    data = read_bytes(path, PageError, MOST_BYTES)
    if data.startswith(b"PK"):
        data, contents = _repacked(path)
    else:
        data = decoded(data, path, PageError).encode()
        contents = [data]
    command = [program, "+RTS", f"-M{_MEMORY}", "-RTS", "--sandbox", "-f", kind, "-t", "plain",
               "--wrap=none", f"--lua-filter={_FILTER}"]  # fmt: skip
    try:
        done = subprocess.run(
            command, input=data, capture_output=True, timeout=_TIMEOUT_S, check=False
        )
    except subprocess.TimeoutExpired:
        message = f"{path} was not read within {_TIMEOUT_S:g} s: give a smaller document"
        raise PageError(message) from None
    if done.returncode:
        reason = done.stderr.decode("utf-8", "replace").split("\n")[0] or "pandoc failed"
        raise PageError(f"pandoc cannot read {path}, which may be locked: {reason}")
    text, _, notes = done.stdout.decode("utf-8").rpartition("\f")
    for words in filter(None, notes.splitlines()):
        note(words)
    for words, element in _DROPPED.items():
        pattern = re.compile(element, re.DOTALL | re.IGNORECASE)
        if count := sum(len(pattern.findall(content)) for content in contents):
            note(f"{words}: {count}")
    return "\n".join(filter(None, (" ".join(line.split()) for line in text.split("\n"))))


def _kind_and_format(path: Path) -> tuple[FileKind, str]:
    """Return the kind of a file, and pandoc's name of its format if pandoc can read the file."""
    suffix = path.suffix.lower()
    with open_file(path, PageError, MOST_DOCUMENT_BYTES) as file:
        data = file.read(_BEGINNING_BYTES).removeprefix(codecs.BOM_UTF8)
        if data.startswith(b"PK\x03\x04"):
            file.seek(max(0, path.stat().st_size - _END_BYTES))
            data += file.read()
    if not data:
        raise PageError(f"{path} is empty: give another file")
    if suffix in _BRF:
        return FileKind.BRF, ""
    is_text = data.translate(None, _NO_TEXT) == data and b"%PDF-" not in data
    is_text |= suffix == ".txt" or _UTF16.match(data) is not None
    kind = "" if b"\0" in data else _BY_NAME.get(suffix, "")
    if not kind:
        flags = re.IGNORECASE | re.DOTALL
        kinds = (kind for start, kind in _KINDS.items() if re.match(start, data, flags))
        kind = next(kinds, "")
    if kind and " " not in kind:
        return FileKind.STRUCTURED, kind
    if not kind or (suffix == ".txt" and not data.startswith(b"PK")):
        return FileKind.TEXT if is_text else FileKind.PAGES, ""
    remedy = "save it as PDF, DOCX, plain text or .brf"
    raise PageError(f"{path} is {kind}, which cannot be read: {remedy}")


def _repacked(path: Path) -> tuple[bytes, list[bytes]]:
    """Copy a ZIP file, so that pandoc drops less text; return the copy and the old contents."""
    try:
        with zipfile.ZipFile(path) as packed:
            if sum(member.file_size for member in packed.infolist()) > MOST_UNPACKED_BYTES:
                limit = f"{MOST_UNPACKED_BYTES // 10**6} MB: give a smaller document"
                raise PageError(f"{path} would unpack to more than {limit}")
            contents = {member.filename: packed.read(member) for member in packed.infolist()}
    except (OSError, RuntimeError, KeyError, zipfile.BadZipFile, zlib.error) as error:
        raise PageError(f"{path} is damaged or locked ({error}): save it again") from None
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as copy:
        for name, content in contents.items():
            # In ODT files, pandoc drops embedded objects. It also drops the heading rows of tables.
            marked = (
                _OBJECT.sub(b"(embedded object)", content) if name == "content.xml" else content
            )
            copy.writestr(name, re.sub(rb"</?table:table-header-rows[^>]*>", b"", marked))
    return file.getvalue(), [*contents.values()]
