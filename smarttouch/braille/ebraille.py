"""eBraille 1.0: a document's cells as the file set of an EPUB 3, packed into a file.

After the public specification of 14 August 2025, `SPECIFICATION`.
"""

import io
import re
import uuid
import xml.etree.ElementTree as ET
import zipfile
from datetime import UTC, datetime
from pathlib import Path

from smarttouch.base.errors import BrailleError
from smarttouch.base.files import write_bytes
from smarttouch.base.version import __version__
from smarttouch.braille import louis
from smarttouch.braille.block_layout import ShapedText
from smarttouch.braille.cells import (
    BLANK,
    NO_XML,
    SIX_DOT_PATTERNS,
    pattern,
    require_cells,
)
from smarttouch.pages.structured_text import BETWEEN, Block, BlockKind, Run

SPECIFICATION = "https://daisy.org/s/ebraille/1.0/FINAL-ebraille-20250814/"
_UNKNOWN = "Unknown"
_SYSTEMS = {
    "en-1": "UEB grade1", "en-2": "UEB grade2", "en-us-2": "EBAE grade2", "en-gb-2": "SEB grade2",
    "de-0": "German grade0", "de-1": "German grade1", "de-2": "German grade2",
    "fr-1": "French grade1", "fr-2": "French grade2",
}  # fmt: skip
"""Braille systems, as the registry of eBraille proposes their names, of our tables."""
_TAG = re.compile(r"([A-Za-z]{2,3})(?:-[A-Za-z]{4})?(?:-([A-Za-z]{2}|[0-9]{3}))?(?:-.*)?")
_DATE = re.compile(r"[0-9]{4}(?:-(?:0[1-9]|1[0-2])(?:-(?:0[1-9]|[12][0-9]|3[01]))?)?(?![0-9])")
_CSS = """p, ul, li, table { margin: 0; padding: 0 }
p { text-indent: 2ch }
h1 { margin: 1em 0; text-align: center }
h2 { margin: 1em 0 0 4ch }
h3, h4, h5, h6 { margin: 1em 0 0 6ch }
body > ul, table { margin: 1em 0 }
ul { list-style-type: none }
li { padding-left: 2ch; text-indent: -2ch }
div[role="doc-pagebreak"] { text-align: right }
"""
_CONTAINER = """<?xml version="1.0" encoding="UTF-8"?>
<container version="1.0" xmlns="urn:oasis:names:tc:opendocument:xmlns:container">
 <rootfiles>
  <rootfile full-path="package.opf" media-type="application/oebps-package+xml"/>
 </rootfiles>
</container>
"""
_ACCESS = (
    ("accessMode", "tactile"), ("accessModeSufficient", "tactile"),
    ("accessibilityFeature", "braille"), ("accessibilityFeature", "structuralNavigation"),
    ("accessibilityFeature", "tableOfContents"), ("accessibilityHazard", "none"),
)  # fmt: skip


def write_ebraille(path: Path, text: ShapedText, complete: bool = True) -> list[str]:
    """Write a document in eBraille; return notes on what stands there for what it does not say.

    ``complete`` if nothing of the original was left out.
    """
    write_bytes(path, format_ebraille(text, path.stem, complete), BrailleError)
    lacking = {
        f"its author ({_UNKNOWN})": text.document.author,
        "the date of its copyright (this year)": _DATE.match(text.document.date),
    }
    missing = " and ".join(name for name, value in lacking.items() if not value)
    return [f"eBraille requires what the document does not say: {missing}"] if missing else []


def format_ebraille(
    text: ShapedText, name: str, complete: bool = True, when: datetime | None = None
) -> bytes:
    """Return a document in eBraille made ``when``, by default now; ``name`` is its title if it has
    none."""
    for cells in text.cells:
        require_cells(cells)
    book = _Book(text, NO_XML.sub("", text.document.title or name).strip() or _UNKNOWN)
    chapters = {f"ebraille/{k}.xhtml": book.page(body, "style.css") for k, body in book.bodies()}
    files = {
        "META-INF/container.xml": _CONTAINER.encode(),
        "package.opf": book.package(list(chapters), complete, when or datetime.now(UTC)),
        "index.html": book.page(book.navigation(), "ebraille/style.css"),
        "ebraille/style.css": _CSS.encode(),
        **chapters,
    }
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as packed:
        packed.writestr(zipfile.ZipInfo("mimetype"), "application/epub+zip", zipfile.ZIP_STORED)
        for place, data in files.items():
            packed.writestr(zipfile.ZipInfo(place), data, zipfile.ZIP_DEFLATED)
    return made.getvalue()


class _Book:
    """Documents of a publication: a chapter from each of its widest headings on."""

    def __init__(self, text: ShapedText, title: str) -> None:
        self._text, self._title = text, title
        self._title_cells = _spaced(text.table.to_cells(title, leave_out=True)) or "⠿"
        self._language = _language(text)
        blocks = text.document.blocks
        levels = [block.level for block in blocks if block.kind is BlockKind.HEADING]
        self._widest = min(levels, default=0)
        self._chapters = [ET.Element("body")]
        self._headings: list[tuple[int, str, str]] = []  # level, place and cells
        self._pages: list[tuple[str, str, str]] = []  # number, place and cells
        self._open: list[tuple[int, ET.Element]] = []  # levels and items of a list
        self._last = self._chapters[0]  # what the last text stands in
        self._kind: BlockKind | None = None
        begun: list[tuple[str, str]] = []  # numbers of pages of print and their cells
        for block, cells in zip(blocks, text.cells, strict=True):
            if block.kind is BlockKind.PAGE:
                begun.append((block.text, _spaced(cells)))
                continue
            listed = block.kind in (BlockKind.ITEM, BlockKind.ROW)
            goes_on = block.kind is self._kind and (block.continued or listed)
            widest = block.kind is BlockKind.HEADING and block.level == self._widest
            if widest and not goes_on and len(self._body):
                self._chapters.append(ET.Element("body"))
                self._kind = None
            for number, words in begun:
                self._begin_page(number, words, goes_on)
            if goes_on and block.continued and begun:
                self._last[-1].tail = f" {_spaced(cells)}"
            elif cells.strip(BLANK):
                self._add(block, _spaced(cells))
                self._kind = block.kind
            begun.clear()
        for number, words in begun:
            self._begin_page(number, words, False)

    @property
    def _body(self) -> ET.Element:
        return self._chapters[-1]

    @property
    def _file(self) -> str:
        return f"ebraille/{len(self._chapters)}.xhtml"

    def bodies(self) -> list[tuple[int, ET.Element]]:
        """Return the number and the body of each chapter."""
        return list(enumerate(self._chapters, 1))

    def _begin_page(self, number: str, words: str, goes_on: bool) -> None:
        name = f"page-{len(self._pages) + 1}"
        self._pages.append((number, f"{self._file}#{name}", words))
        about = {"id": name, "role": "doc-pagebreak", "epub:type": "pagebreak"}
        parent = self._last if goes_on else self._body
        mark = ET.SubElement(parent, "span" if goes_on else "div", about)
        mark.text, mark.tail = words, " " if goes_on else None

    def _add(self, block: Block, words: str) -> None:
        if block.kind is BlockKind.HEADING:
            name = f"heading-{len(self._headings) + 1}"
            self._headings.append((block.level, f"{self._file}#{name}", words))
            level = min(max(block.level, 1), 6)
            self._last = ET.SubElement(self._body, f"h{level}", id=name)
        elif block.kind is BlockKind.ITEM:
            if self._kind is not BlockKind.ITEM:
                self._open = [(-1, self._body)]
                ET.SubElement(self._body, "ul")
            while self._open[-1][0] >= block.level:
                self._open.pop()
            holder = self._open[-1][1]
            inner = holder.findall("ul") or [ET.SubElement(holder, "ul")]
            self._last = ET.SubElement(inner[-1], "li")
            self._open.append((block.level, self._last))
        elif block.kind is BlockKind.ROW:
            again = self._kind is BlockKind.ROW
            table = self._body.findall("table")[-1] if again else ET.SubElement(self._body, "table")
            row = ET.SubElement(table, "tr")
            for runs in _cells_of_row(block):
                self._last = ET.SubElement(row, "th" if block.head else "td")
                self._last.text = _spaced(self._text.cells_of(runs))
            return
        else:
            self._last = ET.SubElement(self._body, "p")
        self._last.text = words

    def navigation(self) -> ET.Element:
        """Return the body of the document of contents and of the pages of print."""
        body = ET.Element("body")
        about = {"epub:type": "toc", "role": "doc-toc", "aria-label": "Contents"}
        holders = [(-1, ET.SubElement(body, "nav", about))]
        for level, place, words in self._headings or [(1, "ebraille/1.xhtml", self._title_cells)]:
            while holders[-1][0] >= level:
                holders.pop()
            inner = holders[-1][1].find("ol")
            item = ET.SubElement(
                ET.SubElement(holders[-1][1], "ol") if inner is None else inner, "li"
            )
            ET.SubElement(item, "a", href=place).text = words or "⠿"
            holders.append((level, item))
        if self._pages:
            about = {"epub:type": "page-list", "role": "doc-pagelist", "aria-label": "Pages"}
            pages = ET.SubElement(ET.SubElement(body, "nav", about), "ol")
            for number, place, words in self._pages:
                item = ET.SubElement(pages, "li")
                title = NO_XML.sub("", number)
                ET.SubElement(item, "a", href=place, title=title).text = words or "⠿"
        return body

    def page(self, body: ET.Element, style: str) -> bytes:
        """Return a document of XHTML."""
        root = ET.Element("html", {
            "xmlns": "http://www.w3.org/1999/xhtml", "xmlns:epub": "http://www.idpf.org/2007/ops",
            "lang": self._language, "xml:lang": self._language,
        })  # fmt: skip
        head = ET.SubElement(root, "head")
        ET.SubElement(head, "meta", charset="utf-8")
        ET.SubElement(head, "title").text = self._title_cells
        ET.SubElement(head, "link", rel="stylesheet", type="text/css", href=style)
        root.append(body)
        made: bytes = ET.tostring(root, encoding="utf-8")
        return b"<!DOCTYPE html>\n" + made

    def package(self, chapters: list[str], complete: bool, when: datetime) -> bytes:
        """Return the package document: metadata, manifest and reading order."""
        document, cells = self._text.document, "\n".join(self._text.cells)
        root = ET.Element("package", {
            "xmlns": "http://www.idpf.org/2007/opf", "version": "3.0", "unique-identifier": "id",
            "xml:lang": "en",
        })  # fmt: skip
        about = ET.SubElement(root, "metadata", {"xmlns:dc": "http://purl.org/dc/elements/1.1/"})
        for name, value in (
            ("identifier", uuid.uuid5(uuid.NAMESPACE_URL, cells).urn),
            ("title", self._title),
            ("creator", NO_XML.sub("", document.author).strip() or _UNKNOWN),
            ("language", self._language),
            ("format", "eBraille 1.0"),
            ("date", f"{when:%Y-%m-%d}"),
        ):
            element = ET.SubElement(
                about, f"dc:{name}", {"id": "id"} if name == "identifier" else {}
            )
            element.text = value
        copyrighted = _DATE.match(document.date)
        eight = any(each != "\n" and pattern(each) >= SIX_DOT_PATTERNS for each in cells)
        for name, value in (
            ("dcterms:modified", f"{when:%Y-%m-%dT%H:%M:%SZ}"),
            ("dcterms:dateCopyrighted", copyrighted[0] if copyrighted else f"{when:%Y}"),
            ("dcterms:conformsTo", SPECIFICATION),
            ("a11y:brailleCellType", "8" if eight else "6"),
            ("a11y:brailleSystem", _SYSTEMS.get(self._text.table.name, self._text.table.title)),
            ("a11y:completeTranscription", str(complete).lower()),
            ("a11y:producer", f"SmartTouch {__version__}"),
            ("a11y:tactileGraphics", "none"),
            *((f"schema:{name}", value) for name, value in _ACCESS),
        ):
            ET.SubElement(about, "meta", property=name).text = value
        manifest, spine = ET.SubElement(root, "manifest"), ET.SubElement(root, "spine")
        xhtml = "application/xhtml+xml"
        item = {"id": "nav", "href": "index.html", "media-type": xhtml, "properties": "nav"}
        ET.SubElement(manifest, "item", item)
        item = {"id": "style", "href": "ebraille/style.css", "media-type": "text/css"}
        ET.SubElement(manifest, "item", item)
        for k, place in enumerate(chapters, 1):
            item = {"id": f"c{k}", "href": place, "media-type": xhtml}
            ET.SubElement(manifest, "item", item)
            ET.SubElement(spine, "itemref", idref=f"c{k}")
        ET.indent(root, " ")
        made: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
        return made


def _spaced(cells: str) -> str:
    """Return cells with spaces, where lines may end, for blank ones."""
    return cells.replace(BLANK, " ").strip()


def _cells_of_row(block: Block) -> list[tuple[Run, ...]]:
    parts: list[list[Run]] = [[]]
    for run in block.runs:
        if run == BETWEEN:
            parts.append([])
        else:
            parts[-1].append(run)
    return [tuple(part) for part in parts]


def _language(text: ShapedText) -> str:
    """Return the tag of a document's language, or that of its table, in the script of Braille."""
    own = re.split("[,; ]", text.document.language.strip())[0].replace("_", "-")
    for tag in (own, louis.language_of(text.table.name), text.table.name):
        if found := _TAG.fullmatch(tag):
            region = f"-{found[2].upper()}" if found[2] else ""
            return f"{found[1].lower()}-Brai{region}"
    return "und-Brai"
