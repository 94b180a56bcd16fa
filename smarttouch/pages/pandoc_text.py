"""Text of DOCX, EPUB, HTML, Markdown and ODT documents, read by pandoc as plain paragraphs."""

import io
import re
import shutil
import subprocess
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

from smarttouch.base.errors import PageError
from smarttouch.base.files import decoded, open_file, read_bytes

INSTALL = "apt install pandoc"
MOST_BYTES, MOST_UNPACKED_BYTES = 50_000_000, 500_000_000
"""Largest file, and largest content of a packed one."""
_TIMEOUT_S = 120.0
_MEMORY = "1500M"
_BEGINNING_BYTES = 4096
_FILTER = Path(__file__).with_suffix(".lua")
_MARKDOWN = "commonmark_x"
_BY_NAME = {
    ".md": _MARKDOWN, ".markdown": _MARKDOWN, ".html": "html", ".htm": "html", ".xhtml": "html",
}  # fmt: skip
_PACKED = {b"mimetypeapplication/epub+zip": "epub",
           b"mimetypeapplication/vnd.oasis.opendocument.text": "odt"}  # fmt: skip
_HTML = re.compile(
    rb"(\xef\xbb\xbf)?\s*(<\?xml[^>]*>\s*)?(<!--.*?-->\s*)*<(!doctype\s+html|html)\b",
    re.IGNORECASE | re.DOTALL,
)
_REFUSED = {
    ".eml": "an e-mail", ".odp": "a presentation", ".ods": "a spreadsheet",
    ".pptx": "a presentation", ".rtf": "an RTF document", ".svg": "a drawing",
    ".xlsx": "a spreadsheet",
}  # fmt: skip
_EMBEDDED = {
    "docx": ("word/document.xml", rb"<wps:txbx\b|<c:chart\b|<dgm:relIds\b"),
    "html": ("", rb"(?i)<(?:iframe|video|audio|canvas|object|embed)\b"),
    "odt": ("content.xml", rb"<draw:frame\b[^>]*>\s*<draw:object\b.*?</draw:frame>"),
}
"""File within a document and elements in it that pandoc drops without a word."""


def format_of(path: Path) -> str | None:
    """Return pandoc's name of a document's format, by its content where that shows it; None if
    pandoc does not read it."""
    if kind := _REFUSED.get(path.suffix.lower()):
        raise PageError(f"{path} is {kind}, which is not read: save it as PDF")
    with open_file(path, PageError, MOST_UNPACKED_BYTES) as file:
        data = file.read(_BEGINNING_BYTES)
    if data.startswith(b"PK\x03\x04"):
        packed = next((name for mark, name in _PACKED.items() if mark in data[:120]), None)
        return packed or ("docx" if b"[Content_Types].xml" in data or b"word/" in data else None)
    if _HTML.match(data):
        return "html"
    return None if b"\x00" in data else _BY_NAME.get(path.suffix.lower())


def read_pandoc_text(path: Path, note: Callable[[str], None]) -> str:
    """Return a document's text, a line for each paragraph, list item and row of a table.

    Cells of a row are separated by semicolons, and an empty one is a hyphen. ``note`` gets a
    sentence for each kind of content that is left out. Nothing else is opened; no script is run.
    """
    kind = str(format_of(path))
    program = shutil.which("pandoc")
    if program is None:
        raise PageError(f"{path}: this kind of document needs pandoc: {INSTALL}")
    data = read_bytes(path, PageError, MOST_BYTES)
    try:
        data, embedded = _prepared(path, kind, data)
        done = subprocess.run(
            [program, "+RTS", f"-M{_MEMORY}", "-RTS", "--sandbox", "-f", kind, "-t", "plain",
             "--wrap=none", f"--lua-filter={_FILTER}"],
            input=data, capture_output=True, timeout=_TIMEOUT_S, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        message = f"{path} was not read within {_TIMEOUT_S:g} s: give a smaller document"
        raise PageError(message) from None
    except (OSError, RuntimeError, KeyError, zipfile.BadZipFile, zlib.error) as error:
        raise PageError(f"{path} is damaged: {error}") from None
    if done.returncode:
        lines = done.stderr.decode("utf-8", "replace").split("\n")
        raise PageError(f"{path} cannot be read: {lines[0] or 'pandoc failed'}")
    text, _, notes = done.stdout.decode("utf-8").rpartition("\f")
    for words in notes.split("\n"):
        if words.strip():
            note(words)
    if embedded:
        note(f"embedded objects (formulas, charts, text boxes, frames) are left out: {embedded}")
    lines = [re.sub(r"[ \t\f]+", " ", line).strip() for line in text.split("\n")]
    return "\n".join(filter(None, lines))


def _prepared(path: Path, kind: str, data: bytes) -> tuple[bytes, int]:
    """Return a document as pandoc reads it best, and the number of its embedded objects.

    Raises if it is not in UTF-8, or would fill the memory when unpacked.
    """
    name, pattern = _EMBEDDED.get(kind, ("", rb"(?!)"))
    embedded = re.compile(pattern, re.DOTALL)
    if not data.startswith(b"PK"):
        return decoded(data, path, PageError).encode(), len(embedded.findall(data))
    with zipfile.ZipFile(io.BytesIO(data)) as packed:
        size = sum(member.file_size for member in packed.infolist())
        if size > MOST_UNPACKED_BYTES:
            raise PageError(
                f"{path} would unpack to {size // 10**6} MB, above the limit of "
                f"{MOST_UNPACKED_BYTES // 10**6}: give a smaller document"
            )
        content = packed.read(name) if name else b""
        if kind != "odt":
            return data, len(embedded.findall(content))
        # pandoc drops the heads of an ODT's tables.
        content = re.sub(rb"</?table:table-header-rows[^>]*>", b"", content)
        content, count = embedded.subn(b"(embedded object)", content)
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w") as copy:
            for member in packed.infolist():
                copy.writestr(member, content if member.filename == name else packed.read(member))
    return file.getvalue(), count
