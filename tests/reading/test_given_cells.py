"""Texts and files as they are given become cells."""

import pytest

from smarttouch.base.errors import BrailleError, PageError
from smarttouch.braille.brf import format_brf
from smarttouch.braille.code_tables import open_table
from smarttouch.reading.document_cells import document_cells
from smarttouch.reading.material import ReadingMaterial


@pytest.fixture
def notes():
    return []


@pytest.fixture
def load(notes):
    def load(name):
        material = ReadingMaterial(str(name), note=notes.append)
        return document_cells(material, open_table("en-1"), notes.append)

    return load


@pytest.mark.parametrize(("text", "paragraphs"), [
    ("Go\n\nthere", ["⠠⠛⠕", "", "⠞⠓⠑⠗⠑"]), ("⠁⠃ ⣿\n⠉", ["⠁⠃⠀⣿", "⠉"]),
])  # fmt: skip
def test_a_text_becomes_cells_and_cells_stay(load, text, paragraphs):
    assert load(f"text:{text}").paragraphs == paragraphs


def test_a_brf_file_keeps_its_pages_until_it_is_laid_out_anew(load, tmp_path):
    pages = [["⠀⠀⠁⠃", "⠉"], ["⠀⠀⠙"]]
    (tmp_path / "a.brf").write_bytes(format_brf(pages))
    cells = load(tmp_path / "a.brf")
    assert cells.paragraphs == ["⠁⠃⠀⠉", "⠙"]
    assert cells.laid_out(None, None) == pages
    assert cells.laid_out(10, 1) == [["⠀⠀⠁⠃⠀⠉"], ["⠀⠀⠙"]]


def test_characters_without_cells_are_left_out_and_named(load, notes):
    assert load("text:a中").paragraphs == ["⠁"]
    assert "en-1" in notes[-1]
    assert notes[-1].endswith("left out: 中")
    load("text:a" + "".join(map(chr, range(0x4E00, 0x4E20))))
    assert notes[-1].endswith("一, 丁, 丂, 七, 丄, 丅, 丆, 万, 丈, 三, 上, 下, …")


@pytest.mark.parametrize(("name", "data", "words"), [
    ("none.brf", None, "none.brf"), ("bad.txt", b"ab\xff", "bad.txt"),
    ("empty.txt", b"\n \n", "nothing"), ("empty.brf", b"", "empty"),
    ("bad.pef", b"<pef/>", ".brf"), ("bad.brf", b"\xff", "ÿ"),
])  # fmt: skip
def test_bad_files(load, tmp_path, name, data, words):
    if data is not None:
        (tmp_path / name).write_bytes(data)
    with pytest.raises((BrailleError, PageError), match=words):
        load(tmp_path / name)


@pytest.mark.parametrize("text", ["", "  ", "\n\n", "⠀", "中"])
def test_nothing_to_read(load, text):
    with pytest.raises(BrailleError, match="nothing to read"):
        load(f"text:{text}")
