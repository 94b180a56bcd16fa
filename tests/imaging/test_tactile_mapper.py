"""Ink causes activation, paper and noise do not; changes drive RA, lasting ink drives SAI."""

import cv2
import numpy as np
import pytest

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.imaging.reading_profile import profile_for_reading
from smarttouch.imaging.tactile_mapper import (
    FAINTEST_CHANGE,
    LEAVING,
    Binarizer,
    NaturalDrive,
    TactileMapper,
    Tone,
)
from smarttouch.sources.source_contract import Frame, Pose

from ..pages.printed import PAPERS, blank_papers, print_page, some_lines
from ..support.full import sample


def mapped(profile, image, tone=None):
    mapper = TactileMapper(profile, tone=tone)
    return mapper.map(Frame(image, 0, Pose(0, 0), 1.0), Mode.RA).activation[Afferent.RA]


@pytest.fixture
def shades(profile):
    """Return a profile and an image in which ink increases from column to column of electrodes."""
    profile = profile_for_reading(profile)
    cell = np.repeat(np.linspace(255, 0, 8).round().astype(np.uint8), 8)
    return profile, np.tile(cell, (64, 1))


def test_graded_is_the_ink_itself(shades):
    profile, image = shades
    found = mapped(profile, image, Tone(0, 1, prepared=True)).reshape(8, 8)
    np.testing.assert_allclose(found, np.tile(np.linspace(0, 1, 8), (8, 1)), atol=0.003)


def test_exactly_the_part_asked_for_is_enough(profile):
    profile = profile_for_reading(profile)
    image = np.full((64, 64), 255, np.uint8)
    image[:, ::2] = 0
    assert (mapped(profile, image, Tone(0.5, 0.5, prepared=True)) == 1).all()
    assert (mapped(profile, image, Tone(0.51, 0.51, prepared=True)) == 0).all()


def test_faint_ink_counts_only_where_frames_are_prepared(profile):
    """Gray 230 on white 255 is blank paper in a sensor's image, but ink in a prepared one."""
    profile = profile_for_reading(profile)
    image = np.full((64, 64), 255, np.uint8)
    image[:, :32] = 230
    assert not mapped(profile, image).any()
    assert mapped(profile, image, Tone(0, 1, prepared=True)).any()


SECOND = 10**9


@pytest.fixture
def binarizer():
    return Binarizer((64, 64))


def share(mask):
    return float((mask > 0).mean())


def bars(level, noise, seed=0):
    """Return an image of unevenly lit paper with bars of ink, and the mask of these bars."""
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
            # The finger is lifted on the way to the next row.
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
    for tenth in (1, 10):  # the white level of the first frame stays in use
        assert share(binarizer.ink(patch(0, 64, ink=ink), tenth * SECOND // 10, True)) == seen
    half = binarizer.ink(patch(0, 40, ink=ink), SECOND, True)
    assert share(half[:, :36]) == seen
    assert share(half[:, 44:]) == 0


def test_bold_strokes_of_grey_print_are_ink_and_tiny_frames_work(binarizer, patch):
    assert share(binarizer.ink(patch(20, 44, ink=70), 0, True)) > 0.3
    assert Binarizer((2, 2)).ink(np.zeros((2, 2), np.uint8), 0, True).shape == (2, 2)


def follow(drive, images, touching=True, start_ns=0):
    """Filter images of ink, 20 ms apart. Return the activation of RA and of SAI, (T, E) each."""
    rows = []
    for step, ink in enumerate(images):
        activation = np.zeros((3, len(ink)), np.float32)
        ink = np.asarray(ink, np.float32)
        drive.drive(activation, ink, start_ns + step * 20_000_000, touching)
        rows.append(activation)
    rows = np.stack(rows)
    assert ((rows >= 0) & (rows <= 1)).all()
    assert not rows[:, Afferent.PC].any()
    return rows[:, Afferent.RA], rows[:, Afferent.SAI]


def test_a_step_is_a_change_and_then_stays():
    ra, sai = follow(NaturalDrive(1), [[0]] * 10 + [[1]] * 40 + [[0]] * 40)
    assert not ra[:10].any()
    assert ra[10, 0] == pytest.approx(1)
    assert sai[10, 0] == 0
    assert not ra[30:50].any()
    assert (sai[30:50] > 0.95).all()
    # RA responds to ink that leaves; SAI stops at once.
    assert ra[50, 0] == pytest.approx((LEAVING - FAINTEST_CHANGE) / (1 - FAINTEST_CHANGE), abs=0.01)
    assert not sai[50:].any()
    assert not ra[75:].any()


def test_a_moving_bar_has_edges_and_a_middle():
    images = np.zeros((40, 24))
    for step in range(40):
        images[step, max(0, step // 2 - 8) : step // 2] = 1
    ra, sai = follow(NaturalDrive(24), images)
    front, back = ra[38, 17:19], ra[38, 9:11]
    assert front.max() > 0.6
    assert 0.1 < back.max() < front.max()
    assert sai[38, 12:15].min() > ra[38, 12:15].max()
    assert not ra[38, 22:].any()


def test_on_a_finger_that_has_landed_all_is_new():
    drive = NaturalDrive(2)
    follow(drive, [[1, 0]] * 30)
    follow(drive, [[1, 0]], touching=False, start_ns=10**9)
    ra, sai = follow(drive, [[1, 0]], start_ns=2 * 10**9)
    assert ra[0].tolist() == pytest.approx([1, 0], abs=1e-6)
    assert not sai.any()


def test_noise_of_the_sensor_is_no_change():
    random = np.random.default_rng(1)
    ra, _ = follow(NaturalDrive(8), 0.5 + 0.05 * random.uniform(-1, 1, (200, 8)))
    assert not ra[25:].any()
