"""Tests of ``smarttouch braille``: text to cells and back, printed and in files."""

import os
import re
import subprocess
from pathlib import Path

import pytest

from smarttouch.base.errors import BrailleError
from smarttouch.braille import louis
from smarttouch.braille.code_tables import DEFAULT_TABLE, known_tables

from ..support.processes import PROGRAM, Forked
from .conftest import says


@pytest.fixture
def braille(program_here):
    """Return a function that runs ``braille`` and returns its output."""

    def run(*arguments):
        done = program_here("braille", *arguments).fine()
        return done.stdout

    return run


def test_a_text_and_back(braille):
    cells = braille("Hello World, again")
    assert cells == "⠠⠓⠑⠇⠇⠕⠀⠠⠺⠕⠗⠇⠙⠂⠀⠁⠛⠁⠊⠝\n"
    assert braille(cells, "--back") == "Hello World, again\n"
    assert braille("Hello World", "--columns=7") == "⠠⠓⠑⠇⠇⠕\n⠠⠺⠕⠗⠇⠙\n"


@pytest.mark.parametrize(("encoding", "printed"), [
    ("latin-1", ",HELLO #B\n"), ("utf-8", "⠠⠓⠑⠇⠇⠕⠀⠼⠃\n"),
])  # fmt: skip
def test_an_output_without_cells_gets_ascii_braille(encoding, printed):
    environment = {**os.environ, "PYTHONIOENCODING": encoding}
    command = [PROGRAM, "braille", "Hello 2"]
    with Forked(command, env=environment, stdout=subprocess.PIPE) as program:
        assert program.communicate()[0].decode(encoding) == printed


def test_a_brf_file(braille, tmp_path):
    text = "One two three four.\n\nFive, SIX, seven.\n"
    (tmp_path / "story.txt").write_text(text)
    said = braille("story.txt", "--output=story.brf", "--columns=12", "--rows=3")
    assert said == "story.brf: pages 2, lines 6\n"
    assert braille("story.brf", "--back") == text
    assert braille("story.brf").startswith("⠀⠀⠠⠕⠝⠑⠀⠞⠺⠕\n⠞⠓⠗⠑⠑⠀⠋⠕⠥⠗⠲\n")
    assert braille("story.brf", "--columns=30").startswith("⠠⠕⠝⠑⠀⠞⠺⠕⠀⠞⠓⠗⠑⠑⠀⠋⠕⠥⠗⠲\n")


def test_tables(braille):
    listed = braille("--tables").splitlines()
    names = [line.split()[0] for line in listed[1:-1]]
    assert [name for name in names if name in known_tables()] == list(known_tables())
    assert [line.split()[0] for line in listed if "(default)" in line] == [DEFAULT_TABLE]
    assert "liblouis" in listed[-1]


@pytest.mark.skipif(louis.version() is None, reason=f"needs liblouis: {louis.INSTALL}")
@pytest.mark.parametrize("language", ["fr", "fra", "fr+en", "fr-CA"])
def test_a_language_names_the_table(braille, language):
    assert braille("été", "--language", language) == braille("été", "--table=fr-1") == "⠿⠞⠿\n"
    assert braille("été", "--language", language, "--table=en-1") == braille("été")


def test_characters_without_cells_are_named(program_here):
    done = program_here("braille a中").fine()
    assert done.stdout == "⠁\n"
    assert all(name in done.stderr for name in ("en-1", "中"))


def test_without_liblouis(program_here, monkeypatch):
    monkeypatch.setattr(louis, "_library", lambda: None)
    done = program_here("braille hello")
    assert done.stdout == "⠓⠑⠇⠇⠕\n"
    assert "liblouis" in done.stderr
    last = program_here("braille --tables").stdout.splitlines()[-1]
    assert [name for name in known_tables() if name in re.findall(r"[\w-]+", last)] == [
        "en-1",
    ]


@pytest.mark.parametrize(("arguments", "wrong"), [
    ("", says(BrailleError, "nothing to read")),
    ("none.brf", says(BrailleError, value=Path("none.brf"))),
    ("a --columns=1", says(BrailleError, " 1 x 25 cells", "2 columns")),
    ("a --output=a.ebrl", says(BrailleError, "a.ebrl", ".brf")),
    ("a --output=none/a.brf", says(value=Path("none/a.brf"))),
    ("a --output=old.brf", says(BrailleError, "old.brf", "new .brf file")),
    ("⠁ --back --output=a.brf", says(BrailleError, "a.brf", "redirect")),
])  # fmt: skip
def test_bad_input(program_here, tmp_path, arguments, wrong):
    (tmp_path / "old.brf").touch()
    done = program_here("braille", *arguments.split())
    assert done.returncode == 2
    wrong(done.error)
    # If liblouis is not installed, another line says so before the error.
    assert done.stderr.count("\n") == 1 + (louis.version() is None)
