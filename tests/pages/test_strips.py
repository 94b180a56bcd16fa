"""Strips are lines as they were printed: level, at one scale, and without their neighbors."""

import cv2
import numpy as np
import pytest

from smarttouch.pages.page_image import Page, TextLine
from smarttouch.pages.prepared_page import SIDES, cut_strip, prepare_page

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
    """Return the correlation of two strips, the one shifted and stretched a little."""
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


def test_beyond_the_page_there_is_paper():
    cleaned = np.zeros((100, 300), np.uint8)
    strip = cut_strip(cleaned, 0.1, line_at(1.0, right_mm=50.0), 20)
    assert (strip[:8] == 255).all()
    assert (strip[:, -20:] == 255).all()


def test_letters_of_the_next_line_are_left_out_and_own_ones_kept():
    cleaned = np.full((300, 500), 255, np.uint8)
    cleaned[105:130, 150:170] = 0
    cleaned[70:105, 200:204] = 0
    cleaned[105:135, 300:310] = 0
    strip = cut_strip(cleaned, 0.1, line_at(13.0), 40)
    columns = np.flatnonzero((strip < 128).any(axis=0))
    assert len(columns) == pytest.approx(30, abs=2)


def test_a_page_without_lines_is_prepared():
    prepared = prepare_page(Page(np.full((100, 100), 255, np.uint8), 0.1))
    assert prepared.lines == ()
    assert prepared.notes == ()
    assert (prepared.cleaned == 255).all()


@pytest.mark.parametrize("light_on_dark", [None, True])
def test_a_dark_page_is_prepared_as_a_light_one(printed, light_on_dark):
    dark = Page(255 - printed.page.grey, printed.page.mm_per_pixel)
    prepared = prepare_page(dark, light_on_dark)
    assert prepared.light_on_dark
    assert len(prepared.lines) == len(printed.lines)
    assert np.median(prepared.cleaned) == 255


def test_ink_beside_what_is_left_out_stays():
    """A descender from the line above comes within a pixel of a letter of this line."""
    page = np.full((200, 200), 255, np.uint8)
    page[85:115, 50:60] = 0
    page[20:90, 61:66] = 0
    line = TextLine(50.0, 150.0, (110.0,), 20.0, 30.0, 10.0)
    strip = cut_strip(page, 1.0, line, 40)
    before = round(SIDES * line.height_mm)
    assert (strip[6:34, before + 1 : before + 10] < 60).all()
    assert (strip[:, before + 13 : before + 15] > 200).all()
