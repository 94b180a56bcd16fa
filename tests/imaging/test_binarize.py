"""Ink is found, blank paper and noise stay silent."""

import cv2
import numpy as np
import pytest

from smarttouch.imaging.tactile_mapper import Binarizer

from ..pages.printed import PAPERS, blank_papers
from ..whole import sample

SECOND = 10**9


@pytest.fixture
def binarizer():
    return Binarizer((64, 64))


def share(mask):
    return float((mask > 0).mean())


def test_a_bar_of_ink(binarizer, patch):
    ink = binarizer.ink(patch(24, 40), 0, True)
    assert ink[:, 26:38].all()
    assert not ink[:, :22].any()
    assert not ink[:, 42:].any()


@pytest.mark.parametrize("paper", [60, 128, 200, 255])
def test_blank_paper_of_any_grey(binarizer, paper):
    image = np.full((64, 64), paper, np.uint8)
    noise = np.random.default_rng(1).normal(0, 3, image.shape)
    assert share(binarizer.ink(np.clip(image + noise, 0, 255).astype(np.uint8), 0, True)) == 0


@pytest.mark.parametrize("grain", [1, 2, 3])
@pytest.mark.parametrize("seed", sample(range(10), 4))
def test_noise_of_any_grain(binarizer, grain, seed):
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 256, (64 // grain + 1, 64 // grain + 1), np.uint8)
    noise = np.kron(coarse, np.ones((grain, grain), np.uint8))[:64, :64]
    assert share(binarizer.ink(np.ascontiguousarray(noise), 0, True)) <= 0.02


def test_white_is_remembered_over_a_black_area(binarizer, patch):
    binarizer.ink(patch(0, 0), 0, True)
    black = patch(0, 64)
    assert share(binarizer.ink(black, SECOND // 10, True)) == 1
    assert share(binarizer.ink(black, SECOND, True)) == 1


def test_dimming_light_stays_silent(binarizer):
    for tenth in range(20):
        grey = round(230 - 8 * tenth)
        image = np.full((64, 64), grey, np.uint8)
        assert share(binarizer.ink(image, tenth * SECOND // 10, True)) == 0


def test_a_lifted_finger_resets_the_white(binarizer, patch):
    binarizer.ink(patch(0, 0, paper=255), 0, True)
    dim = np.full((64, 64), 100, np.uint8)
    assert share(binarizer.ink(dim, 1, False)) == 0


def test_light_on_dark(patch):
    negative = 255 - patch(24, 40)
    ink = Binarizer((64, 64), light_on_dark=True).ink(negative, 0, True)
    assert np.array_equal(ink, Binarizer((64, 64)).ink(patch(24, 40), 0, True))


def test_tiny_frames_work():
    assert Binarizer((2, 2)).ink(np.zeros((2, 2), np.uint8), 0, True).shape == (2, 2)


def faint_bars(level, noise, seed=0):
    """Return a patch of unevenly lit paper with bars of ink, and where these are."""
    y, x = np.mgrid[:64, :64]
    ink = (x % 16 < 4) & (y > 8) & (y < 56)
    light = 230 * (1 - 0.08 * (((x - 32) / 32) ** 2 + ((y - 32) / 32) ** 2) / 2)
    grain = np.random.default_rng(seed).normal(0, noise, ink.shape)
    return np.clip(light * np.where(ink, level, 1) + grain, 0, 255).astype(np.uint8), ink


@pytest.mark.parametrize("noise", [0, 2, 5])
@pytest.mark.parametrize("level", [0.3, 0.5, 0.7, 0.8, 0.85])
def test_faint_print_is_seen(binarizer, level, noise):
    image, truth = faint_bars(level, noise)
    ink = binarizer.ink(image, 0, True) > 0
    assert 2 * (ink & truth).sum() / (ink.sum() + truth.sum()) > 0.8


@pytest.mark.parametrize("noise", [0, 2, 5, 9, 14])
@pytest.mark.parametrize("level", [0.93, 1])
def test_paper_with_faint_rules_is_silent(binarizer, level, noise):
    for seed in sample(range(10), 4):
        image, _ = faint_bars(level, noise, seed)
        assert share(binarizer.ink(image, 0, True)) <= 0.01


@pytest.mark.parametrize("name", PAPERS)
def test_a_finger_over_paper_without_print_gets_nothing(binarizer, name):
    page = cv2.resize(blank_papers()[name], None, fx=2, fy=2)
    found, time_ns = [], 0
    for y in range(0, page.shape[0] - 64, 96):
        for x in range(page.shape[1] - 64, 0, -24):
            # Lifted on the way to the next row.
            patch = np.ascontiguousarray(page[y : y + 64, x : x + 64])
            found.append(share(binarizer.ink(patch, time_ns, touching=x < page.shape[1] - 64)))
            time_ns += SECOND // 20
    assert np.mean(found) <= 0.01


@pytest.mark.parametrize(("ink", "seen"), [(30, 1.0), (70, 0.0)])
def test_only_a_black_area_is_ink(binarizer, patch, ink, seen):
    binarizer.ink(patch(0, 0), 0, True)
    assert share(binarizer.ink(patch(0, 64, ink=ink), 1, True)) == seen
    half = binarizer.ink(patch(0, 40, ink=ink), 2, True)
    assert share(half[:, :36]) == seen
    assert share(half[:, 44:]) == 0


def test_bold_strokes_of_grey_print_are_no_area(binarizer, patch):
    assert share(binarizer.ink(patch(20, 44, ink=70), 0, True)) > 0.3
