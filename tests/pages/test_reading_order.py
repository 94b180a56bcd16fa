"""Columns are read one after another, headings before both."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.pages.text_lines import reading_order

LEFT, RIGHT, BOTH = (0, 40), (50, 90), (0, 90)


def order(*lines):
    """Order lines of (sides, y); 8 high."""
    sides, y = zip(*lines, strict=True)
    left, right = np.array(sides, float).T
    return reading_order(left, right, np.array(y, float), np.full(len(y), 8.0))


def columns(tops, count=4):
    return [(side, top + 10 * row) for side, top in tops for row in range(count)]


@pytest.mark.parametrize("shift", [-4, 0, 3, 12])
def test_two_columns(shift):
    assert order(*columns([(LEFT, 20), (RIGHT, 20 + shift)])) == list(range(8))


def test_a_heading_comes_first_and_one_between_parts_the_columns():
    upper = columns([(LEFT, 20), (RIGHT, 20)])
    lower = columns([(LEFT, 80), (RIGHT, 80)])
    lines = [(BOTH, 0), *upper, (BOTH, 65), *lower]
    assert order(*lines) == list(range(len(lines)))


def test_three_columns_under_a_heading():
    lines = columns([((0, 20), 10), ((30, 50), 10), ((60, 80), 10)])
    assert order(((0, 80), 0), *lines) == list(range(13))


def test_a_date_on_the_right_comes_before_the_letter():
    lines = [((60, 90), 0), ((0, 30), 30), (BOTH, 50), (BOTH, 60)]
    assert order(*lines) == [0, 1, 2, 3]


def test_parts_of_one_line_are_read_from_left_to_right():
    lines = [(BOTH, 0), (LEFT, 10), (RIGHT, 10), (BOTH, 20)]
    assert order(*lines) == [0, 1, 2, 3]


@given(st.permutations(range(9)))
def test_the_order_does_not_depend_on_how_lines_were_found(shuffled):
    lines = [(BOTH, 0), *columns([(LEFT, 20), (RIGHT, 23)])]
    found = order(*(lines[k] for k in shuffled))
    assert [shuffled[k] for k in found] == list(range(9))


@given(
    st.lists(
        st.tuples(st.integers(0, 100), st.integers(1, 100), st.integers(0, 100)),
        min_size=1,
        max_size=25,
    )
)
def test_every_line_is_read_once(lines):
    found = order(*(((left, left + width), y) for left, width, y in lines))
    assert sorted(found) == list(range(len(lines)))


def test_the_foot_of_a_page_comes_last_in_all_its_parts():
    lines = [*columns([(LEFT, 20), (RIGHT, 20)]), ((0, 15), 90), ((60, 90), 91)]
    assert order(*lines) == list(range(10))


def test_a_box_between_columns_that_reaches_into_one_does_not_part_it():
    upper = [((0, 40), 20), ((0, 40), 30)]
    beside = [((0, 18), y) for y in (40, 50, 60)]
    box = [((20, 52), y) for y in (42, 52, 62)]
    lower = [((0, 40), 75), ((0, 40), 85)]
    right = [((48, 90), y) for y in (20, 30)] + [((54, 90), y) for y in (40, 50, 60, 75, 85)]
    assert order(*upper, *beside, *box, *lower, *right) == list(range(17))
