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
from smarttouch.base.files import decoded, read_bytes
from smarttouch.pages.file_kinds import format_of

INSTALL = "apt install pandoc"
MOST_BYTES, MOST_UNPACKED_BYTES = 50_000_000, 500_000_000
"""Largest file, and largest content of a packed one."""
_TIMEOUT_S = 120.0
_MEMORY = "1500M"
_FILTER = Path(__file__).with_suffix(".lua")
_FORMULAS = dict.fromkeys(["html", "epub"], "+tex_math_dollars+tex_math_single_backslash")
"""Extensions of pandoc by which TeX in a text is a formula."""
_TEX = re.compile(r"\\\((.{,500}?[\\^_].{,500}?)\\\)|\\\[(.{,500}?[\\^_].{,500}?)\\\]", re.DOTALL)
"""Formulas in Markdown that pandoc knows between dollars only."""
_EMBEDDED = {
    "docx": ("word/document.xml", rb"<wps:txbx\b|<w:object\b|<c:chart\b|<dgm:relIds\b"),
    "html": ("", rb"(?i)<(?:iframe|video|audio|canvas|object|embed)\b"),
    "odt": ("content.xml", rb"<draw:frame\b[^>]*>\s*<draw:object\b.*?</draw:frame>"),
}
"""File within a document and elements in it that pandoc drops without a word."""
_HEADS = rb"<w:t\b|<style:(?:header|footer)\b[^>]*>(?:\s*<[^>]*>)*[^<\s]"
"""A header or footer with text, in DOCX and in ODT."""


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
        raise PageError(f"{path} is damaged: {error}") from None
    if done.returncode:
        reason = done.stderr.decode("utf-8", "replace").split("\n")[0] or "pandoc failed"
        raise PageError(f"{path} cannot be read: {reason}")
    text, _, notes = done.stdout.decode("utf-8").rpartition("\f")
    for words in filter(None, notes.splitlines()):
        note(words)
    if has_heads:
        note("headers and footers of its pages are left out")
    if embedded:
        note(f"embedded objects (formulas, charts, text boxes, frames) are left out: {embedded}")
    lines = [re.sub(r"[ \t\f]+", " ", line).strip() for line in text.split("\n")]
    return "\n".join(filter(None, lines))


def _prepared(path: Path, kind: str, data: bytes) -> tuple[bytes, int, bool]:
    """Return a document as pandoc reads it best, the number of its embedded objects, and whether it
    has headers or footers with text.

    Raises if it is not in UTF-8, or would fill the memory when unpacked.
    """
    name, pattern = _EMBEDDED.get(kind, ("", rb"(?!)"))
    embedded = re.compile(pattern, re.DOTALL)
    if not data.startswith(b"PK"):
        text = decoded(data, path, PageError)
        if kind not in _FORMULAS:
            text = _TEX.sub(lambda found: f"${found[1] or found[2]}$", text)
        return text.encode(), len(embedded.findall(data)), False
    with zipfile.ZipFile(io.BytesIO(data)) as packed:
        size = sum(member.file_size for member in packed.infolist())
        if size > MOST_UNPACKED_BYTES:
            raise PageError(
                f"{path} would unpack to {size // 10**6} MB, above the limit of "
                f"{MOST_UNPACKED_BYTES // 10**6}: give a smaller document"
            )
        has_heads = any(
            re.search(_HEADS, packed.read(member)) for member in packed.namelist()
            if re.fullmatch(r"word/(?:header|footer)\d*\.xml|styles\.xml", member)
        )  # fmt: skip
        content = packed.read(name) if name else b""
        if kind != "odt":
            return data, len(embedded.findall(content)), has_heads
        # pandoc drops the heads of an ODT's tables.
        content = re.sub(rb"</?table:table-header-rows[^>]*>", b"", content)
        content, count = embedded.subn(b"(embedded object)", content)
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w") as copy:
            for member in packed.infolist():
                copy.writestr(member, content if member.filename == name else packed.read(member))
    return file.getvalue(), count, has_heads
