"""Photographed pages of Braille are read; pages of anything else are not."""

import re
from collections import Counter

import cv2
import numpy as np
import pytest
import skimage.data
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from rapidfuzz.distance import Levenshtein
from scipy.spatial import cKDTree

from smarttouch.braille.photo import looks_like_braille, read_braille
from smarttouch.documents.page_image import Page
from smarttouch.errors import PageError

from ..raising import raises
from .embossed import emboss, printed, random_lines

LINES = random_lines(7, 12, seed=6)
BACK = random_lines(7, 12, seed=7)
WORDS = ["⠞⠓⠑⠀⠟⠥⠊⠉⠅⠀⠋⠕⠭"]
LABEL = ["⠓⠑⠇⠇⠕"]
TEXT = ["⠠⠞⠓⠑⠀⠟⠥⠊⠉⠅⠀⠃⠗⠕⠺⠝⠀⠋⠕⠭", "⠚⠥⠍⠏⠎⠲", "", "⠀⠀⠠⠝⠑⠺⠀⠏⠁⠗⠁⠛⠗⠁⠏⠓"]
POOR = {
    "skew_deg": 5,
    "blur_px": 2.5,
    "noise": 6,
    "shading": 0.5,
    "texture": 2,
    "perspective": 0.08,
}


def f_measure(found_px, true_px, pitch_px):
    """F of dots; one that is within a third of a pitch of a true one is found."""
    away, nearest = cKDTree(true_px).query(found_px)
    hits = len(set(nearest[away < pitch_px / 3]))
    return 2 * hits / (len(found_px) + len(true_px))


def characters_right(lines, expected):
    text = "\n".join(expected)
    return 1 - Levenshtein.distance("\n".join(lines), text) / len(text)


def scores(lines, light_from_deg=None, **how):
    photo = emboss(lines, **how)
    read = read_braille(photo.page, light_from_deg)
    pitch_px = how.get("dot_mm", 2.34) * how.get("px_per_mm", 8.0)
    assert read.dot_pitch_px == pytest.approx(pitch_px, rel=0.06)
    assert read.skew_deg == pytest.approx(how.get("skew_deg", 0.0), abs=1)
    found = f_measure(read.dots_px, photo.dots_px, pitch_px)
    return found, characters_right(read.lines, lines), read


CONDITIONS = {
    "clean": {},
    "shading": {"shading": 0.8},
    "blur of a third of a pitch": {"blur_px": 6.2},
    "skew 7": {"skew_deg": 7},
    "skew 12": {"skew_deg": 12},
    "skew -25": {"skew_deg": -25},
    "noise": {"noise": 20},
    "rough paper": {"texture": 6},
    "perspective": {"perspective": 0.2},
    "curled": {"curl_mm": 5},
    "uneven dots": {"uneven": 0.2},
    "4 px/mm": {"px_per_mm": 4},
    "12 px/mm": {"px_per_mm": 12},
    "Marburg medium": {"dot_mm": 2.5, "cell_mm": 6.0},
    "Japan": {"dot_mm": 2.2, "cell_mm": 5.9, "line_mm": 11.0},
    "all at once": POOR,
}


@pytest.mark.parametrize("condition", CONDITIONS)
def test_pages(condition):
    found, right, read = scores(LINES, **CONDITIONS[condition])
    # Measured: 1.000 and 1.000 in each.
    assert found > 0.99
    assert right > 0.98
    assert read.certainty > 0.7
    # No side of the page is to choose, so no angle of light is told.
    assert not any("°" in note for note in read.notes)


@pytest.mark.parametrize("light_deg", range(0, 360, 90))
def test_light_from_anywhere(light_deg):
    found, right, _ = scores(LINES, light_deg=light_deg)
    assert (found, right) == (1, 1)


@pytest.mark.parametrize(("light_deg", "dent"), [(0, 1.0), (135, 0.8), (200, 1.0), (200, 0.8)])
def test_pages_embossed_from_both_sides(light_deg, dent):
    """The direction of the light tells which side is read."""
    how = {"light_deg": light_deg, "back_side": BACK, "dent": dent}
    found, right, _ = scores(LINES, light_from_deg=light_deg, **how)
    assert found > 0.99
    assert right > 0.98


def test_which_side_is_read_is_said_if_nobody_knows():
    photo = emboss(LINES, light_deg=60, back_side=BACK)
    (note,) = read_braille(photo.page).notes
    light_deg = int(re.findall(r"(\d+)°", note)[0])
    assert 60 <= light_deg < 70
    # With light from the other side, the same picture shows the same page from behind.
    other = read_braille(photo.page, light_from_deg=240)
    mirrored = [
        "".join(
            chr(0x2800 + (ord(cell) >> 3 & 7 | (ord(cell) & 7) << 3)) for cell in reversed(line)
        )
        for line in BACK
    ]
    assert characters_right(other.lines, [line.rstrip("\u2800") for line in mirrored]) > 0.98


@pytest.mark.parametrize("lines", [LABEL, WORDS, TEXT], ids=["label", "words", "text"])
@pytest.mark.parametrize("how", [{}, {"px_per_mm": 5}, POOR], ids=["clean", "small", "poor"])
def test_few_words(lines, how):
    found, right, _ = scores(lines, **how)
    assert (found, right) == (1, 1)


@pytest.mark.parametrize("how", [{"px_per_mm": 4}, {**POOR, "curl_mm": 4, "px_per_mm": 6}])
def test_a_full_page(how):
    lines = random_lines(25, 40, seed=5)
    found, right, _ = scores(lines, **how)
    assert found > 0.999
    assert right > 0.999


def test_a_page_on_a_table():
    """Wood has more edges than the page has dots."""
    rng = np.random.default_rng(1)
    photo = emboss(TEXT, skew_deg=4, perspective=0.06)
    rows, columns = photo.page.grey.shape
    grain = rng.standard_normal((rows + 300, columns + 400), np.float32)
    grain = cv2.GaussianBlur(grain, (0, 0), sigmaX=25, sigmaY=1.2)
    wood = 70 + 15 * grain / grain.std()
    picture = np.clip(wood, 0, 255).astype(np.uint8)
    picture[150 : 150 + rows, 200 : 200 + columns] = photo.page.grey
    assert read_braille(Page(picture, 0.1)).lines == TEXT


def test_worn_dots_are_all_that_is_lost():
    _, right, read = scores(LINES, lost=0.1)
    assert 0.6 < right < 0.95
    assert len(read.lines) == len(LINES)


@pytest.mark.parametrize("light_on_dark", [False, True])
def test_printed_dots(light_on_dark):
    photo = emboss(LINES, skew_deg=3)
    assert read_braille(printed(photo, 5.0, light_on_dark)).lines == LINES


def test_upside_down():
    photo = emboss(TEXT)
    page = Page(np.ascontiguousarray(photo.page.grey[::-1, ::-1]), 0.1)
    read = read_braille(page, turned=True)
    assert read.lines == TEXT
    size = np.array(page.grey.shape[::-1])
    assert f_measure(size - 1 - read.dots_px, photo.dots_px, 18.7) == 1
    assert read_braille(page, 300, turned=True).lines == TEXT
    assert read_braille(page).lines != TEXT


cell = st.integers(0, 63).map(lambda dots: chr(0x2800 + dots))


@given(st.lists(st.text(cell, min_size=3, max_size=8), min_size=1, max_size=3), st.integers(0, 99))
@settings(max_examples=12, deadline=None)
def test_any_cells_come_back(lines, seed):
    """Sixteen dots do, if some tell where cells begin: a lone dot could be any of six."""
    lines = [line.rstrip("\u2800") for line in lines]
    dots = [ord(each) - 0x2800 for line in lines for each in line]
    assume(sum(each.bit_count() for each in dots) >= 16)
    assume(any(each & 0o07 and each & 0o70 for each in dots))
    rows = [[any(ord(each) & bits for each in line) for bits in (0o11, 0o44)] for line in lines]
    assume(any(all(row) for row in rows))
    # Cells that are nearly all alike are taken for a pattern.
    commonest = Counter(each for each in dots if each).most_common(3)
    assume(sum(count for _, count in commonest) <= 0.8 * sum(map(bool, dots)))
    # Nor do dots tell of blank cells before them.
    assume(lines[0] and lines[-1] and any(line and ord(line[0]) & 7 for line in lines))
    assert read_braille(emboss(lines, px_per_mm=6, seed=seed).page).lines == lines


def grey_picture(name):
    picture = np.asarray(getattr(skimage.data, name)())
    return picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)


def typed_page():
    page = np.full((400, 900), 225, np.uint8)
    for row in range(40, 380, 32):
        text = "The quick brown fox jumps over ... iii : 1001 the lazy dog"
        cv2.putText(page, text, (30, row), cv2.FONT_HERSHEY_SIMPLEX, 0.8, 30, 2, cv2.LINE_AA)
    return page


def dotted_paper():
    page = np.full((500, 500), 225, np.uint8)
    for x, y in np.argwhere(np.ones((25, 25))) * 18 + 30:
        cv2.circle(page, (int(x), int(y)), 3, 60, -1, cv2.LINE_AA)
    return page


OTHER = {
    "blank": lambda: emboss(["\u2800" * 8] * 3).page.grey,
    "rough": lambda: emboss(["\u2800" * 8] * 3, texture=6, shading=0.5).page.grey,
    "typed": typed_page,
    "dotted paper": dotted_paper,
    "white": lambda: np.full((300, 400), 255, np.uint8),
    "black": lambda: np.zeros((300, 400), np.uint8),
    "tiny": lambda: np.full((8, 8), 200, np.uint8),
    "noise": lambda: np.random.default_rng(1).integers(0, 256, (400, 400), np.uint8),
    "strip": lambda: np.random.default_rng(1).integers(0, 256, (8, 20_000), np.uint8),
    "two dots": lambda: printed(emboss(["⠃"]), 5.0).grey,
    **{
        name: lambda name=name: grey_picture(name)
        for name in ("astronaut", "brick", "coins", "grass", "page", "text")
    },
    "checkerboard": skimage.data.checkerboard,
}


@pytest.mark.parametrize("name", OTHER)
def test_what_is_no_braille_is_one_sentence(name):
    page = Page(OTHER[name](), 0.1)
    with raises(
        PageError, about="page", problem=lambda each: each in ("empty", "too few", "pattern")
    ):
        read_braille(page)
    assert not looks_like_braille(page)


@pytest.mark.parametrize("light_deg", [float("nan"), float("inf")])
def test_light_from_nowhere(light_deg):
    value = pytest.approx(light_deg, nan_ok=True)
    with raises(PageError, about="light_from_deg", problem="malformed", value=value):
        read_braille(emboss(LABEL).page, light_deg)


@pytest.mark.parametrize("how", [{}, POOR, {"px_per_mm": 4}, {"px_per_mm": 12, "back_side": BACK}])
def test_braille_looks_like_it(how):
    assert looks_like_braille(emboss(LINES, **how).page)
