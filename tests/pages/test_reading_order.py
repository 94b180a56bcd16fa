"""Columns are read one after another, headings before both."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.pages.reading_order import find_captions, reading_order
from smarttouch.pages.spots import Spots

LEFT, RIGHT, BOTH = (0, 40), (50, 90), (0, 90)
WIDER = 4


def order(*lines, **more):
    """Order lines of (sides, y), 8 high; columns are wider than cells of a table."""
    sides, y = zip(*lines, strict=True)
    left, right = WIDER * np.array(sides, float).T
    return reading_order(left, right, np.array(y, float), np.full(len(y), 8.0), **more).indices


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


def test_slips_on_one_sheet_are_read_one_by_one():
    side, other = (0, 30), (60, 90)
    tops = [(side, 0), (other, 4), (side, 103), (other, 98)]
    assert order(*columns(tops)) == list(range(16))
    # Rows of a table go on across such gaps.
    level = columns([(side, 0), (other, 0), (side, 100), (other, 100)])
    assert order(*level) != list(range(16))


def test_three_columns_under_a_heading():
    lines = columns([((0, 25), 10), ((30, 55), 10), ((60, 85), 10)])
    assert order(((0, 85), 0), *lines) == list(range(13))


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


SPAN = st.tuples(st.integers(0, 100), st.integers(1, 100), st.integers(0, 100))


@given(
    st.lists(SPAN, min_size=1, max_size=25),
    st.lists(SPAN, max_size=3),
    st.lists(SPAN, max_size=3),
    st.booleans(),
)
def test_every_line_is_read_once(lines, boxes, rules, leftward):
    left, wide, y = np.array(lines, float).T
    boxes = np.array([[x, top, x + side, top + side] for x, side, top in boxes], float)
    rules = np.array([[x, x + long, at] for x, long, at in rules], float)
    found = reading_order(
        left, left + wide, y, np.full(len(y), 8.0),
        boxes.reshape(-1, 4), rules.reshape(-1, 3), leftward,
    )  # fmt: skip
    assert sorted(found.indices) == list(range(len(lines)))
    assert (found.cell >= 0).all()


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


def test_a_box_comes_after_the_column_in_which_it_stands():
    column = [(LEFT, y) for y in (20, 30, 80, 90)]
    box = [((5, 35), 50), ((5, 35), 60)]
    right = [(RIGHT, y) for y in (20, 30, 40, 50, 60, 70, 80, 90)]
    boxes = np.array([[2.0, 38, 38, 66]]) * (WIDER, 1, WIDER, 1)
    assert order(*column, *box, *right, boxes=boxes) == list(range(14))


def test_a_box_beside_a_column_comes_after_all_of_it():
    column = [(LEFT, y) for y in range(20, 160, 10)]
    box = [((55, 85), y) for y in (30, 40, 50)]
    boxes = np.array([[52.0, 18, 88, 56]]) * (WIDER, 1, WIDER, 1)
    assert order(*column, *box, boxes=boxes) == list(range(17))


def test_a_printed_rule_parts_what_is_above_from_what_is_below():
    lines = [*columns([(LEFT, 20), (RIGHT, 20)]), *columns([(LEFT, 60), (RIGHT, 60)])]
    rule = np.array([[0.0, WIDER * 90, 55]])
    assert order(*lines, rules=rule) == list(range(16))
    assert order(*lines) != list(range(16))


def test_scripts_from_the_right_are_read_from_the_right():
    lines = [(BOTH, 0), *columns([(RIGHT, 20), (LEFT, 20)])]
    assert order(*lines, leftward=True) == list(range(9))


def test_a_table_of_figures_is_read_by_rows_and_its_cells_are_known():
    ends = [(0, 90), (120, 150), (180, 210)]
    text = [(0, 400)]
    rows = [text, *[ends] * 4, text]
    y = np.repeat(10.0 * np.arange(6), [len(row) for row in rows])
    left, right = np.array([cell for row in rows for cell in row], float).T
    found = reading_order(left, right, y, np.full(14, 8.0))
    assert found.indices == list(range(14))
    assert found.cell.tolist() == [0, *[1, 2, 3] * 4, 0]
    assert not found.doubtful


def test_rows_that_may_be_columns_are_doubtful():
    cells = [(0, 90), (120, 180), (210, 270)]
    left, right = np.array(cells * 5, float).T
    found = reading_order(left, right, np.repeat(10.0 * np.arange(5), 3), np.full(15, 8.0))
    assert found.doubtful
    assert found.indices == [*range(0, 15, 3), *range(1, 15, 3), *range(2, 15, 3)]


CELLS = [(0, 50), (100, 150)]


@pytest.mark.parametrize(
    ("cells", "step", "rows", "lower", "block", "by_rows"),
    [
        (CELLS, 30, 5, [], [1, 1], True),  # too far below each other for a table
        (CELLS, 30, 5, [], [1, 2], False),
        (CELLS, 30, 5, [], [0, 0], False),
        (CELLS, 30, 5, [(100, 150)], [1, 1], False),  # columns taken for a block
        (CELLS, 30, 2, [(0, 50)], [1, 1], True),
        ([(0, 50), (100, 150), (200, 250)], 10, 5, [], [1, 2, 3], False),  # wide for cells
        ([(0, 50), (100, 150), (200, 250)], 10, 5, [], [0, 0, 0], True),
        ([(0, 30), (100, 130)], 10, 5, [], [1, 2], True),
        ([(0, 90), (100, 190)], 10, 5, [], [1, 1], True),
        ([(0, 130), (140, 270)], 30, 5, [], [1, 1], False),  # prose
    ],
)
def test_blocks_tell_rows_from_columns(cells, step, rows, lower, block, by_rows):
    left, right = np.array([*cells * rows, *lower], float).T
    y = step * np.array([*np.repeat(np.arange(rows), len(cells)), *[rows] * len(lower)], float)
    known = np.array([*block * rows, *block[:1] * len(lower)])
    found = reading_order(left, right, y, np.full(len(y), 8.0), blocks=lambda: known).indices
    assert (found == list(range(len(y)))) == by_rows


@pytest.mark.parametrize("shift", [0, 4])
def test_narrow_columns_that_go_on_below_level_lines_are_no_table(shift):
    y = 10.0 * np.arange(20)
    y = np.concatenate([y, np.where(y < 50, y, y + shift)])
    left = np.repeat([0.0, 100], 20)
    known = np.repeat([1, 2], 20)
    found = reading_order(left, left + 30, y, np.full(40, 8.0), blocks=lambda: known).indices
    # Where all lines are level, it is a table.
    assert (found == list(range(40))) == (shift > 0)


def test_a_caption_is_what_stands_right_below_a_picture():
    picture = Spots(*np.array([[0], [0], [300], [200], [60_000]]))
    y = np.array([215.0, 226, 260, 270])
    found = find_captions(np.zeros(4), np.full(4, 300.0), y, np.full(4, 8.0), picture)
    assert len(found) == 1
    assert ((y > found[0, 1]) & (y < found[0, 3])).tolist() == [True, True, False, False]
