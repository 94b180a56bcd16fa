"""Documents of text with headings, lists, tables and emphasis, by pandoc."""

import io
import json
import re
import shutil
import string
import subprocess
import xml.etree.ElementTree as ET
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from enum import IntFlag, StrEnum
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from smarttouch.base.errors import PageError
from smarttouch.base.files import open_file, read_bytes

INSTALL = "apt install pandoc"
MOST_BYTES, MOST_UNPACKED_BYTES = 50_000_000, 500_000_000
"""Largest file, and largest content of a packed one."""
_TIMEOUT_S = 120.0
_MEMORY = "1500M"
_BEGINNING_BYTES = 4096
_BY_NAME = {".md": "gfm", ".markdown": "gfm", ".html": "html", ".htm": "html", ".xhtml": "html"}
_PACKED = {b"mimetypeapplication/epub+zip": "epub",
           b"mimetypeapplication/vnd.oasis.opendocument.text": "odt"}  # fmt: skip
_HTML = re.compile(
    rb"(\xef\xbb\xbf)?\s*(<\?xml[^>]*>\s*)?(<!--.*?-->\s*)*<(!doctype\s+html|html)\b",
    re.IGNORECASE | re.DOTALL,
)

_ODT_TITLE = re.compile(rb'<text:p text:style-name="Title">(.*?)</text:p>', re.DOTALL)
_XHTML = "{http://www.w3.org/1999/xhtml}"
_NCX = "{http://www.daisy.org/z3986/2005/ncx/}"
_LISTS = (".xhtml", ".html", ".ncx")
_LISTS_PAGES = {("{http://www.idpf.org/2007/ops}type", "page-list")}
_TITLE_WITHIN = 12  # blocks at the beginning, among which is the title if a text has one
_MOST_LIST_BYTES = 5_000_000
_DAMAGES = (
    OSError,
    ValueError,
    RuntimeError,
    EOFError,
    zipfile.BadZipFile,
    zlib.error,
    ET.ParseError,
)
"""What zipfile raises for damaged, encrypted and unknown content, and XML."""


class Emphasis(IntFlag):
    """Type of a character in print, as liblouis numbers them."""

    PLAIN = 0
    ITALIC = 1
    UNDERLINE = 2
    BOLD = 4


class BlockKind(StrEnum):
    """What a block of text is."""

    HEADING = "heading"
    PARAGRAPH = "paragraph"
    ITEM = "item"
    """Of a list."""
    ROW = "row"
    """Of a table; its cells are parted by semicolons."""
    PAGE = "page"
    """Where a page of print begins; its text is the page's number."""


@dataclass(frozen=True)
class Run:
    """Characters of one emphasis, or the number of a page of print that begins there."""

    text: str
    emphasis: Emphasis = Emphasis.PLAIN
    page: bool = False


BETWEEN = Run("; ")  # what parts the cells of a row


@dataclass(frozen=True)
class Block:
    """Heading, paragraph, item or row; its level counts from 1 for headings, from 0 for items.

    ``continued`` if it goes on with the block before a page of print, ``head`` if it is a row of a
    table's head.
    """

    kind: BlockKind
    level: int
    runs: tuple[Run, ...]
    continued: bool = False
    head: bool = False

    @property
    def text(self) -> str:
        """Its words, without emphasis."""
        return "".join(run.text for run in self.runs)


@dataclass(frozen=True)
class StructuredText:
    """Blocks of a document in order, and its metadata, empty where it has none."""

    blocks: tuple[Block, ...]
    title: str = ""
    author: str = ""
    language: str = ""
    date: str = ""

    @property
    def text(self) -> str:
        """A line for each block, without the numbers of pages of print."""
        return _text_of(self.blocks, "\n")


def format_of(path: Path) -> str | None:
    """Return pandoc's name of a document's format, by its content where that shows it; None if it
    has no structure."""
    with open_file(path, PageError, MOST_UNPACKED_BYTES) as file:
        data = file.read(_BEGINNING_BYTES)
    if data.startswith(b"PK\x03\x04"):
        packed = next((name for mark, name in _PACKED.items() if mark in data[:120]), None)
        return packed or ("docx" if b"[Content_Types].xml" in data or b"word/" in data else None)
    if _HTML.match(data):
        return "html"
    return None if b"\x00" in data else _BY_NAME.get(path.suffix.lower())


def read_structured_text(path: Path) -> StructuredText:
    """Read HTML, Markdown, EPUB, DOCX or ODT; nothing else is opened and no script is run."""
    kind = format_of(path)
    program = shutil.which("pandoc")
    if program is None:
        message = f"{path}: this kind of document needs pandoc: {INSTALL}"
        raise PageError(message)
    data = read_bytes(path, PageError, MOST_BYTES)
    if data.startswith(b"PK"):
        _require_modest(path, data)
    try:
        if kind == "odt":
            data = _with_heads(data)
        done = subprocess.run(
            [program, "+RTS", f"-M{_MEMORY}", "-RTS", "--sandbox", "-f", str(kind), "-t", "json"],
            input=data, capture_output=True, timeout=_TIMEOUT_S, check=False,
        )  # fmt: skip
        if done.returncode:
            lines = done.stderr.decode("utf-8", "replace").split("\n")
            raise PageError(f"{path} cannot be read: {lines[0] or 'pandoc failed'}")
        document = json.loads(done.stdout)
        if kind == "epub":
            _mark_pages(document["blocks"], _page_list(data))
        blocks = tuple(each for each in _blocks(document["blocks"]) if each.text.strip())
        about = document["meta"]
    except subprocess.TimeoutExpired:
        message = f"{path} was not read within {_TIMEOUT_S:g} s: give a smaller document"
        raise PageError(message) from None
    except (*_DAMAGES, RecursionError) as error:
        raise PageError(f"{path} cannot be read: {error}") from None
    title, author = _said(about.get("title")), _said(about.get("author") or about.get("creator"))
    language, date = _said(about.get("lang") or about.get("language")), _said(about.get("date"))
    if kind in ("docx", "gfm"):
        blocks = (*_front(blocks, title, author, date if kind == "docx" else ""), *blocks)
    return StructuredText(blocks, title, author, language, date)


def _front(blocks: tuple[Block, ...], title: str, *others: str) -> Iterator[Block]:
    """Yield the lines of a title that pandoc takes out of a text, if they are not in it."""
    if title and title.casefold() not in (each.text.casefold() for each in blocks[:_TITLE_WITHIN]):
        yield Block(BlockKind.HEADING, 1, (Run(title),))
        yield from (Block(BlockKind.PARAGRAPH, 0, (Run(each),)) for each in others if each)


def _text_of(blocks: Iterable[Block], between: str) -> str:
    return between.join(block.text for block in blocks if block.kind is not BlockKind.PAGE)


def _require_modest(path: Path, data: bytes) -> None:
    """Raise if a packed document is damaged, or would fill the memory when unpacked."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as packed:
            size = sum(each.file_size for each in packed.infolist())
    except _DAMAGES as error:
        raise PageError(f"{path} is damaged: {error}") from None
    if size > MOST_UNPACKED_BYTES:
        raise PageError(
            f"{path} would unpack to {size // 10**6} MB, above the limit of "
            f"{MOST_UNPACKED_BYTES // 10**6}: give a smaller document"
        )


def _with_heads(data: bytes) -> bytes:
    """Return an ODT whose tables begin with their heads as usual rows, which pandoc leaves out
    else, and whose title is a heading."""
    file = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as packed, zipfile.ZipFile(file, "w") as made:
        for each in packed.infolist():
            content = packed.read(each)
            if each.filename == "content.xml":
                content = re.sub(rb"</?table:table-header-rows[^>]*>", b"", content)
                content = _ODT_TITLE.sub(rb'<text:h text:outline-level="1">\1</text:h>', content)
            made.writestr(each, content)
    return file.getvalue()


def _said(value: Any) -> str:
    """Return a value of a document's metadata as words; several are parted by commas."""
    if value is None:
        return ""
    content = value["c"]
    if value["t"] == "MetaInlines":
        return "".join(run.text for run in _runs(content)).strip()
    if value["t"] == "MetaBlocks":
        return _text_of(_blocks(content), " ")
    if value["t"] == "MetaList":
        return ", ".join(filter(None, map(_said, content)))
    if value["t"] == "MetaMap":
        return _said(content.get("text") or content.get("name"))
    return str(content)


def _blocks(nodes: Iterable[Any], inside: Block | None = None) -> Iterator[Block]:
    """Yield the blocks of pandoc's nodes; ``inside`` is the item that holds them, without runs."""
    usual = inside or Block(BlockKind.PARAGRAPH, 0, ())
    for node in nodes:
        kind, content = node["t"], node.get("c")
        if kind in ("Para", "Plain"):
            yield from _lines(usual, _runs(content))
        elif kind == "Header":
            yield from _lines(Block(BlockKind.HEADING, content[0], ()), _runs(content[2]))
        elif kind == "CodeBlock":
            yield from _lines(usual, [Run(content[1])])
        elif kind == "LineBlock":
            for line in content:
                yield from _lines(usual, _runs(line))
        elif kind == "Div" and (number := _page_number(node)):
            yield from _lines(usual, [Run(number, page=True)])
        elif kind in ("BlockQuote", "Div", "Figure"):
            yield from _blocks(content if kind == "BlockQuote" else content[-1], inside)
        elif kind in ("BulletList", "OrderedList"):
            level = inside.level + 1 if inside and inside.kind is BlockKind.ITEM else 0
            numbers = _numbers(content[0]) if kind == "OrderedList" else iter(())
            for item in content if kind == "BulletList" else content[1]:
                yield from _item(item, level, next(numbers, ""))
        elif kind == "DefinitionList":
            for term, meanings in content:
                yield from _lines(Block(BlockKind.ITEM, 0, ()), _runs(term))
                for meaning in meanings:
                    yield from _item(meaning, 1, "")
        elif kind == "Table":
            yield from _table(content)


def _item(nodes: Iterable[Any], level: int, number: str) -> Iterator[Block]:
    """Yield the blocks of an item, the first with its number."""
    for block in _blocks(nodes, Block(BlockKind.ITEM, level, ())):
        if number and block.kind is not BlockKind.PAGE:
            block = replace(block, runs=(Run(number), *block.runs))
            number = ""
        yield block


def _numbers(attributes: Any) -> Iterator[str]:
    """Yield the numbers or letters of a list's items."""
    start, style, _ = attributes
    letters = {"LowerAlpha": string.ascii_lowercase, "UpperAlpha": string.ascii_uppercase}
    signs = letters.get(style["t"])
    number = int(start)
    while True:
        yield f"{signs[number - 1] if signs and number <= len(signs) else number}. "
        number += 1


def _table(content: Any) -> Iterator[Block]:
    _, caption, _, head, bodies, foot = content
    yield from _blocks(caption[1])
    parts = [(body[k], k == 2) for body in bodies for k in (2, 3)]
    parts = [(head[1], True), *parts, (foot[1], False)]
    for row, is_head in ((row, is_head) for rows, is_head in parts for row in rows):
        runs: list[Run] = []
        for cell in row[1]:
            blocks = list(_blocks(cell[-1]))
            # No page begins within a row.
            yield from (block for block in blocks if block.kind is BlockKind.PAGE)
            kept = (block.runs for block in blocks if block.kind is not BlockKind.PAGE)
            inside = [run for each in kept for run in (*each, Run(" "))][:-1]
            runs += ([BETWEEN] if runs else []) + (inside or [Run("-")])
        if any(run.text.strip("-; ") for run in runs):
            yield Block(BlockKind.ROW, 0, tuple(runs), head=is_head)


def _lines(like: Block, runs: Iterable[Run]) -> Iterator[Block]:
    """Yield a block of this kind for each line of some runs, and one for each page of print that
    begins there: after the word it divides, but before a heading."""
    line, pages, every = list[Run](), list[Block](), list(runs)
    if like.kind is BlockKind.HEADING:
        every.sort(key=lambda run: not run.page)
    continued = False

    def block() -> Iterator[Block]:
        nonlocal continued
        if any(run.text.strip() for run in line):
            yield replace(like, runs=tuple(line), continued=continued)
            continued = True
        yield from pages
        line.clear()
        pages.clear()

    for run in every:
        if run.page:
            pages.append(Block(BlockKind.PAGE, 0, (run,)))
            continue
        text = run.text
        if pages:
            at_end = not line or line[-1].text[-1:].isspace()
            gap = 0 if at_end else next((k for k, each in enumerate(text) if each.isspace()), -1)
            if gap >= 0:
                line.append(replace(run, text=text[:gap]))
                yield from block()
                text = text[gap:].lstrip(" ")
        first, *others = text.split("\n")
        line.append(replace(run, text=first))
        for each in others:
            yield from block()
            continued = False
            line.append(replace(run, text=each))
    yield from block()


def _page_list(data: bytes) -> dict[str, str]:
    """Return the numbers of the pages of print that an EPUB lists, by pandoc's names of places."""
    found = {}
    with zipfile.ZipFile(io.BytesIO(data)) as packed:
        for each in packed.infolist():
            if not each.filename.endswith(_LISTS) or each.file_size > _MOST_LIST_BYTES:
                continue
            content = packed.read(each)
            if b"page-list" not in content and b"pageTarget" not in content:
                continue
            try:
                root = ET.fromstring(content)
            except ET.ParseError:
                continue
            lists = (nav for nav in root.iter(f"{_XHTML}nav") if set(nav.items()) >= _LISTS_PAGES)
            places = [(link, link.get("href")) for nav in lists for link in nav.iter(f"{_XHTML}a")]
            for target in root.iter(f"{_NCX}pageTarget"):
                label, place = target.find(f"{_NCX}navLabel"), target.find(f"{_NCX}content")
                if label is not None and place is not None:
                    places.append((label, place.get("src")))
            for label, where in places:
                name = unquote(where or "").rpartition("/")[2]
                found[name] = "".join(label.itertext()).strip()
    return found


def _mark_pages(node: Any, numbers: dict[str, str]) -> None:
    """Mark the places, in pandoc's nodes, where pages of print begin."""
    for each in node.values() if isinstance(node, dict) else node:
        if isinstance(each, dict | list):
            _mark_pages(each, numbers)
    if not isinstance(node, dict) or node["t"] not in ("Span", "Div", "Header"):
        return
    about, inside = node["c"][-2:]
    if about[0] in numbers:
        mark = ["pagebreak", numbers[about[0]]]
        if node["t"] != "Header" and _page_number(node):
            about[2].append(mark)
        else:
            kind = "Div" if node["t"] == "Div" else "Span"
            inside.insert(0, {"t": kind, "c": [["", [], [mark]], []]})


def _page_number(node: Any) -> str:
    """Return the number of the page of print that begins at a node; empty if none does."""
    (_, classes, pairs), inside = node["c"][0], node["c"][-1]
    if not {"pagebreak", "doc-pagebreak"} & {*classes, *(part for pair in pairs for part in pair)}:
        return ""
    about = dict(pairs)
    words = about.get("pagebreak") or about.get("title") or about.get("aria-label")
    if not words:
        runs = (block.text for block in _blocks([{"t": "Plain", "c": inside}]))
        words = " ".join(runs) if node["t"] == "Span" else _text_of(_blocks(inside), " ")
    # "Page 12." is 12.
    return (words.split() or [""])[-1].rstrip(".")


_EMPHASIS = {"Emph": Emphasis.ITALIC, "Strong": Emphasis.BOLD, "Underline": Emphasis.UNDERLINE}
_QUOTES = {"SingleQuote": "‘’", "DoubleQuote": "“”"}
_SPACES = {"Space": " ", "SoftBreak": " ", "LineBreak": "\n"}


def _runs(nodes: Iterable[Any], emphasis: Emphasis = Emphasis.PLAIN) -> Iterator[Run]:
    """Yield the runs of pandoc's inline nodes."""
    for node in nodes:
        kind, content = node["t"], node.get("c")
        if kind == "Str" or kind in _SPACES:
            yield Run(_SPACES.get(kind) or content, emphasis)
        elif kind in _EMPHASIS:
            yield from _runs(content, emphasis | _EMPHASIS[kind])
        elif kind in ("Code", "Math"):
            yield Run(content[1], emphasis)
        elif kind == "Quoted":
            quotes = _QUOTES[content[0]["t"]]
            yield Run(quotes[0], emphasis)
            yield from _runs(content[1], emphasis)
            yield Run(quotes[1], emphasis)
        elif kind == "Note":
            note = _text_of(_blocks(content), " ")
            yield Run(f" ({note})", emphasis)
        elif kind == "Link" and "footnote-back" in content[0][1]:
            continue
        elif kind == "Span" and (number := _page_number(node)):
            yield Run(number, page=True)
        elif kind in ("Link", "Span", "Cite", "Image"):
            yield from _runs(content[1], emphasis)
        elif kind in ("Strikeout", "Superscript", "Subscript", "SmallCaps"):
            yield from _runs(content, emphasis)
