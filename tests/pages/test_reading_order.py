"""Reading order of pages: headings first, columns one after another, tables row by row."""

import shutil

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks import page_layouts
from benchmarks.page_reading import ours, plain
from smarttouch.pages.reading_order import Segment, reading_order
from smarttouch.reading.legibility import character_error_rate

from ..support.full import sample

LEFT, RIGHT, BOTH = (0, 40), (50, 90), (0, 90)
WIDER = 4


def order(*lines, leftward=False):
    """Return the order of lines ((left, right), y), and their cell numbers (0 outside tables)."""
    words = [
        Segment("", WIDER * left, WIDER * right, y, 8.0, -1 - k)
        for k, ((left, right), y) in enumerate(lines)
    ]
    found = reading_order(words, 1000, leftward)
    return (
        [-1 - word.place for line in found for word in line.segments],
        [
            cell if line.is_cells else 0
            for line in found
            for cell, _ in enumerate(line.segments, 1)
        ],
    )  # fmt: skip


def columns(*tops, count=4):
    """Return the lines ((left, right), y) of columns; each column is ((left, right), top)."""
    return [(side, top + 10 * row) for side, top in tops for row in range(count)]


@pytest.mark.parametrize(
    "lines",
    [
        columns((LEFT, 20), (RIGHT, 20)),
        columns((LEFT, 20), (RIGHT, 26)),
        columns((LEFT, 20), (RIGHT, 16)),
        [
            (BOTH, 0),
            *columns((LEFT, 20), (RIGHT, 20)),
            (BOTH, 65),
            *columns((LEFT, 80), (RIGHT, 80)),
        ],
        [((30, 54), 0), *columns((LEFT, 20), (RIGHT, 20))],
        [((0, 85), 0), *columns(((0, 25), 10), ((30, 55), 10), ((60, 85), 10))],
        [((60, 90), 0), ((0, 30), 30), (BOTH, 50), (BOTH, 60)],
        [(BOTH, 0), (LEFT, 10), (RIGHT, 10), (BOTH, 20)],
        [*columns((LEFT, 20), (RIGHT, 20)), (BOTH, 90)],
        columns(
            (LEFT, 20),
            ((0, 25), 60),
            (LEFT, 100),
            (RIGHT, 20),
            ((65, 90), 60),
            (RIGHT, 100),
            ((30, 60), 60),
        ),
    ],
    ids=[
        "columns",
        "lower",
        "higher",
        "headings",
        "title",
        "three",
        "date",
        "parts",
        "foot",
        "caption",
    ],
)
def test_lines_in_the_order_in_which_they_are_read(lines):
    assert order(*lines) == (list(range(len(lines))), [0] * len(lines))


@given(st.permutations(range(9)))
def test_the_order_does_not_depend_on_how_lines_were_found(shuffled):
    lines = [(BOTH, 0), *columns((LEFT, 20), (RIGHT, 23))]
    found, _ = order(*(lines[k] for k in shuffled))
    assert [shuffled[k] for k in found] == list(range(9))


def test_scripts_from_the_right_are_read_from_the_right():
    lines = [(BOTH, 0), *columns((RIGHT, 20), (LEFT, 20))]
    assert order(*lines, leftward=True)[0] == list(range(9))


def test_justified_lines_from_the_right_keep_their_place():
    sides = [(0, 100), (0, 40), (60, 100)]
    words = [
        Segment("two words", left, right, 12 * bool(k), 8.0, k)
        for k, (left, right) in enumerate(sides)
    ]
    lines = reading_order(words, 240, leftward=True)
    assert [(segment.left, segment.right) for line in lines for segment in line.segments] == [
        (0, 100), (0, 100),
    ]  # fmt: skip


NARROW, CELLS, PROSE = [(0, 20), (25, 34)], [(0, 20), (25, 45)], [(0, 40), (45, 85)]


@pytest.mark.parametrize(("cells", "step", "by_rows"), [
    (NARROW, 10, True), (CELLS, 10, False), (CELLS, 16, True), (PROSE, 10, False),
])  # fmt: skip
def test_rows_are_narrow_or_loose(cells, step, by_rows):
    lines = [(cell, step * row) for row in range(5) for cell in cells]
    found, cell = order(*lines)
    assert found == (list(range(10)) if by_rows else [*range(0, 10, 2), *range(1, 10, 2)])
    assert cell == [1, 2] * 5 if by_rows else [0] * 10


def test_a_large_heading_in_two_parts_leaves_a_table_its_rows():
    heading = [Segment("", x, x + 70, 200, 14.0, -1 - k) for k, x in enumerate((0, 90))]
    rows = [
        Segment("", x, x + 50, 230 + 16 * row, 8.0, -3 - 2 * row - k)
        for row in range(8) for k, x in enumerate((0, 110))
    ]  # fmt: skip
    lines = reading_order([*heading, *rows], 1000)
    assert [[-1 - word.place for word in line.segments] for line in lines[-8:]] == [
        [2 + 2 * row, 3 + 2 * row] for row in range(8)
    ]


@pytest.mark.parametrize(("width", "is_doubtful"), [
    (30, False), (36, True), (44, True), (60, False),
])  # fmt: skip
def test_what_may_be_columns_or_rows_is_doubtful(width, is_doubtful):
    segments = [
        Segment("", x, x + width, 10 * row, 8.0, -1) for row in range(5) for x in (0, width + 20)
    ]
    assert {line.is_doubtful for line in reading_order(segments, 1000)} == {is_doubtful}


@given(st.lists(st.tuples(
    st.integers(0, 40), st.integers(0, 20), st.sampled_from([6, 10, 18]),
    st.sampled_from(["a", "12", "•", "a long word", "Label:"]), st.booleans(),
), max_size=60), st.booleans())  # fmt: skip
def test_no_text_is_lost_or_read_twice(placed, leftward):
    segments = [
        Segment(text, 10 * x, 10 * x + 4 * len(text), 12 * y, size, -1 if in_field else k)
        for k, (x, y, size, text, in_field) in enumerate(placed)
    ]
    lines = reading_order(segments, 240, leftward)
    signs = "".join(line.text for line in lines).translate(dict.fromkeys(map(ord, "-; ")))
    assert sorted(signs) == sorted("".join(placing[3] for placing in placed).replace(" ", ""))


@pytest.mark.skipif(shutil.which("tesseract") is None, reason="needs Tesseract")
@pytest.mark.parametrize(
    ("layout", "medium", "seed"),
    sample([
        ("form", "flat", 100), ("index", "flat", 100), ("playbill", "flat", 101),
        ("sidebar", "flat", 100), ("three_columns", "photographed", 100),
        ("bilingual", "photographed", 100),
    ], 6),
)  # fmt: skip
def test_typeset_pages_are_read_in_order(layout, medium, seed):
    page, pieces = page_layouts.page_of(getattr(page_layouts, layout), medium, seed)
    assert character_error_rate(plain("\n".join(pieces)), plain(ours(page))) < 0.05
