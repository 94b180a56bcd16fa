"""Reading material: texts, images, documents and files of Braille cells."""

import shutil

import numpy as np
import pytest
from PIL import Image

from smarttouch.base.errors import PageError, ReadingError
from smarttouch.imaging.reading_profile import profile_for_reading
from smarttouch.pages.prepared_page import print_text
from smarttouch.profile import load_profile
from smarttouch.reading.braille_lines import Braille
from smarttouch.reading.letter_shapes import Shapes
from smarttouch.reading.reading_material import ReadingMaterial, parse_pages
from smarttouch.reading.recognition import RecognitionOptions

from ..support.checks import raises


@pytest.fixture
def notes():
    return []


@pytest.fixture
def source_of(tmp_path, notes):
    """Return a function that opens a source. If pages are given, it first prints them to a file."""

    def make(name, *pages, **how):
        if pages:
            images = [
                Image.fromarray(
                    print_text(each).grey if each else np.full((700, 1000), 235, np.uint8)
                )
                for each in pages
            ]
            images[0].save(tmp_path / name, save_all=True, append_images=images[1:])
            name = str(tmp_path / name)
        return ReadingMaterial(name, RecognitionOptions(**how), notes.append)

    return make


def test_a_text_is_printed_and_fills_the_array(source_of, reading):
    lines = list(Shapes().lines(source_of("text:Three lines\nof print\nare deeper"), reading))
    assert [line.text for line in lines] == ["Three lines", "of print", "are deeper"]
    for line in lines:
        assert line.image.shape[0] == reading.optics.sensor_rows
        assert line.start_mm == -8
        assert line.end_mm > 40
    rows = np.flatnonzero((lines[-1].image < 128).any(axis=1))
    assert rows[0] <= 3
    assert rows[-1] >= reading.optics.sensor_rows - 4


@pytest.mark.parametrize("words", ["I", "HHH", "o", ".", "1 + 1 = 2"])
def test_nothing_is_too_short_to_be_felt(source_of, reading, words):
    (line,) = Shapes().lines(source_of(f"text:{words}"), reading)
    assert (line.image < 128).any()


def test_few_rows_are_reported_and_fewer_are_refused(source_of, notes):
    four = profile_for_reading(load_profile("smarttouch-4x4"))
    assert list(Shapes().lines(source_of("text:hi"), four))
    (note,) = notes
    assert all(words in note for words in ("smarttouch-4x4", "4 rows", "Braille"))
    with raises(ReadingError, names="profile", value=1, allowed=4):
        list(Shapes().lines(source_of("text:hi"), profile_for_reading(load_profile("line-7"))))


def test_a_long_text_file_is_printed_in_parts(tmp_path):
    (tmp_path / "long.txt").write_text("\n".join(f"line number {each}" for each in range(30)))
    source = ReadingMaterial(str(tmp_path / "long.txt"))
    assert [len(page.lines) for page in source.prepared()] == [20, 10]


def test_pages_come_in_the_order_asked_for_and_blank_ones_are_reported(source_of, reading, notes):
    pages = "n", "", "wide wide wide", "", "words here"
    lengths = [
        line.end_mm
        for line in Shapes().lines(source_of("five.tif", *pages, pages=" 3 - 3,2,1,4-"), reading)
    ]
    assert len(lengths) == 3
    assert lengths[1] == min(lengths)
    assert notes[-1].endswith("page 2, 4")


@pytest.mark.parametrize(
    "text", ["", "one", "-3", "²", "1" * 5000, "1,,2", "0", "1,13", "3-999999999", "5-3"]
)
def test_what_is_no_page(text):
    with pytest.raises(PageError, match=r"the document has pages 1 to 12, not .*: write 1,3-5"):
        parse_pages(text, 12)


def test_where_nothing_is_found_that_is_the_error(source_of, reading):
    for kind in (Shapes(), Braille()):
        with pytest.raises(ReadingError, match="no line of text"):
            list(kind.lines(source_of("two.tif", "", ""), reading))


@pytest.mark.skipif(shutil.which("tesseract") is None, reason="needs Tesseract")
def test_paragraphs_are_put_together_across_pages(source_of):
    text = "Some words that are di-\nvided by a line, and\nmore of them"
    rest = (
        "follow on the next page.\n\n"
        "Another paragraph of it\nwhich fills all of its\nlines and ends."
    )
    source = source_of("two.tif", text, rest)
    assert source.paragraphs(lambda _: None) == [
        "Some words that are divided by a line, and more of them follow on the next page.",
        "Another paragraph of it which fills all of its lines and ends.",
    ]


def test_words_and_cells_are_distinguished(tmp_path, reading):
    (tmp_path / "a.brf").write_bytes(b"AB\r\n")
    (tmp_path / "a.txt").write_text("ab")
    assert ReadingMaterial(str(tmp_path / "a.brf")).holds_cells
    assert ReadingMaterial(str(tmp_path / "a.brf")).words is None
    assert ReadingMaterial(str(tmp_path / "a.txt")).words == "ab"
    assert ReadingMaterial("text:it is in a.brf").words == "it is in a.brf"
    assert not ReadingMaterial("text:it is in a.brf").holds_cells
    with raises(ReadingError, allowed="Braille"):
        list(Shapes().lines(ReadingMaterial(str(tmp_path / "a.brf")), reading))
