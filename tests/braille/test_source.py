"""Texts and files as they are given become cells, and cells become files."""

import pytest

from smarttouch.braille.source import load_cells, write_cells
from smarttouch.braille.tables import open_table
from smarttouch.errors import BrailleError


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
    with pytest.raises(BrailleError, match="no cells for '中'"):
        load("a中")
    loaded = load("a中", leave_out=True)
    assert loaded.paragraphs == ["⠁"]
    assert loaded.notes[-1] == "left out, as table en-1 has no cells for them: 中"
    many = load("a" + "".join(map(chr, range(0x4E00, 0x4E20))), leave_out=True)
    assert many.notes[-1].endswith("一 丁 丂 七 丄 丅 丆 万 丈 三 上 下 …")
    assert load("a").notes == [table.note] * bool(table.note)


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("none.brf", None, "no file"),
        ("bad.txt", b"ab\xff", r"not a text in UTF-8 \(byte 3\)"),
        ("empty.txt", b"\n \n", "nothing to read"),
        ("empty.brf", b"", "nothing to read"),
        ("bad.pef", b"<a/>", "not a PEF file"),
        ("bad.brf", b"\xff", "line 1, column 1"),
    ],
)
def test_bad_files(load, tmp_path, name, data, words):
    if data is not None:
        (tmp_path / name).write_bytes(data)
    with pytest.raises(BrailleError, match=words):
        load(tmp_path / name)


@pytest.mark.parametrize("text", ["", "  ", "\n\n", "⠀"])
def test_nothing_to_read(load, text):
    with pytest.raises(BrailleError, match="nothing to read"):
        load(text)


def test_a_folder(load, tmp_path):
    (tmp_path / "a.brf").mkdir()
    with pytest.raises(BrailleError, match="is a folder"):
        load(tmp_path / "a.brf")


def test_files_that_cannot_be_written(tmp_path):
    with pytest.raises(BrailleError, match=r"a name that ends in \.brf, \.pef or \.txt"):
        write_cells(tmp_path / "a.doc", [["⠁"]])
    with pytest.raises(BrailleError, match="cannot write"):
        write_cells(tmp_path / "none" / "a.brf", [["⠁"]])
