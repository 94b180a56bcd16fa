"""Columns are read one after another, headings before them, tables by rows."""

import shutil

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.pages.reading_order import reading_order
from smarttouch.reading.legibility import character_error_rate

from ..benchmarks import page_layouts
from ..benchmarks.page_reading import ours, plain

LEFT, RIGHT, BOTH = (0, 40), (50, 90), (0, 90)
WIDER = 4


def order(*lines, **more):
    """Order lines of (sides, y), 8 high; columns are wider than cells of a table."""
    sides, y = zip(*lines, strict=True)
    left, right = WIDER * np.array(sides, float).T
    return reading_order(left, right, np.array(y, float), np.full(len(y), 8.0), **more).indices


def columns(*tops, count=4):
    """Return columns of lines, each of (sides, top)."""
    return [(side, top + 10 * row) for side, top in tops for row in range(count)]


@pytest.mark.parametrize(
    "lines",
    [
        columns((LEFT, 20), (RIGHT, 20)),
        columns((LEFT, 20), (RIGHT, 32)),
        columns((LEFT, 20), (RIGHT, 16)),
        [(BOTH, 0), *columns((LEFT, 20), (RIGHT, 20)), (BOTH, 65),
         *columns((LEFT, 80), (RIGHT, 80))],
        [((30, 44), 0), *columns((LEFT, 20), (RIGHT, 20))],
        [((0, 85), 0), *columns(((0, 25), 10), ((30, 55), 10), ((60, 85), 10))],
        [((60, 90), 0), ((0, 30), 30), (BOTH, 50), (BOTH, 60)],
        [(BOTH, 0), (LEFT, 10), (RIGHT, 10), (BOTH, 20)],
        [*columns((LEFT, 20), (RIGHT, 20)), ((0, 15), 90), ((60, 90), 91)],
    ],
    ids=["columns", "lower", "higher", "headings", "narrow title", "three", "date", "parts",
         "foot"],
)  # fmt: skip
def test_lines_in_the_order_in_which_they_are_read(lines):
    assert order(*lines) == list(range(len(lines)))


@given(st.permutations(range(9)))
def test_the_order_does_not_depend_on_how_lines_were_found(shuffled):
    lines = [(BOTH, 0), *columns((LEFT, 20), (RIGHT, 23))]
    found = order(*(lines[k] for k in shuffled))
    assert [shuffled[k] for k in found] == list(range(9))


SPAN = st.tuples(st.integers(0, 100), st.integers(1, 100), st.integers(0, 100))


@given(st.lists(SPAN, min_size=1, max_size=25), st.booleans())
def test_every_line_is_read_once(lines, leftward):
    left, wide, y = np.array(lines, float).T
    found = reading_order(left, left + wide, y, np.full(len(y), 8.0), leftward)
    assert sorted(found.indices) == list(range(len(lines)))
    assert (found.cell >= 0).all()


def test_scripts_from_the_right_are_read_from_the_right():
    lines = [(BOTH, 0), *columns((RIGHT, 20), (LEFT, 20))]
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


NARROW, CELLS, PROSE = [(0, 90), (120, 150)], [(0, 90), (120, 190)], [(0, 200), (220, 420)]


@pytest.mark.parametrize(
    ("cells", "step", "by_rows", "doubtful"),
    [
        (NARROW, 10, True, False),
        ([(0, 90), (120, 165)], 10, False, True),
        (CELLS, 10, False, False),
        (CELLS, 16, True, False),  # looser than lines of a column
        (PROSE, 12, False, False),
    ],
)
def test_rows_are_narrow_or_loose(cells, step, by_rows, doubtful):
    left, right = np.array(cells * 5, float).T
    y = step * np.repeat(np.arange(5.0), 2)
    found = reading_order(left, right, y, np.full(10, 8.0))
    assert found.indices == (list(range(10)) if by_rows else [*range(0, 10, 2), *range(1, 10, 2)])
    assert found.cell.any() == by_rows
    assert found.doubtful == doubtful


@pytest.mark.skipif(shutil.which("tesseract") is None, reason="needs Tesseract")
@pytest.mark.parametrize(
    ("layout", "medium"),
    [("form", "flat"), ("index", "flat"), ("playbill", "flat"), ("sidebar", "flat"),
     ("three_columns", "photographed"), ("bilingual", "photographed")],
)  # fmt: skip
def test_typeset_pages_are_read_in_order(layout, medium):
    page, pieces = page_layouts.page_of(getattr(page_layouts, layout), medium, 100)
    assert character_error_rate(plain("\n".join(pieces)), plain(ours(page))) < 0.05
