"""Conversion of Braille characters to dots and back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.errors import BrailleError
from smarttouch.braille.cells import cells_to_dots, dots_to_cells

from ..support.checks import raises

LINES = st.text(st.characters(min_codepoint=0x2800, max_codepoint=0x28FF))


@pytest.mark.parametrize(("cell", "dots"), [
    ("⠀", []), ("⠁", [1]), ("⠉", [1, 4]), ("⠼", [3, 4, 5, 6]), ("⡀", [7]), ("⢀", [8]),
])  # fmt: skip
def test_dots_of_a_cell(cell, dots):
    assert (np.flatnonzero(cells_to_dots(cell)[0]) + 1).tolist() == list(dots)


@given(LINES)
def test_dots_give_the_cells_back(cells):
    dots = cells_to_dots(cells)
    assert dots.shape == (len(cells), 8)
    assert dots_to_cells(dots) == cells


def test_what_is_no_cell():
    with raises(BrailleError, names="cell", value="b") as caught:
        cells_to_dots("⠁b")
    assert "position 2" in str(caught.value)
    with raises(BrailleError, names="dots", value=(3, 7)):
        dots_to_cells(np.zeros((3, 7), bool))
