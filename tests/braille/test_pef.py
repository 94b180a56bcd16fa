"""PEF: what is written is read back and fits the standard; invalid files give one sentence."""

import contextlib
import xml.etree.ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.errors import BrailleError
from smarttouch.braille.cells import format_pef, parse_pef, read_pef, write_pef

from ..raising import raises

PEF = "{http://www.daisy.org/ns/2008/pef}"
DC = "{http://purl.org/dc/elements/1.1/}"
LINES = st.text(st.characters(min_codepoint=0x2800, max_codepoint=0x28FF), max_size=45)
PAGES = st.lists(st.lists(LINES, max_size=5), min_size=1, max_size=4)


@given(PAGES, st.text(st.characters(categories=["L", "N", "P", "S", "Zs"])))
def test_what_is_written_is_read(pages, title):
    assert parse_pef(format_pef(pages, title)) == pages


def test_the_structure_of_the_standard(tmp_path):
    path = tmp_path / "story.pef"
    write_pef(path, [["⠁⠃⠉", ""], ["⠁"]])
    root = ET.parse(path).getroot()
    assert (root.tag, root.attrib) == (PEF + "pef", {"version": "2008-1"})
    assert [each.tag for each in root] == [PEF + "head", PEF + "body"]
    meta = {each.tag: each.text for each in root.find(f"{PEF}head/{PEF}meta")}
    assert meta[DC + "format"] == "application/x-pef+xml"
    assert meta[DC + "identifier"].startswith("urn:uuid:")
    assert meta[DC + "title"] == "story"
    (volume,) = root.find(f"{PEF}body")
    assert volume.attrib == {"cols": "3", "rows": "2", "rowgap": "0", "duplex": "false"}
    (section,) = volume
    assert [[row.text for row in page] for page in section] == [["⠁⠃⠉", None], ["⠁"]]
    assert read_pef(path) == [["⠁⠃⠉", ""], ["⠁"]]


def test_volumes_and_sections_of_others():
    page = "<page><row>⠁</row><row rowgap='2'>\n⠃ </row></page>"
    data = (
        f"<p:pef xmlns:p='{PEF[1:-1]}' version='2008-1'><p:head/><p:body><p:volume><p:section>"
        f"{page}{page}</p:section></p:volume><p:volume><p:section>{page}</p:section></p:volume>"
        "</p:body></p:pef>"
    )
    for tag in ("page", "row"):
        data = data.replace(f"<{tag}", f"<p:{tag}").replace(f"</{tag}", f"</p:{tag}")
    assert parse_pef(data.encode("utf-16")) == [["⠁", "⠃"]] * 3


BOMB = b"<!DOCTYPE x [<!ENTITY a '\xe2\xa0\x81'>]><pef>&a;</pef>"


@pytest.mark.parametrize(("data", "about"), [
    (b"", "file"),
    (b"hello", "file"),
    (b"<pef>", "file"),
    (b"<?xml version='1.0' encoding='nonsense'?><a/>", "file"),
    (b"<html/>", "file"),
    (f"<pef xmlns='{PEF[1:-1]}'/>".encode(), "file"),
    (format_pef([["⠁"]], "").replace("⠁".encode(), b"A"), "cell"),
    (BOMB, "file"),
    (BOMB.decode().encode("utf-16"), "file"),
])  # fmt: skip
def test_nonsense(data, about):
    with raises(BrailleError, about=about):
        parse_pef(data)


def test_letters_are_not_written():
    with raises(BrailleError, about="cell", value="x"):
        format_pef([["x"]], "")


@given(st.binary(max_size=60), st.integers(0, 700), st.integers(0, 60))
def test_no_bytes_crash_the_reader(noise, place, length):
    whole = format_pef([["⠁⠃"]], "noise")
    for data in (noise, whole[:place] + noise + whole[place + length :]):
        with contextlib.suppress(BrailleError):
            parse_pef(data)


@given(st.text(max_size=20), st.sampled_from(["\0", "\x1b", "\ud800", "\uffff", ""]))
def test_any_title_is_xml(title, odd):
    data = format_pef([["⠁"]], title + odd, odd + title, odd)
    assert parse_pef(data) == [["⠁"]]
