"""Text files: detection of their kind, plain text, and documents read by pandoc."""

import codecs
import io
import re
import shutil
import subprocess
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path

from smarttouch.base.errors import PageError
from smarttouch.base.files import MOST_DOCUMENT_BYTES, decoded, open_file, read_bytes

INSTALL = "apt install pandoc"
MOST_BYTES, MOST_UNPACKED_BYTES = 50_000_000, 500_000_000
"""Largest file, and largest unpacked content."""
_TIMEOUT_S, _MEMORY = 120.0, "1500M"
_FILTER = Path(__file__).with_name("pandoc_text.lua")
_BEGINNING_BYTES = 4096
_UTF16 = re.compile(rb"\xff\xfe|\xfe\xff|(?:[\t-~]\0){4}|(?:\0[\t-~]){4}")  # or Latin letters
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
"""Unsupported kinds, by their first bytes."""
_ODF = "mimetypeapplication/vnd.oasis.opendocument."
_IN_ZIP = {
    "word/": "docx", "mimetypeapplication/epub+zip": f"epub{_TEX}", f"{_ODF}text": "odt",
    "ppt/": "a presentation", f"{_ODF}presentation": "a presentation",
    "xl/": "a spreadsheet", f"{_ODF}spreadsheet": "a spreadsheet", f"{_ODF}graphics": "a drawing",
    "Documents/1/": "an XPS document", "Index/": "a document of Pages, Numbers or Keynote",
}  # fmt: skip
"""Unsupported packed documents, by the names of members or by mimetype."""
_EMBEDDED = re.compile(
    rb"<(?:iframe|video|audio|canvas|object|embed|wps:txbx|w:object|c:chart|dgm:relIds)\b|"
    rb"<draw:frame\b[^>]*>\s*<draw:object\b.*?</draw:frame>",
    re.DOTALL | re.IGNORECASE,
)
"""Elements of HTML, DOCX and ODT that pandoc silently drops."""
_HEADS = re.compile(
    rb"<w:(?:hdr|ftr)\b.*?<w:t\b|<style:(?:header|footer)\b[^>]*>(?:\s*<[^>]*>)*[^<\s]", re.DOTALL
)
"""Page headers and footers with text in DOCX and ODT."""


class FileKind(StrEnum):
    """Kind of a file: plain text, Braille, document for pandoc, or image or PDF."""

    TEXT = "text"
    BRF = "brf"
    STRUCTURED = "structured"
    PAGES = "pages"


def file_kind(path: Path) -> FileKind:
    """Return the kind of a file, by its first bytes. Braille, .txt, .md and incomplete HTML are
    identified by name. Raises PageError for unsupported kinds."""
    suffix, data = path.suffix.lower(), _beginning(path)
    if not data:
        raise PageError(f"{path} is empty: give another file")
    if suffix in _BRF:
        return FileKind.BRF
    if _format_of(path) is not None:
        return FileKind.STRUCTURED
    is_text = data.translate(None, _NO_TEXT) == data and b"%PDF-" not in data
    is_text |= suffix == ".txt" or _UTF16.match(data) is not None
    return FileKind.TEXT if is_text else FileKind.PAGES


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
    kind, program = str(_format_of(path)), shutil.which("pandoc")
    if program is None:
        raise PageError(f"{path}: this kind of document needs pandoc: {INSTALL}")
    data, embedded, heads = _prepared(path, kind)
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
        raise PageError(f"{path} cannot be read, it may be locked: {reason}")
    text, _, notes = done.stdout.decode("utf-8").rpartition("\f")
    for words in filter(None, notes.splitlines()):
        note(words)
    if heads:
        note("headers and footers of its pages are left out")
    if embedded:
        note(f"embedded objects (formulas, charts, text boxes, frames) are left out: {embedded}")
    return "\n".join(filter(None, (" ".join(line.split()) for line in text.split("\n"))))


def _format_of(path: Path) -> str | None:
    """Return pandoc's name of a document's format, by content if possible; None if pandoc cannot
    read it. Raises PageError for unsupported kinds."""
    data, suffix = _beginning(path).removeprefix(codecs.BOM_UTF8), path.suffix.lower()
    if data.startswith(b"PK\x03\x04"):
        with _opened(path) as packed:
            names = packed.namelist()
            if "mimetype" in names:
                names.append("mimetype" + packed.read("mimetype").decode("ascii", "replace"))
        kinds = [kind for start, kind in _IN_ZIP.items() if any(n.startswith(start) for n in names)]
        kind = [*kinds, "a packed file (ZIP)"][0]
    elif re.match(_HTML, data, re.IGNORECASE | re.DOTALL):
        kind = _BY_NAME[".html"]
    else:
        kinds = [
            kind for kind, start in _FOREIGN.items()
            if suffix != ".txt" and re.match(start, data, re.IGNORECASE | re.DOTALL)
        ]  # fmt: skip
        kind = [*kinds, "" if b"\x00" in data else _BY_NAME.get(suffix, "")][0]
    if " " in kind:
        remedy = "save it as PDF, DOCX, plain text or .brf"
        raise PageError(f"{path} is {kind}, which is not read: {remedy}")
    return kind or None


@contextmanager
def _opened(path: Path) -> Iterator[zipfile.ZipFile]:
    """Open a packed document; errors by damage, also within the block, become PageErrors."""
    try:
        with zipfile.ZipFile(path) as packed:
            yield packed
    except (OSError, RuntimeError, KeyError, zipfile.BadZipFile, zlib.error) as error:
        raise PageError(f"{path} is damaged or locked ({error}): save it again") from None


def _prepared(path: Path, kind: str) -> tuple[bytes, int, int]:
    """Prepare a document for pandoc; return it with the numbers of embedded objects and of headers
    and footers with text.

    Raises PageError if it is not in UTF-8, or too large when unpacked.
    """
    data = read_bytes(path, PageError, MOST_BYTES)
    if not data.startswith(b"PK"):
        return decoded(data, path, PageError).encode(), len(_EMBEDDED.findall(data)), 0
    embedded, heads, file = 0, 0, io.BytesIO()
    mark = b"(embedded object)" if kind == "odt" else rb"\g<0>"
    with _opened(path) as packed, zipfile.ZipFile(file, "w") as copy:
        size = sum(member.file_size for member in packed.infolist())
        if size > MOST_UNPACKED_BYTES:
            limit = f"the limit of {MOST_UNPACKED_BYTES // 10**6}: give a smaller document"
            raise PageError(f"{path} would unpack to {size // 10**6} MB, above {limit}")
        for member in packed.infolist():
            content = packed.read(member)
            if member.filename in ("word/document.xml", "content.xml"):
                content, embedded = _EMBEDDED.subn(mark, content)
                # pandoc drops the header rows of tables in ODT.
                content = re.sub(rb"</?table:table-header-rows[^>]*>", b"", content)
            heads += len(_HEADS.findall(content))
            copy.writestr(member, content)
    return file.getvalue(), embedded, heads


def _beginning(path: Path) -> bytes:
    with open_file(path, PageError, MOST_DOCUMENT_BYTES) as file:
        return file.read(_BEGINNING_BYTES)
