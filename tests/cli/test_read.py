"""Tests of ``smarttouch read`` and of the legibility of pages."""

import itertools
import json
import os
import shutil
import time
from pathlib import Path

import joblib
import numpy as np
import pytest
from PIL import Image

from smarttouch.base.errors import (
    BrailleError,
    PageError,
    ReadingError,
    SmartTouchError,
)
from smarttouch.braille.code_tables import open_table
from smarttouch.pages.prepared_page import print_text
from smarttouch.running.recording_reader import RecordedRun

from ..braille.drawn_dots import draw_dots
from .conftest import panels, refused, says

needs_tesseract = pytest.mark.skipif(
    shutil.which("tesseract") is None, reason="needs Tesseract: apt install tesseract-ocr"
)


@pytest.fixture(autouse=True)
def in_this_process():
    """Let joblib run all jobs in this process, because starting worker processes takes longer."""
    with joblib.parallel_config("sequential"):
        yield


@pytest.fixture
def page_file(tmp_path):
    """Return an image file of a page with two lines, without a stated resolution."""
    path = tmp_path / "page.png"
    Image.fromarray(print_text("a thin\nlight beam").grey).save(path)
    return path


@pytest.mark.parametrize(("more", "level"), [
    ("", 0.7), ("--intensity 0.9", 0.9), ("--as braille", 1.0), ("--mode SAI", 1.0),
])  # fmt: skip
def test_letters_begin_at_the_level_of_a_finger_of_unknown_level(program_here, more, level):
    done = program_here(
        f"read text:i --board memory: --plain --pause 0 --seconds 0.2 {more}"
    ).fine()
    assert f"0.0 s: intensity {level:.2f}" in done.stdout.splitlines()


def test_an_image_without_a_board(program_here, tmp_path):
    Image.fromarray(print_text("a\nbeam").grey).save(tmp_path / "small.png")
    kept = "--felt felt.png --set finger=paper --json f.json"
    done = program_here(f"read small.png --set paced=no {kept}").fine()
    assert done.stderr.strip() == ""
    assert done.figures["ended"] == "end of the text"
    # The panels show the page, the delivered current and the spikes. All must look alike.
    above, delivered, felt = panels(tmp_path / "felt.png", 3)
    assert np.corrcoef(above.ravel(), delivered.ravel())[0, 1] > 0.7
    assert np.corrcoef(above.ravel(), felt.ravel())[0, 1] > 0.4


def test_what_was_read_replays_to_the_bit_and_is_felt_once_more(program_here, figures_of):
    read = figures_of("read text:ab --as braille --set paced=no --record run.mcap")
    program_here("replay run.mcap --check").fine()
    assert figures_of("replay run.mcap --board simulated:")["slots"] == read["slots"] > 0


@pytest.mark.long
@needs_tesseract
def test_legibility_of_a_page(program_here, tmp_path, page_file):
    (tmp_path / "truth.txt").write_text("a thin light beam")
    done = program_here(f"simulate page {page_file} --truth truth.txt --json f.json").fine()
    figures = done.figures
    assert figures["page_error_rate"] <= 0.06  # at most one wrong character of 17
    assert figures["character_error_rate"] <= 0.2
    assert (figures["rows"], figures["lines"]) == (8, 2)
    assert figures["text"] in done.stdout


@pytest.mark.parametrize(("arguments", "wrong"), [
    ("nofile.png", says(BrailleError, value=Path("nofile.png"))),
    ("'text: '", says(PageError, "text:")),
    ("text:hi --as dots", says(value="dots", allowed=("shapes", "braille"))),
    ("text:hi --profile line-7", says(ReadingError, "line-7", " 1 row ", " 4:")),
    ("text:hi --as braille --profile line-8", says(ReadingError, "line-8", " 1 x 8 ", " 3 x 3:")),
    ("text:hi --pause -1", says(ReadingError, value=-1, allowed=(0, 3600))),
    ("page.png?pages=3", says(PageError, "pages 1 to 1", value=3)),
])  # fmt: skip
def test_bad_input_is_one_sentence(program_here, page_file, arguments, wrong):
    wrong(refused(program_here(f"read {arguments} --board simulated:")))


def test_a_picture_of_braille_is_refused_and_shown_by_live(program_here, figures_of, tmp_path):
    cells = open_table("en-1").to_cells("Raised\ndots of\na page").split("\n")
    Image.fromarray(draw_dots(cells)).save(tmp_path / "dots.png", dpi=(150, 150))
    for command in ("read", "read --as braille", "braille", "simulate page"):
        says(PageError, "page 1", "Braille", ".brf")(refused(program_here(command, "dots.png")))
    assert figures_of("live page:dots.png --set paced=no --seconds 1")["slots"] > 0


def lines_of(path):
    """Return the line under the finger in each step of a recording, which can be unfinished."""
    try:
        heights = [recorded.step.input.pose.y_mm for recorded in RecordedRun(path).steps()]
    except SmartTouchError:
        return []
    return [round(each / 20) for each in heights]


def test_at_a_terminal_keys_go_from_line_to_line(start_at_a_terminal, tmp_path):
    process, keys = start_at_a_terminal(
        "read", "text:one\ntwo\nthree\nfour", "--as", "braille", "--pause", "inf",
        "--record", "run.mcap", "--json", "f.json",
    )  # fmt: skip
    for key, line in ((b"", 0), (b"\x1b[C", 1), (b"\x1b[C", 2), (b"\x1b[D", 1)):
        os.write(keys, key)
        until = time.monotonic() + 60
        while lines_of(tmp_path / "run.mcap")[-1:] != [line] and time.monotonic() < until:
            time.sleep(0.05)
    os.write(keys, b" q")
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (0, "")
    assert json.loads((tmp_path / "f.json").read_text())["ended"] == "key q"
    lines = lines_of(tmp_path / "run.mcap")
    assert [line for line, _ in itertools.groupby(lines)] == [0, 1, 2, 1]


def test_plain_prints_the_words_of_each_line_and_what_was_read(program_here):
    done = program_here("read 'text:one\ntwo' --plain --set paced=no").flawless()
    said = [line.partition(" s: ")[2] for line in done.stdout.splitlines()]
    assert [each for each in said if ", line " in each] == [
        "a text, line 1 of 2: one", "a text, line 2 of 2: two",
    ]  # fmt: skip
    *_, ended, read, more = done.stdout.splitlines()
    assert ended.startswith("Ended ")
    assert read == "2 lines read: one / two"
    assert more
