"""Straightening of skewed and photographed pages; straight pages stay unchanged."""

import cv2
import numpy as np
import pytest
from skimage import data

from smarttouch.pages.page_and_lines import Page
from smarttouch.pages.prepared_page import find_lines, prepare_page
from smarttouch.pages.straighten import find_sheet

from ..support.checks import numbers_in
from ..support.full import sample
from .printed import TABLE, degrade, print_page, some_lines


@pytest.fixture(scope="module")
def printed():
    return print_page(some_lines(16, 50), size_pt=11, dpi=150)


def assert_level(page):
    """Assert that all long lines of a page are level."""
    lines = [line for line in find_lines(page, None) if line.right_mm - line.left_mm > 40]
    assert len(lines) >= 10
    rises = [np.diff(line.baseline_mm(np.array([line.left_mm, line.right_mm]))) for line in lines]
    lengths = [line.right_mm - line.left_mm for line in lines]
    slopes_deg = np.degrees(np.arctan(np.ravel(rises) / lengths))
    assert np.abs(slopes_deg).max() < 0.35
    assert abs(np.median(slopes_deg)) < 0.12


@pytest.mark.parametrize(("skew_deg", "inverted"), sample([
    (-14, True), (-3, False), (-0.5, True), (0.5, False), (2, True), (8, False), (14.5, False),
]))  # fmt: skip
def test_skew_is_turned_back(printed, skew_deg, inverted):
    tilted = degrade(printed, skew_deg=skew_deg, inverted=inverted, noise=5).page
    prepared = prepare_page(tilted)
    assert_level(prepared.page)
    (note,) = prepared.notes
    assert numbers_in(note) == [pytest.approx(abs(skew_deg), abs=0.15)]


@pytest.mark.parametrize("skew_deg", [0, 0.1, -0.1])
def test_a_straight_page_is_left_alone(printed, skew_deg):
    tilted = degrade(printed, skew_deg=skew_deg, noise=5).page
    prepared = prepare_page(tilted)
    assert prepared.page is tilted
    assert prepared.notes == ()


@pytest.mark.parametrize("lines", [["one quick line of words"], ["illicit tilt", "still it"]])
def test_little_text_is_not_turned_by_guess(lines):
    page = print_page(lines, size_pt=12, dpi=150).page
    prepared = prepare_page(page)
    assert prepared.page is page
    assert prepared.notes == ()


@pytest.mark.parametrize("name", ["camera", "coins", "grass", "moon"])
def test_pictures_are_left_alone(name):
    page = Page(getattr(data, name)(), 0.2)
    assert prepare_page(page).page is page


@pytest.mark.parametrize(
    ("perspective", "light"),
    [(0.05, {}), (0.2, {"uneven": 0.6, "noise": 5}), (0.05, {"uneven": 0.9}),
     (0.2, {"uneven": 0.9})],
)  # fmt: skip
def test_a_sheet_on_a_table_is_laid_flat(printed, perspective, light):
    photo = degrade(printed, perspective=perspective, skew_deg=2, **light)
    prepared = prepare_page(photo.page)
    page, notes = prepared.page, prepared.notes
    assert find_sheet(photo.page.grey) is not None
    # The first note is about the sheet: it has no number, and a note about skew states an angle.
    assert numbers_in(notes[0]) == []
    assert_level(page)
    width, height = printed.page.size_mm
    assert page.size_mm[0] / page.size_mm[1] == pytest.approx(width / height, rel=0.2)


@pytest.mark.parametrize("left", [0.3, 0.45, 0.7])
@pytest.mark.parametrize("turned", [0, 2])
def test_a_sheet_half_in_the_shadow_is_found_whole(printed, left, turned):
    """The sheet is found even if the lit table is as bright as the shaded part of the sheet."""
    grey = degrade(printed, perspective=0.15, skew_deg=6).page.grey.astype(np.float32)
    y, x = np.mgrid[: grey.shape[0], : grey.shape[1]] / max(grey.shape)
    boards = 35 + 18 * np.sin(90 * y + 3 * np.sin(8 * x))
    photo = np.where(grey == TABLE, TABLE + boards, grey)
    photo *= 1 - (1 - left) / (1 + np.exp((x + 0.6 * y - 0.8) / 0.02))
    photo += np.random.default_rng(0).normal(0, 4, photo.shape)
    photo = np.rot90(np.clip(photo, 0, 255).astype(np.uint8), turned)
    alone = np.rot90(np.where(grey == TABLE, TABLE, 235).astype(np.uint8), turned)
    found, sheet = find_sheet(np.ascontiguousarray(photo)), find_sheet(np.ascontiguousarray(alone))
    assert found == pytest.approx(sheet, abs=0.015 * max(grey.shape))


def test_the_corners_are_those_of_the_sheet():
    grey = np.full((400, 500), 60, np.uint8)
    corners = np.array([[60, 40], [430, 70], [450, 350], [40, 330]])
    cv2.fillPoly(grey, [corners.astype(np.int32)], 230)
    assert find_sheet(grey) == pytest.approx(corners, abs=3)


def test_what_is_no_sheet():
    grey = np.full((400, 500), 60, np.uint8)
    assert find_sheet(grey) is None
    assert find_sheet(np.full((400, 500), 230, np.uint8)) is None
    cv2.circle(grey, (250, 200), 150, 230, -1)
    assert find_sheet(grey) is None
    band = np.full((400, 500), 230, np.uint8)
    band[:, :80] = 60
    assert find_sheet(band) is None, "a single dark edge comes from a scanner, not from a sheet"
