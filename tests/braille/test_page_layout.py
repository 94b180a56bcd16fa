"""Layout of Braille paragraphs on pages of limited size, and joining of lines to paragraphs."""

from itertools import pairwise

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from smarttouch.base.errors import BrailleError
from smarttouch.braille.page_layout import join, lay_out

from ..support.checks import raises

WORDS = st.text(st.sampled_from("⠁⠃⠿⠐"), min_size=1, max_size=12)
PARAGRAPHS = st.lists(st.lists(WORDS, max_size=8).map("⠀".join), max_size=6)


@given(PARAGRAPHS, st.integers(4, 20), st.integers(1, 6))
@example(["⠁⠐"], 4, 1)
@example(["⠁⠃⠁⠐", "⠁"], 6, 1)
@example(["⠐⠐⠐⠐⠐⠐"], 4, 1)
def test_pages_hold_lines_and_give_the_paragraphs_back(paragraphs, columns, rows):
    pages = lay_out(paragraphs, columns, rows)
    assert all(len(line) <= columns for page in pages for line in page)
    assert all(len(page) == rows for page in pages[:-1])
    assert all(0 < len(page) <= rows for page in pages)
    assert join(pages, columns) == paragraphs


@given(st.lists(st.text("⠁⠃", min_size=1, max_size=9)), st.integers(9, 20))
def test_no_line_ends_before_it_must(words, columns):
    lines = [line for page in lay_out(["⠀".join(words)], columns, indent=0) for line in page]
    assert "⠀".join(lines).split("⠀") == (words or [""])
    for line, following in pairwise(lines):
        assert len(line) + 1 + len(following.split("⠀")[0]) > columns


def test_words_wrap_and_long_ones_go_on():
    pages = lay_out(["⠁⠁⠀⠃⠃⠃⠀⠉⠉", "", "⠙⠙⠙⠙⠙⠙⠙⠙⠙⠙⠙⠙⠙⠙⠀⠑"], columns=8, rows=3)
    assert pages == [["⠀⠀⠁⠁⠀⠃⠃⠃", "⠉⠉", ""], ["⠀⠀⠙⠙⠙⠙⠙⠐", "⠙⠙⠙⠙⠙⠙⠙⠐", "⠙⠙⠀⠑"]]


def test_lines_of_others_join():
    pages = [["⠀⠀⠁", "⠃"], ["⠉", "", "⠙", "⠑", "⠀⠀⠋"]]
    assert join(pages) == ["⠁⠀⠃⠀⠉", "", "⠙⠀⠑", "⠋"]


@pytest.mark.parametrize(("columns", "rows", "indent"), [(3, 5, 2), (1, 5, 0), (40, 0, 2)])
def test_too_small_a_page(columns, rows, indent):
    with raises(BrailleError, value=(columns, rows), allowed=(indent + 2, 1)):
        lay_out(["⠁"], columns, rows, indent)


def test_two_blanks_in_a_line_stay():
    assert lay_out(["⠁⠀⠀⠃"], 8, indent=0) == [["⠁⠀⠀⠃"]]
    assert lay_out(["⠁⠁⠁⠀⠀⠃"], 5, indent=0) == [["⠁⠁⠁", "⠃"]]
