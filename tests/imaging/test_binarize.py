"""Ink is found in a sensor's frames, and paper, shadows and noise stay silent."""

import cv2
import numpy as np
import pytest

from smarttouch.imaging.tactile_mapper import Binarizer

from ..pages.printed import PAPERS, blank_papers, print_page, some_lines
from ..support.full import sample

SECOND = 10**9


@pytest.fixture
def binarizer():
    return Binarizer((64, 64))


def share(mask):
    return float((mask > 0).mean())


def bars(level, noise, seed=0):
    """Return a patch of unevenly lit paper with bars of ink, and where these are."""
    y, x = np.mgrid[:64, :64]
    ink = (x % 16 < 4) & (y > 8) & (y < 56)
    light = 230 * (1 - 0.08 * (((x - 32) / 32) ** 2 + ((y - 32) / 32) ** 2) / 2)
    grain = np.random.default_rng(seed).normal(0, noise, ink.shape)
    return np.clip(light * np.where(ink, level, 1) + grain, 0, 255).astype(np.uint8), ink


@pytest.mark.parametrize("light_on_dark", [False, True])
@pytest.mark.parametrize("noise", [0, 2, 5])
@pytest.mark.parametrize("level", [0.1, 0.3, 0.5, 0.7, 0.8, 0.85])
def test_print_of_any_contrast_is_seen(level, noise, light_on_dark):
    image, truth = bars(level, noise)
    binarizer = Binarizer((64, 64), light_on_dark)
    ink = binarizer.ink(255 - image if light_on_dark else image, 0, True) > 0
    assert 2 * (ink & truth).sum() / (ink.sum() + truth.sum()) > 0.8


LIGHTS = {
    "even": lambda grey, x: grey,
    "dim": lambda grey, x: 0.45 * grey,
    "slope": lambda grey, x: grey * (1 - 0.5 * x),
    "shadow": lambda grey, x: grey * (1 - 0.4 / (1 + np.exp((0.5 - x) / 0.01))),
    "pale": lambda grey, x: 235 - 0.35 * (235 - grey),
    "grain": lambda grey, x: grey + np.random.default_rng(1).normal(0, 12, grey.shape),
}


@pytest.mark.parametrize("light", LIGHTS)
def test_a_finger_over_print_feels_its_true_ink(light):
    page = print_page(some_lines(12, 40), size_pt=11, dpi=150).page.grey
    seen = LIGHTS[light](page.astype(float), np.linspace(0, 1, page.shape[1]))
    seen, truth = np.clip(seen, 0, 255).astype(np.uint8), np.float32(page < 130)
    areas = []
    for y in range(100, page.shape[0] - 64, 40):
        binarizer = Binarizer((64, 64))
        for x in range(90, page.shape[1] - 160, 8):
            box = np.s_[y : y + 64, x : x + 64]
            ink = binarizer.ink(np.ascontiguousarray(seen[box]), x * SECOND // 400, x > 90) / 255
            small = [cv2.resize(np.float32(each), (16, 16), interpolation=cv2.INTER_AREA)
                     for each in (truth[box], ink)]  # fmt: skip
            areas.append(np.reshape(small, (2, -1)))
    assert np.corrcoef(np.hstack(areas))[0, 1] > 0.95


@pytest.mark.parametrize("noise", [0, 2, 5, 9, 14])
@pytest.mark.parametrize("level", [0.93, 1])
def test_paper_with_faint_rules_is_silent(binarizer, level, noise):
    for seed in sample(range(10), 4):
        assert share(binarizer.ink(bars(level, noise, seed)[0], 0, True)) <= 0.01


@pytest.mark.parametrize("grain", [1, 2, 3])
@pytest.mark.parametrize("seed", sample(range(10), 4))
def test_noise_of_any_grain_is_silent(binarizer, grain, seed):
    coarse = np.random.default_rng(seed).integers(0, 256, (64 // grain + 1,) * 2, np.uint8)
    noise = np.kron(coarse, np.ones((grain, grain), np.uint8))[:64, :64]
    assert share(binarizer.ink(np.ascontiguousarray(noise), 0, True)) <= 0.02


@pytest.mark.parametrize("name", PAPERS)
def test_a_finger_over_paper_without_print_gets_nothing(binarizer, name):
    page = cv2.resize(blank_papers()[name], None, fx=2, fy=2)
    shares, time_ns = [], 0
    for y in range(0, page.shape[0] - 64, 96):
        for x in range(page.shape[1] - 64, 0, -24):
            # Lifted on the way to the next row.
            patch = np.ascontiguousarray(page[y : y + 64, x : x + 64])
            shares.append(share(binarizer.ink(patch, time_ns, touching=x < page.shape[1] - 64)))
            time_ns += SECOND // 20
    assert np.mean(shares) <= 0.01


def test_dimming_light_and_a_darker_place_to_land_stay_silent(binarizer):
    for tenth in range(20):
        image = np.full((64, 64), 230 - 8 * tenth, np.uint8)
        assert share(binarizer.ink(image, tenth * SECOND // 10, True)) == 0
    binarizer.ink(np.full((64, 64), 255, np.uint8), 2 * SECOND, True)
    assert share(binarizer.ink(np.full((64, 64), 40, np.uint8), 2 * SECOND + 1, False)) == 0


@pytest.mark.parametrize(("ink", "seen"), [(30, 1.0), (70, 0.0)])
def test_only_a_black_area_is_ink(binarizer, patch, ink, seen):
    binarizer.ink(patch(0, 0), 0, True)
    for tenth in (1, 10):  # the white outlasts it
        assert share(binarizer.ink(patch(0, 64, ink=ink), tenth * SECOND // 10, True)) == seen
    half = binarizer.ink(patch(0, 40, ink=ink), SECOND, True)
    assert share(half[:, :36]) == seen
    assert share(half[:, 44:]) == 0


def test_bold_strokes_of_grey_print_are_ink_and_tiny_frames_work(binarizer, patch):
    assert share(binarizer.ink(patch(20, 44, ink=70), 0, True)) > 0.3
    assert Binarizer((2, 2)).ink(np.zeros((2, 2), np.uint8), 0, True).shape == (2, 2)
