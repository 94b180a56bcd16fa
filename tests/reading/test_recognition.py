"""Recognition of text by Tesseract, rotation of pages to upright, and error messages."""

import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from PIL import Image, ImageDraw, ImageFont

from smarttouch.base.errors import ReadingError
from smarttouch.pages.page_and_lines import Page
from smarttouch.pages.prepared_page import prepare_text, print_text
from smarttouch.reading.legibility import character_error_rate
from smarttouch.reading.recognition import (
    BLOCK,
    RecognitionOptions,
    recognize,
    recognize_lines,
    recognized_lines,
    upright_page,
)

from ..support.checks import raises
from ..support.full import sample

needs_tesseract = pytest.mark.skipif(
    shutil.which("tesseract") is None, reason="needs Tesseract: apt install tesseract-ocr"
)
FONT = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSerif.ttf"
TEXT = """The harbor master kept 3 ledgers: one for ships,
one for their cargoes, and a third (which nobody
had ever seen) for the weather of the day before.
"Fog again," he wrote on 14 March 1893, at dusk;
then he closed the book and lit the green lamp.""".splitlines()
OPTIONS = RecognitionOptions()


def printed(lines, height=36):
    """Return an image of lines, black on white, `height` pixels from ascender to descender."""
    face = ImageFont.truetype(str(FONT), height * 3 // 4)
    width = max(int(face.getlength(line)) for line in lines)
    sheet = Image.new("L", (width + 2 * height, (len(lines) + 1) * height * 5 // 4), 255)
    for index, line in enumerate(lines):
        place = (height, height // 2 + index * height * 5 // 4)
        ImageDraw.Draw(sheet).text(place, line, fill=10, font=face)
    return np.asarray(sheet)


def strip(text):
    """Return an image of one line, cropped to the height of its letters."""
    page = printed([text])
    inked = np.flatnonzero((page < 255).any(axis=1))
    return page[inked[0] : inked[-1] + 1]


def row(text, place=(1, 1, 1), confidence=90, image=1):
    """Return the row of a word in Tesseract's output; ``place`` is (block, paragraph, line)."""
    return "\t".join(map(str, (5, image, *place, 1, 0, 0, 9, 9, confidence, text)))


@pytest.fixture
def program(tmp_path, monkeypatch):
    """Return a function that installs a shell script under the name ``tesseract``."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", f"{folder}:/usr/bin:/bin")

    def make(script, table=()):
        (tmp_path / "table").write_text("\n".join(["level\tpage_num\ttext", *table]) + "\n")
        script = script.replace("TABLE", str(tmp_path / "table"))
        (folder / "tesseract").write_text(f"#!/bin/sh\n{script}\n")
        (folder / "tesseract").chmod(0o755)

    return make


@pytest.fixture
def spotted():
    image = np.full((40, 400), 255, np.uint8)
    image[10:20, 30:50] = 0
    return image


def test_words_become_lines(program, spotted):
    table = [
        "4\t1\t1\t1\t1\t0\t5\t5\t90\t20\t-1\t", row("Two", (1, 1, 1), 80),
        row("words", (1, 1, 1), 96), row('"quoted"', (1, 1, 2), 50), row("  ", (1, 1, 3), 95),
        row("next", (1, 2, 1)), row("block", (2, 1, 1)),
    ]  # fmt: skip
    program("cat > /dev/null; cat TABLE", table)
    assert recognize(spotted) == 'Two words\n"quoted"\nnext\nblock'
    sure = (3 * 0.80 + 5 * 0.96 + 8 * 0.50 + 9 * 0.90) / 25
    assert recognize_lines([spotted]) == [('Two words "quoted" next block', pytest.approx(sure))]


@pytest.mark.parametrize(("words", "text"), [
    (["点字", "を", "読む"], "点字を読む"), (["点字", "2", "級", "です"], "点字 2 級です"),
    (["한국어", "점자"], "한국어 점자"),
])  # fmt: skip
def test_only_chinese_and_japanese_need_no_spaces(program, spotted, words, text):
    program("cat > /dev/null; cat TABLE", [row(word) for word in words])
    assert recognize(spotted) == text


def test_words_go_to_their_strips(program, spotted):
    blank, empty = np.full((40, 90), 255, np.uint8), np.zeros((0, 5), np.uint8)
    program("cat > /dev/null; cat TABLE", [row("first"), row("last", image=2)])
    lines = recognize_lines([spotted, blank, empty, spotted])
    assert lines == [("first", 0.9), ("", 0), ("", 0), ("last", 0.9)]


def test_a_program_may_end_while_tesseract_works(program, tmp_path):
    # The pause lets a busy computer register the function that kills Tesseract at exit.
    program(f"sleep 0.5; touch {tmp_path}/started; exec sleep 60")
    lines = [
        "import atexit, pathlib, threading, time, numpy as np",
        "from smarttouch.reading.recognition import recognize",
        "threading.Thread(target=recognize, args=[np.eye(40, 400, dtype=np.uint8)]).start()",
        f"while not pathlib.Path('{tmp_path}/started').exists(): time.sleep(0.01)",
        "atexit._run_exitfuncs()",
    ]
    start_s = time.monotonic()
    subprocess.run([sys.executable, "-c", "\n".join(lines)], capture_output=True, check=False)
    assert time.monotonic() - start_s < 40


def test_how_the_program_is_called(program, spotted, tmp_path):
    program(f'cat > {tmp_path}/given; echo "$OMP_THREAD_LIMIT $*" > {tmp_path}/told; cat TABLE')
    recognize(spotted, languages="eng+deu", layout=BLOCK)
    told = (tmp_path / "told").read_text().strip()
    assert told == "1 stdin stdout -l eng+deu --psm 6 tsv"
    # An image that is 64,000 pixels wide is reduced, because Tesseract rejects such images.
    recognize(np.repeat(spotted, 160, axis=1))
    with Image.open(tmp_path / "given") as given:
        assert given.size == (32_000, 20)


@pytest.mark.parametrize("image", [np.zeros((50, 50)), np.full((9, 9), 255), np.zeros((0, 7))])
def test_blank_images_have_no_text_and_need_no_program_to_run(program, image):
    program("exit 1")
    assert recognize(image.astype(np.uint8)) == ""


@pytest.mark.parametrize(("script", "value", "ending"), [
    ("echo first >&2; echo too bad >&2; exit 3", 3, ": too bad"), ("kill -9 $$", -9, ""),
    ("exec sleep 20", 0.3, ""),
    ("echo \"Failed loading language 'chi_sim'\" >&2; cat TABLE", "chi_sim",
     "apt install tesseract-ocr-chi-sim"),
])  # fmt: skip
def test_failures(program, spotted, script, value, ending):
    """The message ends with the last line of Tesseract's error, or with the package to install."""
    program(script)
    with raises(ReadingError, value=value) as caught:
        recognize(spotted, timeout_s=0.3)
    assert str(caught.value).endswith(ending)


def test_a_file_that_is_no_program(program, spotted, tmp_path):
    program("")
    (tmp_path / "bin" / "tesseract").write_text("a text")
    with raises(ReadingError, value=tmp_path / "bin" / "tesseract"):
        recognize(spotted)


def test_without_tesseract_a_page_stays_as_it_is(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ReadingError, match="apt install tesseract-ocr"):
        recognize(np.eye(9, dtype=np.uint8))
    page = Page(print_text("Some words\non a page").grey, 0.1)
    assert len(upright_page(1, page, OPTIONS, pytest.fail).lines) == 2


@pytest.mark.parametrize("codes", ["", "eng,deu", "eng+", "-l", "../eng"])
def test_codes_that_are_none(spotted, codes):
    with raises(ReadingError, value=codes):
        recognize(spotted, languages=codes)


@needs_tesseract
def test_strips_are_read_in_one_call_as_they_are_one_by_one():
    shapes = [(1, 1), (3, 3), (1, 500), (200, 2), (2, 40_000)]
    odd = [np.full(shape, 255, np.uint8) for shape in shapes]
    for image in odd:
        image.flat[:1] = 0
    strips = [strip(text) for text in TEXT]
    lines = recognize_lines([strips[0], *odd, *strips[1:]])
    read = [lines[0], *lines[6:]]
    assert character_error_rate("\n".join(TEXT), "\n".join(text for text, _ in read)) < 0.01
    assert [read[2]] == recognize_lines([strips[2]])
    assert character_error_rate(" ".join(TEXT), recognize(printed(TEXT))) < 0.02


@needs_tesseract
def test_a_language_that_is_not_there():
    with raises(ReadingError, value="qqq"):
        recognize(printed(["text"]), languages="eng+qqq")


@needs_tesseract
@pytest.mark.parametrize(("text", "turns"), sample([
    (text, turns)
    for text in ("Platform 8", "A page is a quiet place.\nRest one finger on a line",
                 "\n".join(TEXT))
    for turns in range(4)
], 6))  # fmt: skip
def test_a_page_is_turned_as_it_should_be(text, turns):
    notes = []
    grey = np.ascontiguousarray(np.rot90(print_text(text).grey, turns))
    prepared = upright_page(3, Page(grey, 0.1), OPTIONS, notes.append)
    assert any(note.startswith("page 3:") and "°" in note for note in notes) == (turns > 0)
    lines = [words for _, words in recognized_lines(prepared, OPTIONS, notes.append)]
    assert character_error_rate(text, " ".join(lines)) < 0.05


@needs_tesseract
def test_a_turn_after_which_less_is_recognized_is_not_kept():
    """Tesseract reports with confidence that this upright table of numbers is upside down."""
    page = Page(print_text("\n".join(f"{k} 17 {k}{k} 20 {k}4" for k in range(1, 9))).grey, 0.1)
    prepared = upright_page(1, page, OPTIONS, pytest.fail)
    np.testing.assert_array_equal(prepared.page.grey, page.grey)


def test_only_what_is_not_known_is_recognized_and_doubts_are_reported(program):
    page, notes = prepare_text("x\ny\nz"), []
    assert list(recognized_lines(page, OPTIONS, pytest.fail)) == [(0, "x"), (1, "y"), (2, "z")]
    # Only the unknown third line goes to Tesseract, which recognizes it with 30 % confidence.
    program("cat > /dev/null; cat TABLE", [row("scrawl", confidence=30)])
    page = replace(page, words=(), known={0: ("one", 0.3), 1: ("two", 0.3)})
    lines = recognized_lines(page, OPTIONS, notes.append)
    assert list(lines) == [(0, "one"), (1, "two"), (2, "scrawl")]
    (note,) = notes
    assert "30%" in note
    assert "eng" in note
