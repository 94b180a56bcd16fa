"""Text comes back from images, and each way that it can fail has its sentence."""

import shutil
import subprocess
import sys
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from PIL import Image, ImageDraw, ImageFont

from smarttouch.base.errors import ReadingError
from smarttouch.reading.legibility import character_error_rate
from smarttouch.reading.ocr import (
    Layout,
    find_tesseract,
    likely_turns,
    recognize,
    recognize_lines,
)

from ..raising import raises
from ..whole import sample

needs_tesseract = pytest.mark.skipif(
    shutil.which("tesseract") is None, reason="needs Tesseract: apt install tesseract-ocr"
)
FONTS = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
TITLE = "level page_num block_num par_num line_num word_num left top width height conf text"
TEXT = """The harbor master kept 3 ledgers: one for ships,
one for their cargoes, and a third (which nobody
had ever seen) for the weather of the day before.
"Fog again," he wrote on 14 March 1893, at dusk;
then he closed the book and lit the green lamp.""".splitlines()


def printed(lines, height=36, font="DejaVuSerif.ttf"):
    """Return lines in black on white, `height` pixels from ascender to descender."""
    face = ImageFont.truetype(str(FONTS / font), height * 3 // 4)
    width = max(int(face.getlength(line)) for line in lines)
    sheet = Image.new("L", (width + 2 * height, (len(lines) + 1) * height * 5 // 4), 255)
    for index, line in enumerate(lines):
        place = (height, height // 2 + index * height * 5 // 4)
        ImageDraw.Draw(sheet).text(place, line, fill=10, font=face)
    return np.asarray(sheet)


def strip(text, height=36):
    """Return a line of print as tall as its letters are."""
    page = printed([text], height)
    inked = np.flatnonzero((page < 255).any(axis=1))
    return page[inked[0] : inked[-1] + 1]


def row(text, place=(1, 1, 1), box=(0, 0, 9, 9), confidence=90, image=1):
    """Return a row of a word in Tesseract's table."""
    return "\t".join(map(str, (5, image, *place, 1, *box, confidence, text)))


@pytest.fixture
def program(tmp_path, monkeypatch):
    """Return a maker of programs that take Tesseract's place."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", f"{folder}:/usr/bin:/bin")

    def make(script, table=()):
        (tmp_path / "table").write_text("\n".join([TITLE.replace(" ", "\t"), *table]) + "\n")
        script = script.replace("TABLE", str(tmp_path / "table"))
        (folder / "tesseract").write_text(f"#!/bin/sh\n{script}\n")
        (folder / "tesseract").chmod(0o755)

    return make


@pytest.fixture
def spotted():
    image = np.full((40, 400), 255, np.uint8)
    image[10:20, 30:50] = 0
    return image


def test_words_become_lines_and_paragraphs(program, spotted):
    table = [
        "4\t1\t1\t1\t1\t0\t5\t5\t90\t20\t-1\t", row("Two", (1, 1, 1), (5, 5, 30, 20), 80),
        row("words", (1, 1, 1), (45, 8, 50, 22), 96),
        row('"quoted"', (1, 1, 2), (5, 30, 60, 10), 50), row("  ", (1, 1, 3), confidence=95),
        row("next", (1, 2, 1)), row("block", (2, 1, 1)),
    ]  # fmt: skip
    program("cat > /dev/null; cat TABLE", table)
    assert recognize(spotted) == 'Two words\n"quoted"\n\nnext\n\nblock'
    (line,) = recognize_lines([spotted])
    sure = (3 * 0.80 + 5 * 0.96 + 8 * 0.50 + 9 * 0.90) / 25
    assert (line.text, line.confidence) == ('Two words "quoted" next block', pytest.approx(sure))


@pytest.mark.parametrize(("words", "text"), [
    (["点字", "を", "読む"], "点字を読む"), (["点字", "2", "級", "です"], "点字 2 級です"),
    (["한국어", "점자"], "한국어 점자"),
])  # fmt: skip
def test_only_chinese_and_japanese_need_no_spaces(program, spotted, words, text):
    program("cat > /dev/null; cat TABLE", [row(word) for word in words])
    assert recognize(spotted) == text


def test_words_go_to_their_strips(program, spotted):
    blank, empty = np.full((40, 90), 255, np.uint8), np.zeros((0, 5), np.uint8)
    table = [row("first", box=(0, 0, 900, 900)), row("last", box=(40, 15, 20, 30), image=2)]
    program("cat > /dev/null; cat TABLE", table)
    lines = list(recognize_lines([spotted, blank, empty, spotted]))
    assert [line.text for line in lines] == ["first", "", "", "last"]
    assert [line.confidence for line in lines] == [0.9, 0, 0, 0.9]


def test_lines_come_while_later_ones_are_recognized(program, spotted, tmp_path):
    """The program goes on only when the first line has arrived."""
    program(
        f"cat > /dev/null; head -3 TABLE; while [ ! -e {tmp_path}/arrived ]; do sleep .05; done; "
        "tail -1 TABLE",
        [row("first"), row("second", image=2), row("third", image=3)],
    )
    lines = recognize_lines([spotted] * 3)
    assert next(lines).text == "first"
    (tmp_path / "arrived").touch()
    assert [line.text for line in lines] == ["second", "third"]


def test_a_program_may_end_before_its_lines_do(program):
    program("cat > /dev/null; head -3 TABLE; exec sleep 60", [row("one"), row("two", image=2)])
    lines = [
        "import numpy as np",
        "from smarttouch.reading.ocr import recognize_lines",
        "lines = recognize_lines([np.eye(40, 400, dtype=np.uint8)] * 3)",
        "print(next(lines).text)",
        "raise SystemExit(3)",
    ]
    done = subprocess.run([sys.executable, "-c", "\n".join(lines)], capture_output=True)
    assert (done.returncode, done.stdout, done.stderr) == (3, b"one\n", b"")


def test_an_image_too_wide_for_tesseract_is_shrunk(program, tmp_path):
    wide = np.full((20, 64_000), 255, np.uint8)
    wide[5:9] = 0
    program(f"cat > {tmp_path}/given; cat TABLE", [row("far")])
    assert recognize(wide) == "far"
    with Image.open(tmp_path / "given") as given:
        assert given.size == (32_000, 10)


def test_the_arguments_of_the_program(program, spotted, tmp_path):
    program(f'cat > /dev/null; echo "$OMP_THREAD_LIMIT $*" > {tmp_path}/told; cat TABLE')
    recognize(spotted, languages="eng+deu", layout=Layout.BLOCK)
    told = (tmp_path / "told").read_text().strip()
    assert told == "1 stdin stdout -l eng+deu --psm 6 tsv"


@pytest.mark.parametrize("image", [np.zeros((50, 50)), np.full((9, 9), 255), np.zeros((0, 7))])
def test_blank_images_have_no_text_and_need_no_program_to_run(program, image):
    program("exit 1")
    image = image.astype(np.uint8)
    assert recognize(image) == ""
    assert likely_turns(image) == []


@pytest.mark.parametrize(
    ("script", "about", "value", "ending"),
    [
        ("echo first >&2; echo too bad >&2; exit 3", "tesseract", 3, ": too bad"),
        ("kill -9 $$", "tesseract", -9, ""),
        ("exec sleep 20", "tesseract", 0.3, ""),
        (
            "echo \"Failed loading language 'chi_sim'\" >&2; cat TABLE",
            "languages", "chi_sim", "apt install tesseract-ocr-chi-sim",
        ),
    ],
)  # fmt: skip
def test_failures(program, spotted, script, about, value, ending):
    """The message has the program's own words and the package to install."""
    program(script)
    with raises(ReadingError, value=value) as caught:
        recognize(spotted, timeout_s=0.3)
    assert str(caught.value).endswith(ending)


def test_a_file_that_is_no_program(program, spotted, tmp_path):
    program("")
    (tmp_path / "bin" / "tesseract").write_text("a text")
    with raises(ReadingError, value=tmp_path / "bin" / "tesseract"):
        recognize(spotted)


def test_no_orientation_in_time_is_none(program, spotted):
    program("exec sleep 20")
    assert likely_turns(spotted, timeout_s=0.1) == []


@pytest.mark.parametrize(
    "call", [find_tesseract, lambda: recognize(np.full((9, 9), 255, np.uint8))]
)
def test_without_tesseract(monkeypatch, tmp_path, call):
    monkeypatch.setenv("PATH", str(tmp_path))
    with raises(ReadingError):
        call()


@pytest.mark.parametrize("codes", ["", "eng,deu", "eng+", "-l", "../eng"])
def test_codes_that_are_none(spotted, codes):
    with raises(ReadingError, value=codes):
        recognize(spotted, languages=codes)


@needs_tesseract
def test_paragraphs_of_a_page():
    gap = np.full((150, 100), 255, np.uint8)
    parts = [printed(TEXT[:3]), printed(TEXT[3:])]
    width = max(part.shape[1] for part in parts)
    page = np.vstack(
        [
            np.pad(part, ((0, 0), (0, width - part.shape[1])), constant_values=255)
            for part in (parts[0], gap, parts[1])
        ]
    )
    before, after = recognize(page).rsplit("\n\n", 1)
    assert character_error_rate(" ".join(TEXT[:3]), before) < 0.02
    assert character_error_rate(" ".join(TEXT[3:]), after) < 0.02


@needs_tesseract
def test_strips_are_read_in_one_call_as_they_are_one_by_one():
    strips = [strip(text) for text in TEXT]
    lines = list(recognize_lines(strips))
    assert character_error_rate("\n".join(TEXT), "\n".join(line.text for line in lines)) < 0.01
    assert [lines[2]] == list(recognize_lines([strips[2]]))


@needs_tesseract
def test_odd_shapes_do_no_harm_to_their_neighbors():
    good = strip("in good order")
    shapes = [(1, 1), (3, 3), (1, 500), (200, 2), (2, 40_000)]
    odd = [np.full(shape, 255, np.uint8) for shape in shapes]
    for image in odd:
        image.flat[:1] = 0
    lines = list(recognize_lines([good, *odd, good]))
    assert [lines[0].text, lines[-1].text] == ["in good order"] * 2


@needs_tesseract
@pytest.mark.parametrize("turns", sample([0, 2, 1, 3]))
@pytest.mark.parametrize("lines", [TEXT, ["Platform 8"]])
def test_the_turn_that_makes_a_page_upright_is_among_the_likely_ones(lines, turns):
    assert likely_turns(np.rot90(printed(lines), turns)) == [90 * turns] * (turns > 0)


@needs_tesseract
def test_the_orientation_of_a_large_page_is_judged_where_its_text_is():
    page = np.full((6000, 4000), 255, np.uint8)
    text = printed(TEXT)
    page[4800 : 4800 + text.shape[0], 2500 : 2500 + text.shape[1]] = text
    assert likely_turns(np.rot90(page, 2)) == [180]


@needs_tesseract
def test_noise_has_no_orientation():
    noise = np.random.default_rng(3).integers(0, 256, (60, 90), dtype=np.uint8)
    assert likely_turns(noise) == []


@needs_tesseract
def test_a_language_that_is_not_there():
    with raises(ReadingError, value="qqq"):
        recognize(printed(["text"]), languages="eng+qqq")
