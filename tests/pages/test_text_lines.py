"""Detection of text lines on scanned and photographed pages: their order and position."""

from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skimage import data

from smarttouch.pages.page_and_lines import Page, TextLine
from smarttouch.pages.prepared_page import find_lines, prepare_page

from ..support.full import sample
from .printed import Printed, degrade, print_page, some_lines

SCAN = {
    "clean": {},
    "skew": {"skew_deg": 3},
    "other skew": {"skew_deg": -3},
    "uneven": {"uneven": 0.9, "noise": 8},
    "noise": {"noise": 20},
    "inverted": {"inverted": True, "uneven": 0.4},
    "perspective": {"perspective": 0.15},
    "photo": {"perspective": 0.1, "uneven": 0.6, "noise": 5, "skew_deg": 2, "jpeg": 75},
    "book": {"curvature": 8, "uneven": 0.5},
}


def error(line, truth):
    """Return the mean baseline error in x-heights; NaN if the line is too short or misplaced."""
    x, y = truth.baseline_mm.T
    inside = (x >= line.left_mm - 0.1) & (x <= line.right_mm + 0.1)
    if inside.mean() < 0.9:
        return np.nan
    return float(np.abs(line.baseline_mm(x[inside]) - y[inside]).mean() / truth.x_height_mm)


def assert_found(printed, lines, max_error=0.16):
    """Assert that exactly the printed lines are found, in order, with small baseline errors."""
    assert len(lines) == len(printed.lines)
    errors = [error(*pair) for pair in zip(lines, printed.lines, strict=True)]
    assert max(errors) < max_error


@pytest.mark.parametrize(
    ("case", "columns"),
    sample([*((case, 1) for case in SCAN), *((case, 2) for case in ("inverted", "photo", "book"))]),
)
def test_all_lines_are_found_in_order_and_in_place(case, columns):
    lines = some_lines(16 * columns, 45 // columns)
    page = print_page(lines, size_pt=10, dpi=150, columns=columns, heading="Of quiet pages")
    photo = degrade(page, **SCAN[case])
    assert_found(photo, find_lines(photo.page, None))


PRINT = {
    "sans of 12 px": (some_lines(8, 24), {"size_pt": 10, "dpi": 85, "font": "DejaVuSans"}, {}),
    "italics": (some_lines(8, 24), {"size_pt": 14, "dpi": 200, "font": "DejaVuSerif-Italic"}, {}),
    "large mono": (some_lines(8, 24), {"size_pt": 40, "dpi": 100, "font": "DejaVuSansMono"}, {}),
    "six pixels that run together": (some_lines(12, 40), {"dpi": 72}, {"blur_px": 0.9}),
    "touching, skew": (some_lines(14, 40), {"size_pt": 10, "dpi": 85}, {"skew_deg": 3}),
    "touching, far": (some_lines(14, 40), {"size_pt": 10, "dpi": 85}, {"perspective": 0.15}),
    "touching, blur": (some_lines(14, 40), {"size_pt": 10, "dpi": 85}, {"blur_px": 0.7}),
    "dashes": (['He said — "well" … then', "went on - quietly", "... and so, etc."], {}, {}),
    "a list": (["• a point in a list", "– and another one", "x", "5", "II."], {}, {}),
    "capitals": (["A TITLE IN CAPITALS", "and words under it that are", "1984", "MORE"], {}, {}),
    "code": ([">>> a = markers(b)", "if x == y - 1: return", "a = 5"], {}, {}),
    "accents": (["Été à Évian, où naïve Ångström", "Straße, größer, übel, ÄÖÜ"], {}, {}),
    "a word": (["word"], {}, {}),
    "few letters": (
        ["Exact", "Least", "Short: Sent size", "Last input"],
        {"size_pt": 9, "dpi": 200, "font": "DejaVuSans"}, {},
    ),
    "commas aslant": (
        ["fat, flour; salt, pan, stock", "neck, wings; liver, heart, and", "so on, then, at last;"],
        {"size_pt": 14, "dpi": 200}, {"skew_deg": -3},
    ),
}  # fmt: skip
"""Lines of text, options of `print_page` (default: 12 points, 150 dpi), options of `degrade`."""


@pytest.mark.parametrize("case", PRINT)
def test_lines_of_any_print_stay_whole(case):
    lines, kind, harm = PRINT[case]
    page = degrade(print_page(lines, **{"size_pt": 12, "dpi": 150} | kind), **harm)
    assert_found(page, find_lines(page.page), max_error=0.25)


@pytest.mark.parametrize("mm_per_pixel", [0.01, 0.3, 2.0])
def test_the_scale_of_the_page_is_not_believed(mm_per_pixel):
    page = print_page(some_lines(6, 30), size_pt=10, dpi=150)
    usual = find_lines(page.page)
    scaled = find_lines(Page(page.page.grey, mm_per_pixel))
    ratio = mm_per_pixel / page.page.mm_per_pixel
    assert [line.left_mm * ratio for line in usual] == pytest.approx(
        [line.left_mm for line in scaled]
    )


def test_lines_of_one_print_have_one_height():
    page = print_page(["one ran so", "happy pigs", "tilted bill", "MORE 1984"], size_pt=12, dpi=150)
    lines = find_lines(page.page)
    heights = [line.height_mm for line in lines]
    assert max(heights) < 1.01 * min(heights)
    # DejaVu Serif: relative to the font size, b rises 0.76, p descends 0.24 and x is 0.52 high.
    size_mm = 12 * 25.4 / 72
    assert lines[0].ascent_mm == pytest.approx(0.76 * size_mm, rel=0.07)
    assert lines[0].descent_mm == pytest.approx(0.24 * size_mm, rel=0.2)
    assert lines[0].x_height_mm == pytest.approx(0.52 * size_mm, rel=0.07)


def test_a_heading_keeps_its_own_height():
    page = print_page(some_lines(8, 30), size_pt=10, dpi=150, heading="Large words")
    heading, first = find_lines(page.page)[:2]
    ratio = page.lines[0].x_height_mm / page.lines[1].x_height_mm
    assert heading.height_mm == pytest.approx(ratio * first.height_mm, rel=0.06)


def test_lines_beside_a_rule_and_in_a_frame():
    page = print_page(some_lines(6, 30), size_pt=11, dpi=150)
    grey = page.page.grey.copy()
    cv2.rectangle(grey, (30, 30), (grey.shape[1] - 30, grey.shape[0] - 30), 30, 3)
    for line in page.lines:
        y = round(line.baseline_mm[0, 1] / page.page.mm_per_pixel) + 9
        grey[y, 40:-40] = 60
    assert_found(page, find_lines(Page(grey, page.page.mm_per_pixel)))


@pytest.mark.parametrize("picture", ["camera", "grass"])
def test_text_beside_a_picture(picture):
    page = print_page(some_lines(8, 40), size_pt=11, dpi=150)
    grey = np.full((page.page.grey.shape[0] + 300, page.page.grey.shape[1]), 235, np.uint8)
    grey[300:] = page.page.grey
    grey[20:290, 60:330] = cv2.resize(getattr(data, picture)(), (270, 270))
    down_mm = np.array([0, 300 * page.page.mm_per_pixel])
    moved = [replace(line, baseline_mm=line.baseline_mm + down_mm) for line in page.lines]
    both = Printed(Page(grey, page.page.mm_per_pixel), tuple(moved))
    lines = find_lines(both.page)
    in_picture = [line for line in lines if line.bottom_mm < 290 * page.page.mm_per_pixel]
    assert len(in_picture) <= (1 if picture == "camera" else 11), "too many specks read as letters"
    assert_found(both, [line for line in lines if line not in in_picture])


def test_a_photographed_page_of_a_book():
    lines = find_lines(Page(data.page(), 110 / 384))
    assert 7 <= len(lines) <= 9
    first_six = [line.bottom_mm for line in lines[:6]]
    assert first_six == sorted(first_six)
    for above, below in pairwise(lines):
        # Lines slope and differ in length, so compare two lines only where both have text.
        shared = np.array([max(above.left_mm, below.left_mm), min(above.right_mm, below.right_mm)])
        lower = above.baseline_mm(shared) + above.descent_mm
        assert (lower <= below.baseline_mm(shared) - below.ascent_mm).all()


@pytest.mark.parametrize(
    "name", ["astronaut", "brick", "camera", "clock", "coins", "grass", "gravel", "moon"]
)
def test_pictures_have_no_lines(name):
    picture = getattr(data, name)()
    grey = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    assert find_lines(Page(grey, 0.2)) == []


@pytest.mark.parametrize("grey", [255, 128, 0])
def test_blank_pages_have_no_lines(grey):
    for light_on_dark in (None, False):
        assert find_lines(Page(np.full((300, 400), grey, np.uint8), 0.2), light_on_dark) == []


@pytest.mark.parametrize("part", [0.02, 0.2, 0.5])
def test_noise_has_hardly_a_line(part):
    lines = []
    for seed in range(5):
        specks = np.random.default_rng(seed).random((40, 60)) < part
        grey = np.where(np.kron(specks, np.ones((4, 4), bool)), 20, 230).astype(np.uint8)
        lines += find_lines(Page(grey, 0.2))
    assert len(lines) <= 3


@given(st.integers(0, 2**32 - 1), st.integers(8, 60), st.integers(8, 60))
def test_no_picture_is_too_strange(seed, height, width):
    random = np.random.default_rng(seed)
    coarse = random.integers(0, 256, (height, width)).astype(np.uint8)
    grey = cv2.resize(coarse, (4 * width, 3 * height), interpolation=cv2.INTER_CUBIC)
    for line in find_lines(Page(grey, 0.2), None):
        assert line.height_mm > line.x_height_mm > 0
        assert line.right_mm > line.left_mm


def test_a_baseline_goes_straight_on_beyond_the_ends():
    line = TextLine(10.0, 20.0, (5.0, 0.1, 0.01), 2.0, 3.0, 1.0)
    x = np.array([8.0, 10.0, 15.0, 20.0, 22.0])
    assert line.baseline_mm(x) == pytest.approx([4.8, 5.0, 5.75, 7.0, 7.6])
    assert (line.top_mm, line.bottom_mm) == pytest.approx((2.75, 6.75))


def test_columns_parted_by_a_rule_are_read_one_after_the_other():
    page = print_page(some_lines(24, 22), size_pt=10, dpi=150, columns=2)
    per_mm = 1 / page.page.mm_per_pixel
    # Move the columns together, so that only the rule separates them.
    left_end = max(line.baseline_mm[-1, 0] for line in page.lines[:12])
    right = page.lines[12].baseline_mm[0, 0]
    cut, start = round((left_end + 1.4) * per_mm), round((right - 1.4) * per_mm)
    grey = np.hstack([page.page.grey[:, :cut], page.page.grey[:, start:]])
    grey[60:-60, cut - 1 : cut + 1] = 30
    shift = np.array([(cut - start) / per_mm, 0])
    lines = [
        replace(line, baseline_mm=line.baseline_mm + shift * (k >= 12))
        for k, line in enumerate(page.lines)
    ]
    assert_found(Printed(Page(grey, 1 / per_mm), tuple(lines)), find_lines(Page(grey, 1 / per_mm)))


def test_columns_stay_apart_beside_short_paragraphs():
    page = print_page(some_lines(40, 34), size_pt=10, dpi=150, columns=2)
    grey, per_mm = page.page.grey.copy(), 1 / page.page.mm_per_pixel
    erased = [*range(25, 28), *range(31, 34)]  # indices of lines in the right column
    for k in erased:
        x, y = (page.lines[k].baseline_mm[0] * per_mm).astype(int)
        grey[y - 18 : y + 8, x - 5 :] = grey[0, 0]
    lines = tuple(line for k, line in enumerate(page.lines) if k not in erased)
    both = Printed(Page(grey, 1 / per_mm), lines)
    assert_found(both, find_lines(both.page))


def test_the_lower_part_of_a_broken_letter_is_not_a_line():
    words = ["waiting, 218 and 219", "against, 29"]
    page = print_page(words, size_pt=11, dpi=170, font="STIXGeneral")
    grey = page.page.grey.copy()
    for line in page.lines:
        y_mm = line.baseline_mm[0, 1] - 0.36 * line.x_height_mm
        grey[round(y_mm / page.page.mm_per_pixel)] = grey[0, 0]
    assert len(find_lines(Page(grey, page.page.mm_per_pixel))) == 2


@pytest.mark.parametrize("x_height_px", [3.0, 4.0])
def test_small_print_is_enlarged(x_height_px):
    page = print_page(some_lines(12, 40), size_pt=10, dpi=300)
    part = x_height_px / (page.lines[0].x_height_mm / page.page.mm_per_pixel)
    grey = cv2.resize(page.page.grey, None, fx=part, fy=part, interpolation=cv2.INTER_AREA)
    small = Page(np.asarray(grey), page.page.mm_per_pixel / part)
    assert len(find_lines(small)) == 12


def test_a_large_headline_keeps_the_small_print_under_it():
    page = print_page(some_lines(8, 40), size_pt=9, dpi=150)
    grey = np.vstack([np.full((170, page.page.grey.shape[1]), 235, np.uint8), page.page.grey[70:]])
    cv2.putText(grey, "NEWS", (90, 165), cv2.FONT_HERSHEY_SIMPLEX, 5, 20, 22)
    found = find_lines(Page(grey, page.page.mm_per_pixel))
    assert len(found) == 9
    assert found[0].x_height_mm > 3 * found[1].x_height_mm


def test_figures_set_tight_in_wide_letters_are_lines():
    sheet = np.full((700, 900), 235, np.uint8)
    for row in range(12):
        figures = "   ".join(f"{(7 * row + 11 * k) % 90 + 10}" for k in range(5))
        line = np.full((44, 500), 235, np.uint8)
        cv2.putText(line, figures, (5, 36), cv2.FONT_HERSHEY_SIMPLEX, 1.1, 20, 3)
        wide = cv2.resize(line, (800, 44))
        top = 60 + 32 * row
        sheet[top : top + 44, 50:850] = np.minimum(sheet[top : top + 44, 50:850], wide)
    assert len(find_lines(Page(sheet, 0.1))) == 12


def test_a_line_ends_at_a_picture():
    page = print_page(some_lines(8, 30), size_pt=11, dpi=150)
    grey = np.pad(page.page.grey, ((0, 0), (130, 0)), constant_values=235)
    left = round(page.lines[0].baseline_mm[0, 0] / page.page.mm_per_pixel) + 130
    cv2.rectangle(grey, (left - 210, 90), (left - 10, 308), 25, 3)
    cv2.circle(grey, (left - 130, 200), 100, 25, -1)
    for y in (117, 146, 175, 203):
        cv2.rectangle(grey, (left - 25, y - 11), (left - 18, y), 25, 2)
    lines = find_lines(Page(grey, page.page.mm_per_pixel))
    beside = [line for line in lines if line.right_mm > left * page.page.mm_per_pixel + 20]
    assert len(beside) >= 7
    assert all(line.left_mm > (left - 12) * page.page.mm_per_pixel for line in beside)


@pytest.mark.parametrize("below_px", [1, 2, 4])
def test_underlined_words_stay_in_their_line(below_px):
    page = print_page(some_lines(10, 40), size_pt=11, dpi=150)
    grey, per_mm = page.page.grey.copy(), 1 / page.page.mm_per_pixel
    for index, line in enumerate(page.lines):
        first, last = line.baseline_mm[[0, -1], 0] * per_mm
        start = first + (last - first) * (index % 3) / 3
        y = round(line.baseline_mm[0, 1] * per_mm) + below_px
        grey[y, round(start) : round(start + 0.25 * (last - first))] = 30
    assert_found(page, find_lines(Page(grey, page.page.mm_per_pixel)))


@pytest.fixture(scope="module")
def panel():
    """Return a page with a dark panel of three lines in its middle, and the panel's slices."""
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
