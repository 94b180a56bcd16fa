"""Photographed pages of Braille are read; pages of anything else are not."""

import cv2
import numpy as np
import pytest
import skimage.data
from rapidfuzz.distance import Levenshtein

from smarttouch.base.errors import PageError
from smarttouch.braille import cell_detection, louis
from smarttouch.braille.grade1 import Grade1
from smarttouch.braille.photo import LEAST_CERTAINTY, looks_like_braille, read_braille
from smarttouch.braille.sides import DIGITS, FREQUENT
from smarttouch.pages.page_image import Page

from ..raising import raises
from ..whole import sample
from .embossed import emboss, printed, random_lines
from .mirror_odds import frequent
from .sentences import make_sentences

LINES = random_lines(7, 12, seed=6)
BACK = random_lines(7, 12, seed=7)
WORDS = ["⠞⠓⠑⠀⠟⠥⠊⠉⠅⠀⠋⠕⠭"]
LABEL = ["⠓⠑⠇⠇⠕"]
TEXT = ["⠠⠞⠓⠑⠀⠟⠥⠊⠉⠅⠀⠃⠗⠕⠺⠝⠀⠋⠕⠭", "⠚⠥⠍⠏⠎⠲", "", "⠀⠀⠠⠝⠑⠺⠀⠏⠁⠗⠁⠛⠗⠁⠏⠓"]
POOR = {
    "skew_deg": 5, "blur_px": 2.5, "noise": 6, "shading": 0.5, "texture": 2, "perspective": 0.08,
}  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def each_part_looked_at_once():
    """Remember what the network found: a page is looked at again and again, white paper most."""
    remembered = {}

    def find(grey):
        key = grey.shape, grey.tobytes()
        if key not in remembered:
            remembered[key] = cell_detection.find_cells(grey)
        return remembered[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("smarttouch.braille.photo.find_cells", find)
        yield


def characters_right(lines, expected):
    text = "\n".join(expected)
    return 1 - Levenshtein.distance("\n".join(lines), text) / len(text)


def scores(lines, light_from_deg=None, **how):
    read = read_braille(emboss(lines, **how).page, light_from_deg)
    return characters_right(read.lines, lines), read


CONDITIONS = {
    "clean": {}, "skew -20": {"skew_deg": -20, "px_per_mm": 5}, "noise": {"noise": 12},
    "curled": {"curl_mm": 5}, "4 px/mm": {"px_per_mm": 4},
    "Japan": {"dot_mm": 2.2, "cell_mm": 5.9, "line_mm": 11.0},
    "light from below": {"light_deg": 250}, "all at once": POOR,
}  # fmt: skip


@pytest.mark.parametrize("condition", sample(CONDITIONS, 3))
def test_pages(condition):
    right, read = scores(LINES, **CONDITIONS[condition])
    # Measured: .92 and more, .98 in most.
    assert right > 0.9
    assert read.certainty > LEAST_CERTAINTY + 0.1
    assert len(read.cells_px) == len(read.patterns)


def test_the_side_that_is_read_is_reported_if_unknown():
    photo = emboss(LINES, light_deg=100, back_side=BACK)
    read = read_braille(photo.page)
    assert characters_right(read.lines, LINES) > 0.9
    assert len(read.notes) == 1
    # With light from the other side, the same picture shows the same page from behind.
    other = read_braille(photo.page, light_from_deg=280)
    mirrored = [
        "".join(
            chr(0x2800 + (ord(cell) >> 3 & 7 | (ord(cell) & 7) << 3)) for cell in reversed(line)
        )
        for line in BACK
    ]
    assert characters_right(other.lines, [line.rstrip("\u2800") for line in mirrored]) > 0.8


def english_lines(seed):
    """Return lines of 24 cells of sentences, none of them with a blank end."""
    cells = Grade1().encode(" ".join(make_sentences("english", 12, seed)))
    lines = [cells[k : k + 24] for k in range(0, 240, 24)]
    return [line.replace("\u2800", "⠿") for line in lines]


@pytest.mark.parametrize("light_deg", sample([70, 110, 250], 3))
def test_the_front_is_what_is_not_mirrored(light_deg):
    front, back = english_lines(1), english_lines(2)
    right, read = scores(front, light_deg=light_deg, back_side=back)
    assert right > 0.95
    assert not read.notes
    away = (read.light_from_deg - light_deg + 180) % 360 - 180
    assert abs(away) < 30


@pytest.mark.parametrize("light_deg", sample([80, 260]))
def test_a_sheet_from_behind_is_not_read(light_deg):
    behind = emboss(english_lines(3), light_deg=180 - light_deg).page.grey[:, ::-1]
    dents = Page(255 - np.ascontiguousarray(behind), 0.1)
    with raises(PageError, about="page"):
        read_braille(dents)


def test_the_table_of_mirror_images_is_what_its_script_makes():
    if louis.version() is None:
        pytest.skip("liblouis is not installed")
    own, made = ([list(map(DIGITS.index, row)) for row in each] for each in (FREQUENT, frequent()))
    # Tables change with the version of liblouis, by a cell or two.
    assert np.abs(np.subtract(own, made)).max() < 10


@pytest.mark.parametrize("lines", sample([LABEL, WORDS, TEXT], 3), ids=len)
def test_few_words(lines):
    right, _ = scores(lines, px_per_mm=5)
    # Measured: one of five cells is wrong, 1 and 1.
    assert right > (0.75 if lines is LABEL else 0.9)


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
    assert characters_right(read_braille(Page(picture, 0.1)).lines, TEXT) > 0.9


def test_worn_dots_are_all_that_is_lost():
    right, read = scores(LINES, lost=0.1)
    assert 0.5 < right < 0.95
    assert len(read.lines) == len(LINES)


@pytest.mark.parametrize("light_on_dark", [False, True])
def test_printed_dots(light_on_dark):
    photo = emboss(LINES, skew_deg=3)
    read = read_braille(printed(photo, 5.0, light_on_dark))
    # Measured: 1 and .90, the latter with a warning.
    assert characters_right(read.lines, LINES) > (0.85 if light_on_dark else 0.9)
    assert bool(read.notes) >= light_on_dark


def grey_picture(name):
    picture = np.asarray(getattr(skimage.data, name)())[:300, :400]
    return picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)


def typed_page():
    page = np.full((250, 500), 225, np.uint8)
    for row in range(40, 230, 32):
        text = "The quick brown fox jumps over ... iii : 1001 the lazy dog"
        cv2.putText(page, text, (30, row), cv2.FONT_HERSHEY_SIMPLEX, 0.8, 30, 2, cv2.LINE_AA)
    return page


def dotted_paper():
    page = np.full((320, 320), 225, np.uint8)
    for x, y in np.argwhere(np.ones((15, 15))) * 18 + 30:
        cv2.circle(page, (int(x), int(y)), 3, 60, -1, cv2.LINE_AA)
    return page


OTHER = {
    "blank": lambda: emboss(["\u2800" * 8] * 3, px_per_mm=4).page.grey,
    "rough": lambda: emboss(["\u2800" * 8] * 3, px_per_mm=4, texture=6, shading=0.5).page.grey,
    "typed": typed_page,
    "dotted paper": dotted_paper,
    "white": lambda: np.full((300, 400), 255, np.uint8),
    "black": lambda: np.zeros((300, 400), np.uint8),
    "tiny": lambda: np.full((8, 8), 200, np.uint8),
    "noise": lambda: np.random.default_rng(1).integers(0, 256, (250, 300), np.uint8),
    "strip": lambda: np.random.default_rng(1).integers(0, 256, (8, 20_000), np.uint8),
    "two dots": lambda: printed(emboss(["⠃"]), 5.0).grey,
    **{
        name: lambda name=name: grey_picture(name)
        for name in ("astronaut", "brick", "coins", "grass", "page", "text")
    },
    "checkerboard": skimage.data.checkerboard,
}


@pytest.mark.parametrize("name", sample(OTHER, 5))
def test_what_is_no_braille_is_one_sentence(name):
    page = Page(OTHER[name](), 0.1)
    with raises(PageError, about="page"):
        read_braille(page)
    assert not looks_like_braille(page)


@pytest.mark.parametrize("light_deg", [float("nan"), float("inf")])
def test_light_from_nowhere(light_deg):
    value = pytest.approx(light_deg, nan_ok=True)
    with raises(PageError, about="light_from_deg", value=value):
        read_braille(emboss(LABEL).page, light_deg)


@pytest.mark.parametrize("how", [POOR, {"px_per_mm": 12, "back_side": BACK, "light_deg": 90}])
def test_braille_looks_like_it(how):
    assert looks_like_braille(emboss(LINES, **how).page)
