"""BRF: what is written is read, and what is no BRF gets one sentence."""

import contextlib

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from smarttouch.base.errors import BrailleError
from smarttouch.braille.cells import format_brf, parse_brf

from ..raising import raises

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
@example([[""], ["", "⠀"]])
def test_what_is_written_is_read(pages):
    assert parse_brf(format_brf(pages)) == pages


@pytest.mark.parametrize("data", [b"A\nB\fC", b"A\r\nB\r\n\fC\r\n\f", b"A\r\nB\r\n\fC\r\n\x1a"])
def test_files_of_others(data):
    assert parse_brf(data) == [["⠁", "⠃"], ["⠉"]]


def test_bad_codes_are_found():
    with raises(BrailleError, value="é") as caught:
        parse_brf(b"A\r\n\fB\r\nC\xe9", "a.brf")
    assert "a.brf, line 3, column 2" in str(caught.value)


def test_eight_dots_do_not_fit():
    with raises(BrailleError, value="⡀") as caught:
        format_brf([["⠁"], ["⠁⡀"]])
    assert "page 2, line 1, cell 2" in str(caught.value)


@given(st.binary(max_size=200))
def test_no_bytes_crash_the_reader(data):
    with contextlib.suppress(BrailleError):
        assert all(0x2800 <= ord(c) < 0x2840 for page in parse_brf(data) for c in "".join(page))
