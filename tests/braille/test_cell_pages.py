"""Texts and files as they are given become cells, and cells become files."""

from pathlib import Path

import pytest

from smarttouch.base.errors import BrailleError
from smarttouch.braille.cell_pages import load_cells, write_cells
from smarttouch.braille.code_tables import open_table
from smarttouch.pages.file_kinds import FileKind, file_kind

from ..raising import raises


@pytest.fixture
def table():
    return open_table("en-1")


@pytest.fixture
def load(table):
    return lambda source, **options: load_cells(str(source), table, **options)


def test_a_text(load):
    loaded = load("Go\n\nthere")
    assert loaded.paragraphs == ["⠠⠛⠕", "", "⠞⠓⠑⠗⠑"]
    assert loaded.pages is None


def test_cells_stay_cells(load):
    assert load("⠁⠃ ⣿\n⠉").paragraphs == ["⠁⠃⠀⣿", "⠉"]


def test_a_text_file(load, tmp_path):
    path = tmp_path / "a.TXT"
    path.write_bytes("\ufeffé\r\nb\r\n".encode())
    assert load(path).paragraphs == ["⠘⠌⠑", "⠃"]


@pytest.mark.parametrize("name", ["README.md", "notes", "LICENSE.rst"])
def test_a_file_is_read_whatever_its_name(load, table, tmp_path, monkeypatch, name):
    (tmp_path / name).write_text("Go")
    assert load(tmp_path / name).paragraphs == ["⠠⠛⠕"]
    monkeypatch.chdir(tmp_path)
    assert load(name).paragraphs == ["⠠⠛⠕"]
    assert load(f"text:{name}").paragraphs == [table.to_cells(name)]


def test_what_looks_like_a_name_is_no_text(load, tmp_path):
    for name in ("missing.md", "./missing", "a/b.txt"):
        with raises(BrailleError, about="file", value=Path(name)):
            load(name)
    with raises(BrailleError, about="file"):
        load(tmp_path)
    for words in ("either/or", "U.S.A.", "3.5", "see a.txt", "text:a.md"):
        assert load(words).paragraphs


@pytest.mark.parametrize(("name", "data", "kind"), [
    ("a.md", "é".encode() * 2048, FileKind.STRUCTURED),
    ("a", b"<!DOCTYPE html><p>", FileKind.STRUCTURED),
    ("a", b"x" + "é".encode() * 2048, FileKind.TEXT),
    ("a.dat", b'<?xml version="1.0"?>\n<pef version="2008-1">', FileKind.PEF),
    ("a.brf", b"ABC", FileKind.BRF),
    ("a.txt", b"\x00", FileKind.TEXT),
    ("a", b"\x89PNG\r\n\x1a\n", FileKind.PAGES),
    ("a", b"%PDF-1.4\nplain", FileKind.PAGES),
    ("a", b"\xffabc", FileKind.PAGES),
    ("a", b"a\x00b", FileKind.PAGES),
    ("a", b"", FileKind.TEXT),
])  # fmt: skip
def test_kinds_of_files(tmp_path, name, data, kind):
    (tmp_path / name).write_bytes(data)
    assert file_kind(tmp_path / name) is kind


@pytest.mark.parametrize("suffix", ["brf", "pef", "txt"])
def test_files_of_cells(load, tmp_path, suffix):
    path = tmp_path / f"a.{suffix}"
    pages = [["⠀⠀⠁⠃", "⠉"], ["⠀⠀⠙"]]
    write_cells(path, pages)
    loaded = load(path)
    if suffix == "txt":
        assert loaded.paragraphs == ["⠀⠀⠁⠃", "⠉", "⠀⠀⠙"]
    else:
        assert loaded.pages == pages
        assert loaded.paragraphs == ["⠁⠃⠀⠉", "⠙"]


def test_what_is_left_out_is_noted(load, table):
    with raises(BrailleError, about="text", value="中"):
        load("a中")
    loaded = load("a中", leave_out=True)
    assert loaded.paragraphs == ["⠁"]
    assert "en-1" in loaded.notes[-1]
    assert loaded.notes[-1].endswith(" 中")
    many = load("a" + "".join(map(chr, range(0x4E00, 0x4E20))), leave_out=True)
    assert many.notes[-1].endswith("一 丁 丂 七 丄 丅 丆 万 丈 三 上 下 …")
    assert load("a").notes == [table.note] * bool(table.note)


@pytest.mark.parametrize(("name", "data", "attributes"), [
    ("none.brf", None, {"about": "file"}),
    ("folder.brf", "folder", {"about": "file", "value": "folder.brf"}),
    ("bad.txt", b"ab\xff", {"about": "file"}),
    ("empty.txt", b"\n \n", {"about": "text"}),
    ("empty.brf", b"", {"about": "text"}),
    ("bad.pef", b"<a/>", {"about": "file", "value": "a"}),
    ("bad.brf", b"\xff", {"about": "cell", "value": "ÿ"}),
])  # fmt: skip
def test_bad_files(load, tmp_path, name, data, attributes):
    if data == "folder":
        (tmp_path / name).mkdir()
    elif data is not None:
        (tmp_path / name).write_bytes(data)
    with raises(BrailleError, **attributes):
        load(tmp_path / name)


@pytest.mark.parametrize("text", ["", "  ", "\n\n", "⠀"])
def test_nothing_to_read(load, text):
    with raises(BrailleError, about="text"):
        load(text)


def test_files_that_cannot_be_written(tmp_path):
    with raises(BrailleError, about="file", allowed=(".brf", ".pef", ".ebrl", ".txt")):
        write_cells(tmp_path / "a.doc", [["⠁"]])
    with raises(BrailleError, about="file"):
        write_cells(tmp_path / "none" / "a.brf", [["⠁"]])
