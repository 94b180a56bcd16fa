"""BRF files: writing and reading, files of other programs, and messages about bad bytes."""

import contextlib

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from smarttouch.base.errors import BrailleError
from smarttouch.braille.brf import format_brf, parse_brf, read_brf

from ..support.checks import raises

LINES = st.text(st.characters(min_codepoint=0x2800, max_codepoint=0x283F), max_size=45)
PAGES = st.lists(st.lists(LINES, min_size=1, max_size=5), max_size=4)


def test_letters_numbers_and_signs():
    pages = [["⠠⠓⠑⠇⠇⠕⠀⠼⠁⠃⠉⠲", "⠐⠣⠿⠵⠐⠜"], ["⠁"]]
    assert format_brf(pages) == b',HELLO #ABC4\r\n"<=Z">\r\n\fA\r\n'


def test_every_cell_has_a_code_of_its_own():
    cells = "".join(chr(0x2800 + k) for k in range(64))
    codes = format_brf([[cells]]).removesuffix(b"\r\n")
    assert sorted(codes) == list(range(0x20, 0x60))
    assert parse_brf(codes.lower()) == [[cells]]
    assert parse_brf(b"`{|}~") == parse_brf(b"@[\\]^")


@given(PAGES)
@example([[""], ["", "⠀"], ["", "⠁"]])
def test_what_is_written_is_read(pages):
    """Pages are unchanged except for blank lines and blank cells at the ends of lines."""
    lines, read = (
        [[line.rstrip("⠀") for line in page if line.strip("⠀")] for page in each]
        for each in (pages, parse_brf(format_brf(pages)))
    )
    assert list(filter(None, read)) == list(filter(None, lines))


@pytest.mark.parametrize("data", [
    b"  A\nB\fC", b"  A\r\nB\r\n\fC\r\n\f", b"  A\r\nB\r\n\fC\r\n\x1a",
    b"\xef\xbb\xbf  A\r\nB\r\n\fC",
    b"  A\r\nB\r\n\f\r\nC\r\n\f\r\n", b"  A\rB\r\fC\r", b"  A\r\nB\n\fC\r", b"\f  A\nB\x0c\nC",
    b"  A   \r\nB    \r\n    \r\n   \r\n\fC   \r\n\x1a\x1a\x1a",
    b"  A\nB\n\x00\x00\x00\fC\n\x00\x00",
    "  A\r\nB\r\n\fC".encode("utf-16"), "⠀⠀⠁\n⠃\n\f⠉\n".encode(), "\ufeff⠀⠀⠁\n⠃\n\f⠉\n".encode(),
    b"  A\r\nB\r\n        #AB\r\n\fC\r\n        #AC", b"    ,T     #I\n  A\nB\n\f    ,T    #AJ\nC",
    b"#A\n  A\nB\n\f#B\nC",
])  # fmt: skip
def test_files_of_others(tmp_path, data):
    (tmp_path / "a.brf").write_bytes(data)
    assert read_brf(tmp_path / "a.brf") == [["⠀⠀⠁", "⠃"], ["⠉"]]


@pytest.mark.parametrize(("data", "notes"), [
    (b"A\r\n      #AB\r\n\fB\r\n      #AC", 1),
    (b",MILL   #B\r\nA\r\n\f,MILL   #C\r\nA", 1),
    (b"A\r\n      #AB\r\n\fB\r\n      #AB", 0),
    (b"A\r\n      #AB\r\n", 0),
    (b"A #A\r\n\fB #B\r\n", 0),
])  # fmt: skip
def test_numbers_go_where_they_count_the_pages_and_are_named(tmp_path, data, notes):
    (tmp_path / "a.brf").write_bytes(data)
    said = []
    pages = read_brf(tmp_path / "a.brf", said.append)
    assert len(said) == notes
    assert ("⠼" in str(pages)) == (not notes)
    assert ("⠍" in str(said)) == ("⠍" not in str(pages) and b"MILL" in data)


@pytest.mark.parametrize(("data", "place", "kind"), [
    (b"A\r\n\fB\r\nC\xe9", "line 3, column 2", "byte 0xE9 is 'é'"), (b"A\n\tB", "line 2", "a tab"),
    (b"\x1bA", "line 1", "an escape sequence"), (b"A\x00B", "column 2", "a NUL"),
    (b"A\x1aB", "column 2", "^Z"), ("⠁é".encode(), "column 2", "'é'"),
])  # fmt: skip
def test_bad_codes_are_named(data, place, kind):
    with pytest.raises(BrailleError) as caught:
        parse_brf(data, "a.brf")
    assert str(caught.value).startswith("a.brf, line ")
    assert place in str(caught.value)
    assert kind in str(caught.value)


def test_eight_dots_do_not_fit():
    with raises(BrailleError, value="⡀") as caught:
        format_brf([["⠁"], ["⠁⡀"]])
    assert "cell 2" in str(caught.value)


@given(st.binary(max_size=200))
def test_no_bytes_crash_the_reader(data):
    with contextlib.suppress(BrailleError):
        assert all(0x2800 <= ord(c) < 0x2900 for page in parse_brf(data) for c in "".join(page))
