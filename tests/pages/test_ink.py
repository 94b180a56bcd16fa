"""Separation of ink from paper: in uneven light, noise and shadows, and on blank paper."""

import cv2
import numpy as np
import pytest
from skimage import data

from smarttouch.pages.ink import is_light_on_dark, separate_ink
from smarttouch.pages.page_and_lines import Page
from smarttouch.pages.prepared_page import FAINT, prepare_page

from .printed import PAPERS, blank_papers, degrade, print_page, some_lines


@pytest.fixture(scope="module")
def printed():
    return print_page(some_lines(12, 40), size_pt=11, dpi=150)


def overlap(found, truth):
    """Return the F1 score of detected ink pixels."""
    return 2 * (found & truth).sum() / (found.sum() + truth.sum())


MISTREATED = {
    "clean": {}, "uneven": {"uneven": 0.9, "noise": 6}, "noise": {"noise": 20},
    "jpeg": {"jpeg": 60}, "inverted": {"inverted": True, "uneven": 0.6, "noise": 5},
}  # fmt: skip


@pytest.mark.parametrize("case", MISTREATED)
def test_the_same_ink_is_found_in_any_light(printed, case):
    truth = printed.page.grey < 130
    paper = separate_ink(degrade(printed, **MISTREATED[case]).page.grey)
    assert overlap(paper.ink, truth) > 0.96
    assert paper.light_on_dark == (case == "inverted")
    # In the cleaned image paper is white and ink is black; edges of letters keep their grey levels.
    assert np.mean(paper.cleaned[printed.page.grey == 235] == 255) > 0.94
    assert np.median(paper.cleaned[printed.page.grey < 40]) < 40
    graded = (printed.page.grey > 60) & (printed.page.grey < 200)
    assert np.corrcoef(printed.page.grey[graded], paper.cleaned[graded])[0, 1] > 0.9


@pytest.mark.parametrize("noise", [0, 4])
@pytest.mark.parametrize("level", [60, 110, 130, 200])
def test_pale_print_beside_black_is_print_or_named(printed, level, noise):
    grey = printed.page.grey.astype(float)
    for line in printed.lines[::2]:
        y = round(line.baseline_mm[0, 1] / printed.page.mm_per_pixel)
        grey[y - 18 : y + 8] = 235 - (235 - grey[y - 18 : y + 8]) * (235 - level) / 210
    pale = (grey != printed.page.grey) & (printed.page.grey < 130)
    grey += np.random.default_rng(0).normal(0, noise, grey.shape)
    page = Page(np.clip(grey, 0, 255).astype(np.uint8), printed.page.mm_per_pixel)
    paper, is_print = separate_ink(page.grey), level < (180 if noise else 200)
    assert paper.faint == (not is_print)
    if is_print:
        assert paper.ink[pale].mean() > 0.9
        assert np.median(paper.cleaned[pale]) < 90
    else:
        assert FAINT in prepare_page(page).notes[-1]


def test_what_shows_through_from_the_back_is_not_ink(printed):
    front = printed.page.grey.astype(np.float32)
    back = cv2.GaussianBlur(235 - front[:, ::-1], (0, 0), 1.5)
    both = np.clip(np.minimum(front, 235 - 0.3 * back), 0, 255).astype(np.uint8)
    assert overlap(separate_ink(both).ink, front < 130) > 0.95


@pytest.mark.parametrize("contrast", [0.15, 0.3])
def test_a_page_of_faint_print_is_found(printed, contrast):
    grey = np.rint(190 - contrast * (235 - printed.page.grey.astype(float))).astype(np.uint8)
    assert overlap(separate_ink(grey).ink, printed.page.grey < 130) > 0.9


@pytest.mark.parametrize("light_on_dark", [None, False, True])
def test_at_least_38_of_40_blank_sheets_are_silent(light_on_dark):
    # A false edge can appear on a sheet with one much darker side, so 2 of 40 sheets may fail.
    random, silent = np.random.default_rng(0), 0
    for level in (3, *range(70, 256, 5), 255):
        light = 1 - random.uniform(0, 0.6) * np.linspace(0, 1, 90)
        grain = random.normal(0, random.uniform(0, 15), (60, 90))
        paper = separate_ink(np.clip(level * light + grain, 0, 255).astype(np.uint8), light_on_dark)
        silent += not paper.ink.any() and paper.cleaned.min() == 255
    assert silent >= 38


@pytest.mark.parametrize("name", [*PAPERS, "grass", "gravel"])
def test_paper_and_texture_without_print_are_silent(name):
    grey = blank_papers()[name] if name in PAPERS else getattr(data, name)()
    assert separate_ink(grey).ink.mean() < 0.0005


def test_neither_a_table_nor_a_dark_margin_is_ink_but_a_large_headline_is(printed):
    paper = separate_ink(degrade(printed, perspective=0.1, noise=4).page.grey)
    assert not paper.light_on_dark
    assert not paper.ink[:15, :15].any()
    assert paper.cleaned[:15, :15].mean() > 245
    grey = np.full((900, 1200), 235, np.uint8)
    cv2.putText(grey, "IBM", (200, 500), cv2.FONT_HERSHEY_SIMPLEX, 10, 20, 90)
    truth = grey < 128
    grey[:, :100] = 25
    assert overlap(separate_ink(grey).ink, truth) > 0.97


def test_black_print_of_one_bit_leaves_its_paper_white():
    page = print_page(some_lines(12, 60), size_pt=11, dpi=300).page
    grey = np.where(page.grey < 128, 0, 255).astype(np.uint8)
    cv2.rectangle(grey, (0, 0), (500, 60), 0, -1)
    assert not (separate_ink(grey).ink & (grey == 255)).any()


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("picture", ["page", "print"])
def test_light_on_dark_is_detected(printed, picture, inverted):
    grey = data.page() if picture == "page" else printed.page.grey
    assert is_light_on_dark(255 - grey if inverted else grey) == inverted


@pytest.mark.parametrize("shape", [(8, 8), (8, 300), (300, 8), (1, 50)])
def test_any_shape_is_taken(shape):
    grey = np.random.default_rng(0).integers(0, 256, shape).astype(np.uint8)
    paper = separate_ink(grey)
    assert paper.cleaned.shape == paper.ink.shape == shape
