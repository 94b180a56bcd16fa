"""eBraille files keep structure, pages and cells of a document, and pass EPUBCheck."""

import io
import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
import zipfile
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.braille.block_layout import shaped_text
from smarttouch.braille.cells import is_cell
from smarttouch.braille.code_tables import open_table
from smarttouch.braille.ebraille import format_ebraille
from smarttouch.pages.structured_text import BETWEEN, Block, BlockKind, Run, StructuredText

from ..whole import WHOLE

TABLE = open_table("en-1")
EPUBCHECK = shutil.which("epubcheck")
OPF = "{http://www.idpf.org/2007/opf}"
DC = "{http://purl.org/dc/elements/1.1/}"
XHTML = "{http://www.w3.org/1999/xhtml}"


def block(kind, level, *texts, continued=False, head=False):
    runs = [run for text in texts for run in (BETWEEN, Run(text))][1:]
    return Block(BlockKind(kind), level, tuple(runs), continued, head)


BOOK = StructuredText(
    (
        block("page", 0, "iv"), block("heading", 1, "tea"), block("paragraph", 0, "first words"),
        block("page", 0, "5"), block("paragraph", 0, "go on", continued=True),
        block("item", 0, "one"), block("item", 1, "inner"), block("item", 0, "two"),
        block("heading", 2, "cups"), block("row", 0, "name", "price", head=True),
        block("page", 0, "6"), block("row", 0, "cup", "3"), block("heading", 1, "rest"),
        block("paragraph", 0, "end"),
    ),
    "A <title> & more", "A. Writer", "en-US", "2004-05-01T00:00:00Z",
)  # fmt: skip


def opened(text, **options):
    """Return the files of a publication, those of XML parsed."""
    with zipfile.ZipFile(io.BytesIO(format_ebraille(text, "name", **options))) as packed:
        first = packed.infolist()[0]
        assert (first.filename, first.compress_type) == ("mimetype", zipfile.ZIP_STORED)
        return {
            name: packed.read(name) if name.endswith(("mimetype", "css")) else
            ET.fromstring(packed.read(name)) for name in packed.namelist()
        }  # fmt: skip


def texts(element):
    return [each.strip() for each in element.itertext() if each.strip()]


def test_metadata():
    files = opened(shaped_text(BOOK, TABLE), when=datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC))
    about = files["package.opf"].find(f"{OPF}metadata")
    said = {each.tag.removeprefix(DC): each.text for each in about if each.tag.startswith(DC)}
    said |= {each.get("property"): each.text for each in about.iter(f"{OPF}meta")}
    assert said.pop("identifier").startswith("urn:uuid:")
    assert said.pop("a11y:producer").startswith("SmartTouch ")
    assert said.items() >= {
        "title": "A <title> & more", "creator": "A. Writer", "language": "en-Brai-US",
        "format": "eBraille 1.0", "date": "2026-03-04", "dcterms:modified": "2026-03-04T05:06:07Z",
        "dcterms:dateCopyrighted": "2004-05-01", "a11y:brailleCellType": "6",
        "a11y:brailleSystem": "UEB grade1", "a11y:completeTranscription": "true",
        "a11y:tactileGraphics": "none",
    }.items()  # fmt: skip


def test_structure():
    files = opened(shaped_text(BOOK, TABLE))
    first, second = (files[f"ebraille/{k}.xhtml"].find(f"{XHTML}body") for k in (1, 2))
    assert [each.tag.removeprefix(XHTML) for each in first] == [
        "div",
        "h1",
        "p",
        "ul",
        "h2",
        "table",
    ]
    assert texts(first.find(f"{XHTML}p")) == ["⠋⠊⠗⠎⠞ ⠺⠕⠗⠙⠎", "⠼⠑", "⠛⠕ ⠕⠝"]
    one, inner, two = first.iter(f"{XHTML}li")
    assert (texts(one), texts(inner), texts(two)) == (["⠕⠝⠑", "⠊⠝⠝⠑⠗"], ["⠊⠝⠝⠑⠗"], ["⠞⠺⠕"])
    rows = [[texts(cell) for cell in row] for row in first.iter(f"{XHTML}tr")]
    assert rows == [[["⠝⠁⠍⠑"], ["⠏⠗⠊⠉⠑", "⠼⠋"]], [["⠉⠥⠏"], ["⠼⠉"]]]
    kinds = [[cell.tag.removeprefix(XHTML) for cell in row] for row in first.iter(f"{XHTML}tr")]
    assert kinds == [["th", "th"], ["td", "td"]]
    assert texts(second) == ["⠗⠑⠎⠞", "⠑⠝⠙"]
    contents, pages = files["index.html"].iter(f"{XHTML}nav")
    assert [(link.get("href"), link.text) for link in contents.iter(f"{XHTML}a")] == [
        ("ebraille/1.xhtml#heading-1", "⠞⠑⠁"), ("ebraille/1.xhtml#heading-2", "⠉⠥⠏⠎"),
        ("ebraille/2.xhtml#heading-3", "⠗⠑⠎⠞"),
    ]  # fmt: skip
    assert [(link.get("title"), link.text) for link in pages.iter(f"{XHTML}a")] == [
        ("iv", "⠊⠧"), ("5", "⠼⠑"), ("6", "⠼⠋"),
    ]  # fmt: skip


@pytest.mark.skipif(not WHOLE, reason="long: with SMARTTOUCH_WHOLE=1, as in .ci/run")
@pytest.mark.skipif(EPUBCHECK is None, reason="needs EPUBCheck: apt install epubcheck")
def test_epubcheck_reports_what_ebraille_requires_and_epub_does_not_know(tmp_path):
    path, report = tmp_path / "book.epub", tmp_path / "report.json"
    # It takes no other names than those of EPUB.
    path.write_bytes(format_ebraille(shaped_text(BOOK, TABLE), "book"))
    program = Path(EPUBCHECK)
    # Debian's is an archive that Java runs.
    java = ["java", "-jar"] if program.read_bytes()[:2] == b"PK" else []
    command = [*java, program, path, "--json", report]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert report.exists(), done.stderr
    messages = json.loads(report.read_text())["messages"]
    said = {(each["ID"], re.search(r'"(.*?)"', each["message"])[1]) for each in messages}
    required = ("brailleCellType", "brailleSystem", "completeTranscription", "producer",
                "tactileGraphics")  # fmt: skip
    unknown = {("OPF-027", f"a11y:{name}") for name in required}
    assert said <= {("HTM-014a", "index.html"), *unknown}


BLOCKS = st.lists(
    st.builds(
        block,
        st.sampled_from([each.value for each in BlockKind]),
        st.integers(0, 7),
        st.text(max_size=12),
        st.text(max_size=4),
        continued=st.booleans(),
    ),
    max_size=12,
)


@given(BLOCKS, st.text(max_size=9), st.text(max_size=9))
def test_any_document_gives_xml_of_cells_whose_links_lead_somewhere(blocks, title, language):
    made = StructuredText(tuple(blocks), title, title, language, title)
    files = opened(shaped_text(made, TABLE, leave_out=True))
    pages = {name: root for name, root in files.items() if name.endswith("html")}
    ids = {f"{name}#{each.get('id')}" for name, root in pages.items() for each in root.iter()}
    for root in pages.values():
        assert all(is_cell(each) or each.isspace() for each in "".join(root.itertext()))
        assert root.get("lang").split("-")[1] == "Brai"
    links = [each.get("href") for each in files["index.html"].iter(f"{XHTML}a")]
    assert all(link in ids or link in files for link in links)
