"""Pages are turned upright, recognized piece by piece, and their paragraphs put together."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from smarttouch.pages.page_image import Page
from smarttouch.pages.prepared_page import prepare_text, print_text
from smarttouch.reading import recognition
from smarttouch.reading.legibility import character_error_rate
from smarttouch.reading.material import recognized_text
from smarttouch.reading.ocr import RecognizedLine
from smarttouch.reading.recognition import RecognitionOptions, recognized_lines, upright_page

TEXT = "Some words that are di-\nvided by a line, and\nmore of them\n\nanother paragraph"


class Reads:
    """Stands for Tesseract: knows what the lines say, in order."""

    def __init__(self, lines, confidence=0.9):
        self.lines, self.confidence, self.pieces = list(lines), confidence, []

    def __call__(self, strips, languages):
        self.pieces.append(len(strips))
        return iter([RecognizedLine(self.lines.pop(0), self.confidence) for _ in strips])


@pytest.fixture
def notes():
    return []


@pytest.fixture
def tesseract(monkeypatch):
    """Return a setter of what Tesseract reads."""

    def reads(text, **more):
        stands = Reads([line for line in text.split("\n") if line], **more)
        monkeypatch.setattr(recognition, "recognize_lines", stands)
        return stands

    return reads


def printed(text):
    """Return a printed page whose words are not known, as of a scan."""
    return replace(prepare_text(text), words=())


def test_words_that_a_page_brings_are_not_recognized(tesseract, notes):
    stands = tesseract("other words")
    lines = recognized_lines(prepare_text("x\ny"), RecognitionOptions(), notes.append)
    assert list(lines) == [(0, "x"), (1, "y")]
    assert (stands.pieces, notes) == ([], [])


def test_paragraphs_are_put_together_and_divided_words_joined(tesseract, notes):
    tesseract(TEXT)
    text = recognized_text(printed(TEXT), RecognitionOptions(), notes.append)
    assert text == "Some words that are divided by a line, and more of them\nanother paragraph"
    assert notes == []


def test_lines_that_are_known_are_not_recognized_again(tesseract, notes):
    stands = tesseract("three")
    page = replace(printed("x\ny\nz"), known={0: ("one", 0.9), 1: ("two", 0.9)})
    lines = recognized_lines(page, RecognitionOptions(), notes.append)
    assert list(lines) == [(0, "one"), (1, "two"), (2, "three")]
    assert stands.pieces == [1]


def test_what_is_hardly_recognized_is_reported(tesseract, notes):
    tesseract("scrawl", confidence=0.3)
    assert list(recognized_lines(printed("x"), RecognitionOptions(), notes.append)) == [
        (0, "scrawl")
    ]
    assert len(notes) == 1
    assert "30%" in notes[0]
    assert "eng" in notes[0]


needs_tesseract = pytest.mark.skipif(
    shutil.which("tesseract") is None, reason="needs Tesseract: apt install tesseract-ocr"
)
QUIET = "A page is a quiet place.\nRest one finger on a line"


@needs_tesseract
@pytest.mark.parametrize("turns", range(4))
def test_a_page_is_turned_as_it_should_be(notes, turns):
    grey = np.ascontiguousarray(np.rot90(print_text(QUIET).grey, turns))
    prepared = upright_page(3, Page(grey, 0.1), RecognitionOptions(), notes.append)
    assert any(note.startswith("page 3:") and "°" in note for note in notes) == (turns > 0)
    text = recognized_text(prepared, RecognitionOptions(), notes.append)
    assert character_error_rate(QUIET.replace("\n", " "), text) < 0.05


@needs_tesseract
def test_a_turn_after_which_less_is_recognized_is_not_kept(monkeypatch, notes):
    """As Tesseract proposes for some tables of figures, with confidence."""
    monkeypatch.setattr(recognition, "likely_turns", lambda *_: [90, 180])
    figures = "\n".join(f"{k} 17 {k}{k} 20 {k}4" for k in range(1, 9))
    page = print_text(figures)
    prepared = upright_page(1, page, RecognitionOptions(), notes.append)
    np.testing.assert_array_equal(prepared.page.grey, page.grey)
    assert notes == []


def test_without_tesseract_a_page_stays_as_it_is(monkeypatch, notes, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    prepared = upright_page(
        1, print_text("Some words\non a page"), RecognitionOptions(), notes.append
    )
    assert len(prepared.lines) == 2
    assert notes == []
