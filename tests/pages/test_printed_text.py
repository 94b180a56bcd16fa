"""A text as it is printed: its lines are where they are stated to be."""

import numpy as np
import pytest

from smarttouch.base.errors import PageError
from smarttouch.pages.prepared_page import prepare_text, print_text

from ..support.checks import raises


def test_printed_text():
    page = print_text("Touch\nthis")
    ink = (page.grey < 128).any(axis=1)
    assert np.count_nonzero(np.diff(ink.astype(int)) == 1) == 2
    assert page.size_mm[0] == pytest.approx(92, abs=0.1)


@pytest.mark.parametrize("text", ["", "  ", "\n\n"])
def test_nothing_to_print(text):
    with raises(PageError, names="text", value=text):
        print_text(text)


def test_a_page_can_be_too_long():
    long = pytest.approx(2450, abs=50)
    with raises(PageError, names="text", value=long, allowed=2000) as caught:
        print_text("x\n" * 300)
    assert "300" in str(caught.value)


def test_its_lines_lie_where_the_ink_is():
    prepared = prepare_text("dp x\n\nxxx dp")
    assert len(prepared.lines) == 2
    for line in prepared.lines:
        per_mm = 1 / prepared.page.mm_per_pixel
        top, bottom = round(line.top_mm * per_mm), round(line.bottom_mm * per_mm)
        band = prepared.page.grey[top - 20 : bottom + 20] < 128
        rows, columns = np.flatnonzero(band.any(axis=1)), np.flatnonzero(band.any(axis=0))
        assert rows[[0, -1]] == pytest.approx([20, bottom - top + 19], abs=3)
        ends = np.array([line.left_mm, line.right_mm]) * per_mm
        assert columns[[0, -1]] == pytest.approx(ends, abs=3)
        # An x stands on the baseline and is as high as said.
        strip = prepared.strip(0, 100)
        assert strip.shape[0] == 100
    baseline, x_height = (
        value * per_mm for value in (prepared.lines[1].baseline[0], prepared.lines[1].x_height_mm)
    )
    start = round(prepared.lines[1].left_mm * per_mm)
    x = prepared.page.grey[:, start : start + 30] < 128
    rows = np.flatnonzero(x[round(baseline) - 60 :].any(axis=1)) + round(baseline) - 60
    assert rows[[0, -1]] == pytest.approx([baseline - x_height, baseline - 1], abs=2)
