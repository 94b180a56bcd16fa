"""Prepared pages: positions of lines, and level strips without letters of other lines."""

import cv2
import numpy as np
import pytest

from smarttouch.base.errors import PageError
from smarttouch.pages.page_and_lines import TextLine
from smarttouch.pages.prepared_page import prepare_page, prepare_text, print_text
from smarttouch.pages.straighten import SIDES, cut_strip

from ..support.checks import raises
from .printed import degrade, print_page, some_lines

HEIGHT = 24


@pytest.fixture(scope="module")
def printed():
    return print_page(some_lines(7, 34), size_pt=12, dpi=150)


@pytest.fixture(scope="module")
def straight(printed):
    prepared = prepare_page(printed.page)
    return [prepared.strip(index, HEIGHT) for index in range(7)]


def likeness(strip, other):
    """Return the largest correlation of two strips over small shifts and changes of width."""
    best = 0.0
    for width in np.linspace(0.97, 1.03, 13) * other.shape[1]:
        one = cv2.resize(strip, (round(width), HEIGHT), interpolation=cv2.INTER_AREA)
        padded = np.pad(other, ((2, 2), (20, 60)), constant_values=255)
        if one.shape[1] <= padded.shape[1]:
            best = max(best, float(cv2.matchTemplate(padded, one, cv2.TM_CCOEFF_NORMED).max()))
    return best


@pytest.mark.parametrize("mistreated", [
    {"skew_deg": 3}, {"curvature": 4}, {"uneven": 0.8, "noise": 6},
    {"perspective": 0.08, "noise": 3}, {"inverted": True},
])  # fmt: skip
def test_strips_look_as_if_nothing_had_happened(printed, straight, mistreated):
    prepared = prepare_page(degrade(printed, **mistreated).page)
    assert len(prepared.lines) == len(straight)
    for index, clean in enumerate(straight):
        assert likeness(prepared.strip(index, HEIGHT), clean) > 0.85


def line_at(base_mm, slope=0.0, ascent_mm=3.0, descent_mm=1.0, right_mm=40.0):
    return TextLine(10.0, right_mm, (base_mm, slope), 2.0, ascent_mm, descent_mm)


@pytest.mark.parametrize("height_px", [5, 16, 40, 200])
def test_the_box_fills_the_height_and_keeps_its_shape(height_px):
    cleaned = np.full((300, 500), 255, np.uint8)
    cleaned[100:140, 150:250] = 0
    strip = cut_strip(cleaned, 0.1, line_at(13.0), height_px)
    dark = strip < 128
    assert dark.any(axis=1).all()
    assert dark[height_px // 2].sum() == pytest.approx(100 / 40 * height_px, abs=1.5)
    assert strip.shape[0] == height_px


def test_making_it_smaller_averages_and_does_not_skip():
    cleaned = np.full((300, 500), 255, np.uint8)
    cleaned[100:140:2, 100:400] = 0
    strip = cut_strip(cleaned, 0.1, line_at(13.0), 4)
    assert strip[:, 15:25] == pytest.approx(np.full((4, 10), 127.5), abs=10)


def test_a_sloping_line_becomes_level():
    cleaned = np.full((300, 500), 255, np.uint8)
    cv2.line(cleaned, (100, 110), (400, 140), 0, 5)
    strip = cut_strip(cleaned, 0.1, line_at(13.0, slope=0.1), 40)
    rows = np.arange(40)
    ink = 255.0 - strip[:, 20:-20]
    centers = (ink * rows[:, None]).sum(axis=0) / ink.sum(axis=0)
    assert np.ptp(centers) < 1.0


def test_letters_of_the_next_line_are_left_out_and_own_ones_kept():
    cleaned = np.full((300, 500), 255, np.uint8)
    cleaned[105:130, 150:170] = 0
    cleaned[70:105, 200:204] = 0
    cleaned[105:135, 300:310] = 0
    strip = cut_strip(cleaned, 0.1, line_at(13.0), 40)
    columns = np.flatnonzero((strip < 128).any(axis=0))
    assert len(columns) == pytest.approx(30, abs=2)


def test_ink_beside_what_is_left_out_stays():
    """A letter stays complete although a descender of the line above is only one pixel away."""
    page = np.full((200, 200), 255, np.uint8)
    page[85:115, 50:60] = 0
    page[20:90, 61:66] = 0
    line = TextLine(50.0, 150.0, (110.0,), 20.0, 30.0, 10.0)
    strip = cut_strip(page, 1.0, line, 40)
    before = round(SIDES * line.height_mm)
    assert (strip[6:34, before + 1 : before + 10] < 60).all()
    assert (strip[:, before + 13 : before + 15] > 200).all()


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
    baseline, x_height = (
        value * per_mm for value in (prepared.lines[1].baseline[0], prepared.lines[1].x_height_mm)
    )
    start = round(prepared.lines[1].left_mm * per_mm)
    x = prepared.page.grey[:, start : start + 30] < 128
    rows = np.flatnonzero(x[round(baseline) - 60 :].any(axis=1)) + round(baseline) - 60
    assert rows[[0, -1]] == pytest.approx([baseline - x_height, baseline - 1], abs=2)
