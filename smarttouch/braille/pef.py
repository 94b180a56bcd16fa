"""PEF 1.0, the portable embosser format: pages of cells as XML."""

import uuid
import xml.etree.ElementTree as ET
from pathlib import Path
from xml.parsers import expat

from smarttouch.braille.cells import Pages, require_cells
from smarttouch.braille.files import MOST_BYTES
from smarttouch.errors import BrailleError
from smarttouch.files import read_bytes, write_bytes

# PEF 1.0, public specification (2010): http://pef-format.org
_PEF = "http://www.daisy.org/ns/2008/pef"
_DC = "http://purl.org/dc/elements/1.1/"
_FORMAT = "application/x-pef+xml"


def read_pef(path: Path) -> Pages:
    """Read the pages of a PEF file, of all its volumes and sections."""
    return parse_pef(read_bytes(path, BrailleError, MOST_BYTES), str(path))


def write_pef(path: Path, pages: Pages) -> None:
    """Write a PEF file of one volume; its title is the file's name."""
    write_bytes(path, format_pef(pages, path.stem), BrailleError)


def format_pef(pages: Pages, title: str) -> bytes:
    """Return pages in PEF; equal pages give equal files."""
    for page in pages:
        for line in page:
            require_cells(line)
    ET.register_namespace("", _PEF)
    ET.register_namespace("dc", _DC)
    root = ET.Element(f"{{{_PEF}}}pef", version="2008-1")
    meta = _add(_add(root, "head"), "meta")
    name = "\f".join("\n".join(page) for page in pages)
    for key, value in (
        ("format", _FORMAT),
        ("identifier", uuid.uuid5(uuid.NAMESPACE_URL, name).urn),
        ("title", title),
    ):
        ET.SubElement(meta, f"{{{_DC}}}{key}").text = value
    volume = _add(
        _add(root, "body"), "volume", rowgap="0", duplex="false",
        cols=str(max((len(line) for page in pages for line in page), default=1) or 1),
        rows=str(max(map(len, pages), default=1) or 1),
    )  # fmt: skip
    section = _add(volume, "section")
    for page in pages or [[]]:
        sheet = _add(section, "page")
        for line in page:
            _add(sheet, "row").text = line or None
    ET.indent(root, " ")
    written: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return written + b"\n"


def parse_pef(data: bytes, name: str = "PEF") -> Pages:
    """Return the pages of a PEF file; ``name`` is for error messages."""
    try:
        _refuse_declarations(data, name)
        root = ET.fromstring(data)
    except (ET.ParseError, expat.ExpatError, LookupError, ValueError) as error:
        raise BrailleError(f"{name} is not XML: {error}", about="file") from None
    if root.tag != f"{{{_PEF}}}pef":
        raise BrailleError(f"{name} is not a PEF file: its root is {root.tag!r}", about="file")
    pages = [
        [_row(row, name) for row in page.findall(f"{{{_PEF}}}row")]
        for page in root.iter(f"{{{_PEF}}}page")
    ]
    if not pages:
        raise BrailleError(f"{name} is a PEF file without pages", about="file")
    return pages


def _add(parent: ET.Element, tag: str, **attributes: str) -> ET.Element:
    return ET.SubElement(parent, f"{{{_PEF}}}{tag}", attributes)


def _refuse_declarations(data: bytes, name: str) -> None:
    """Raise if there is a document type: its entities could expand without bounds."""

    def refuse(*_: object) -> None:
        raise BrailleError(
            f"{name} declares a document type, which PEF files must not have", about="file"
        )

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = refuse
    parser.Parse(data, True)


def _row(row: ET.Element, name: str) -> str:
    line = "".join(row.itertext()).strip()
    try:
        require_cells(line)
    except BrailleError as error:
        raise BrailleError(f"{name}: {error}", about=error.about) from None
    return line
