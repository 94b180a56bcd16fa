"""Detection of Braille in pictures; print, halftones and dotted paper are not Braille."""

import cv2
import numpy as np
import pytest
import skimage.data

from smarttouch.braille.dot_detection import shows_dots
from smarttouch.braille.grade1 import Grade1
from smarttouch.pages.prepared_page import print_text

from ..pages.printed import print_page, some_lines
from ..support.full import sample
from .drawn_dots import draw_dots

LINES = [Grade1().encode(line) for line in some_lines(12, 24)]
BRAILLE = draw_dots(LINES)


def turned(picture, degrees):
    height, width = picture.shape
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), degrees, 0.8)
    return cv2.warpAffine(picture, turn, (width, height), borderValue=225)


def lit_from_the_side(picture):
    """Return a picture of embossed dots, each bright on one side and dark on the other."""
    slope = sum(np.gradient(cv2.GaussianBlur(picture.astype(float), (0, 0), 2)))
    noise = np.random.default_rng(1).normal(0, 3, picture.shape)
    return np.clip(190 + 2 * slope + noise, 0, 255).astype(np.uint8)


def halftone(picture, pitch_px, degrees):
    y, x = np.indices(picture.shape) * (2 * np.pi / pitch_px)
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    screen = 0.5 - 0.25 * (np.cos(x * cos + y * sin) + np.cos(y * cos - x * sin))
    return np.where(picture / 255 > screen, 255, 0).astype(np.uint8)


def lattice(share):
    dots = np.random.default_rng(2).random((24, 24)) < share
    page = np.full((520, 520), 225, np.uint8)
    for row, column in np.argwhere(dots):
        cv2.circle(page, (int(column) * 20 + 30, int(row) * 20 + 30), 6, 60, -1, cv2.LINE_AA)
    return page


@pytest.mark.parametrize("picture", [
    BRAILLE, 255 - BRAILLE, turned(BRAILLE, 7), np.ascontiguousarray(np.rot90(BRAILLE)),
    lit_from_the_side(draw_dots(LINES, 18.0)), draw_dots(LINES, 30.0),
    cv2.GaussianBlur(BRAILLE, (0, 0), 2),
], ids=["drawn", "light on dark", "turned", "sideways", "embossed", "large", "soft"])  # fmt: skip
def test_braille_is_recognized(picture):
    assert shows_dots(picture)


HEBREW = "האדם מניח את ידו על הנייר ויודע אם הוא חלק או גס"


def photograph():
    return cv2.resize(skimage.data.camera(), (800, 800))


OTHERS = {
    "print": lambda: print_text("\n".join(some_lines(20))).grey,
    "small print": lambda: print_page(some_lines(40), size_pt=7, dpi=100).page.grey,
    "Hebrew": lambda: print_page([HEBREW] * 20, size_pt=9, dpi=150, font="DejaVuSans").page.grey,
    "leaders": lambda: print_page([". " * 40] * 30, size_pt=10, dpi=150).page.grey,
    "halftone": lambda: halftone(photograph(), 12, 45),
    "tint": lambda: halftone(np.full((700, 700), 180, np.uint8), 9, 15),
    "dotted paper": lambda: lattice(1.0),
    "dots at random on a lattice": lambda: lattice(0.5),
    "photograph": photograph,
    "noise": lambda: np.random.default_rng(3).integers(0, 256, (400, 500), np.uint8),
    "white": lambda: np.full((300, 400), 255, np.uint8),
    "strip": lambda: np.full((8, 20_000), 255, np.uint8),
    "tiny": lambda: np.full((8, 8), 200, np.uint8),
}


@pytest.mark.parametrize("name", sample(OTHERS))
def test_other_pages_are_not_taken_for_braille(name):
    assert not shows_dots(OTHERS[name]())
