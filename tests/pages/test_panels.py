"""Light print in dark panels of a page is found, and turned dark on light."""

import cv2
import numpy as np
import pytest

from smarttouch.pages.page_image import Page
from smarttouch.pages.prepared_page import prepare_page
from smarttouch.pages.text_lines import find_lines

from .printed import print_page, some_lines


@pytest.fixture(scope="module")
def panel():
    """Return a page with a dark panel of three lines in the middle, and where it is."""
    printed = print_page(some_lines(11, 40), size_pt=11, dpi=150)
    grey = printed.page.grey.copy()
    y = [round(line.baseline_mm[0, 1] / printed.page.mm_per_pixel) for line in printed.lines]
    box = np.s_[y[3] + 9 : y[6] + 9, 50:-50]
    grey[box] = 260 - grey[box].astype(int)
    return Page(grey, printed.page.mm_per_pixel), box


@pytest.mark.parametrize("light_on_dark", [False, True])
def test_lines_of_either_polarity_are_found(panel, light_on_dark):
    page, _ = panel
    grey = 255 - page.grey if light_on_dark else page.grey
    assert len(find_lines(Page(grey, page.mm_per_pixel), light_on_dark)) == 11


def test_a_panel_becomes_dark_on_light(panel):
    page, box = panel
    prepared = prepare_page(page)
    assert np.mean(prepared.cleaned[box] > 200) > 0.7
    strips = [prepared.strip(index, 32) for index in range(11)]
    assert all(np.mean(strip < 128) < 0.4 for strip in strips)


@pytest.mark.parametrize("size", [3, 8])
def test_large_letters_are_no_panels(size):
    grey = np.full((500, 1600), 235, np.uint8)
    cv2.putText(grey, "BOB8%", (30, 300), cv2.FONT_HERSHEY_SIMPLEX, size, 20, 8 * size)
    cleaned = prepare_page(Page(grey, 0.1)).cleaned
    assert (cleaned[grey == 20] < 100).all()
