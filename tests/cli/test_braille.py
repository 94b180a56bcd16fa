"""``braille``: texts to cells and back, on the screen and in files."""

import pytest

from smarttouch.braille import louis


@pytest.fixture
def braille(program_here):
    """Return a runner of ``braille`` that gives what it printed."""

    def run(*arguments):
        done = program_here("braille", *arguments)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


def test_a_text_and_back(braille):
    cells = braille("Hello World, again")
    assert cells == "⠠⠓⠑⠇⠇⠕⠀⠠⠺⠕⠗⠇⠙⠂⠀⠁⠛⠁⠊⠝\n"
    assert braille(cells, "--back") == "Hello World, again\n"
    assert braille("Hello World", "--columns=7") == "⠠⠓⠑⠇⠇⠕\n⠠⠺⠕⠗⠇⠙\n"


@pytest.mark.parametrize("suffix", ["brf", "pef"])
def test_files(braille, tmp_path, suffix):
    text = "One two three four.\n\nFive, SIX, seven.\n"
    (tmp_path / "story.txt").write_text(text)
    said = braille("story.txt", f"--output=story.{suffix}", "--columns=12", "--rows=3")
    assert said == f"story.{suffix}: pages 2, lines 6\n"
    assert braille(f"story.{suffix}", "--back") == text
    braille(f"story.{suffix}", "--back", "--output=again.txt")
    assert (tmp_path / "again.txt").read_text() == text
    shown = braille(f"story.{suffix}")
    braille(f"story.{suffix}", "--output=cells.txt")
    assert (tmp_path / "cells.txt").read_text() == shown
    assert shown.startswith("⠀⠀⠠⠕⠝⠑⠀⠞⠺⠕\n⠞⠓⠗⠑⠑⠀⠋⠕⠥⠗⠲\n")


def test_tables(braille):
    listed = braille("--tables")
    assert "en-1 (default)" in listed
    assert "Japanese, kana" in listed
    assert "liblouis" in listed


def test_left_out(program_here):
    done = program_here("braille", "a中", "--leave-out")
    assert done.stdout == "⠁\n"
    assert "left out, as table en-1 has no cells for them: 中" in done.stderr


def test_without_liblouis(program_here, monkeypatch):
    monkeypatch.setattr(louis, "_library", lambda: None)
    done = program_here("braille", "hello")
    assert done.stdout == "⠓⠑⠇⠇⠕\n"
    assert "built-in English grade 1" in done.stderr
    assert "only en-1 and ja work" in program_here("braille", "--tables").stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "nothing to read is given"),
        (["none.brf"], "no file none.brf"),
        (["a", "--table=xx"], "unknown table 'xx'"),
        (["a中"], "no cells for '中'"),
        (["a", "--columns=1"], "a page of 1 x 25 cells is too small"),
        (["a", "--columns=0"], "a page of 0 x 25 cells is too small"),
        (["a", "--rows=-1"], "a page of 40 x -1 cells is too small"),
        (["a", "--output=a.doc"], "ends in .brf, .pef or .txt"),
        (["a", "--output=none/a.brf"], "cannot write none/a.brf"),
        (["⡀", "--output=a.brf"], "has dots 7 or 8"),
        (["⠁", "--back", "--output=a.brf"], "ends in .txt"),
    ],
)
def test_bad_input(program_here, arguments, words):
    done = program_here("braille", *arguments)
    assert done.returncode == 2
    assert words in done.stderr
    assert done.stderr.count("\n") == 1 + ("liblouis is not here" in done.stderr)
