"""Dots are found where they are, raised or printed, and those of the other side are not."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from smarttouch.braille.dots import Look, even_light, find_dots, light_at, light_axis

from .embossed import emboss, printed, random_lines

LINES = random_lines(5, 8, seed=1)
PX_PER_MM = 6.0
PITCH_PX = 2.34 * PX_PER_MM
SIGMA_PX = 0.17 * PITCH_PX


def offsets(found_px, true_px):
    """Return the distance of each dot found from the nearest true one, in dot pitches."""
    return cKDTree(true_px).query(found_px)[0] / PITCH_PX


@pytest.mark.parametrize("light_deg", range(0, 360, 45))
def test_raised_dots_in_light_from_anywhere(light_deg):
    photo = emboss(LINES, px_per_mm=PX_PER_MM, light_deg=light_deg, shading=0.5)
    contrast = even_light(photo.page.grey)
    axis_deg, ratio = light_axis(contrast, SIGMA_PX)
    # Measured: 6.9° at worst, 1.6 at least.
    assert abs((axis_deg - light_deg + 90) % 180 - 90) < 12
    assert ratio > 1.4
    dots = find_dots(contrast, Look(SIGMA_PX, light_deg))
    dots_px = dots.px[dots.strength > 0.5]
    assert len(dots_px) == len(photo.dots_px)
    assert offsets(dots_px, photo.dots_px).max() < 0.12
    assert abs((light_at(contrast, dots_px, SIGMA_PX) - light_deg + 180) % 360 - 180) < 4


@pytest.mark.parametrize("light_on_dark", [False, True])
def test_printed_dots(light_on_dark):
    photo = emboss(LINES, px_per_mm=PX_PER_MM)
    page = printed(photo, 0.3 * PITCH_PX, light_on_dark)
    contrast = even_light(page.grey)
    dots = find_dots(contrast, Look(SIGMA_PX, ink_is_dark=not light_on_dark))
    dots_px = dots.px[dots.strength > 0.5]
    assert len(dots_px) == len(photo.dots_px)
    # Measured: 0.02, and 0.08 for light dots, whose contrast is cut off.
    assert offsets(dots_px, photo.dots_px).max() < 0.1
    assert light_axis(contrast, SIGMA_PX)[1] < 1.15


@pytest.mark.parametrize("light_deg", [20, 90, 135])
def test_hollows_are_weaker_than_dots(light_deg):
    """Rims of the other side's dots are told apart by strength."""
    back = random_lines(5, 8, seed=2)
    photo = emboss(LINES, px_per_mm=PX_PER_MM, light_deg=light_deg, back_side=back, uneven=0.04)
    dots = find_dots(even_light(photo.page.grey), Look(SIGMA_PX, light_deg))
    raised = offsets(dots.px, photo.dots_px) < 0.15
    assert raised.sum() == len(photo.dots_px)
    assert dots.strength[raised].min() > dots.strength[~raised].max()


def test_strength_is_that_of_a_short_label_too():
    """Few dots on rough paper: what is usual is not what most of the paper shows."""
    photo = emboss(["⠓⠑⠇⠇⠕"], px_per_mm=8, texture=2)
    dots = find_dots(even_light(photo.page.grey), Look(0.17 * 2.34 * 8, 120))
    assert (dots.strength > 0.5).sum() == len(photo.dots_px)
    assert np.median(dots.strength[:14]) == pytest.approx(1, abs=0.15)


@pytest.mark.parametrize("shape", [(8, 8), (8, 300), (64, 64)])
@pytest.mark.parametrize("grey", [0, 128, 255])
def test_nothing_on_nothing(shape, grey):
    contrast = even_light(np.full(shape, grey, np.uint8))
    for look in (Look(1.4, 30), Look(1.4), Look(1.4, ink_is_dark=False)):
        assert len(find_dots(contrast, look).px) == 0
    assert light_axis(contrast, 1.4)[1] == pytest.approx(1, abs=0.1)
