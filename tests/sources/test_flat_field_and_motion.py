"""Tests of the motion between images, and of flat-field correction."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from smarttouch.base.errors import CalibrationError, SourceError
from smarttouch.base.files import data_folder
from smarttouch.pages.document import Document
from smarttouch.sources.flat_field_and_motion import FlatField, FramePreprocessor, page_per_pixel
from smarttouch.sources.virtual_finger import PageSource

from ..experiments.simulated_sensors import SimulatedPatch
from ..support.checks import raises

FIELD_MM = 5.0


@pytest.fixture(scope="module")
def blots():
    """Return a page with dark blots, (400, 400) float32."""
    random = np.random.default_rng(2).integers(0, 2, (400, 400)).astype(np.float32)
    page = cv2.GaussianBlur(255 * random, (0, 0), 2.5)
    return np.clip(6 * (page - 100), 0, 255).astype(np.float32)


@pytest.fixture
def look(blots):
    """Return a function that cuts a noisy patch around pixel (200 + x, 200 + y) of the page."""
    noise = np.random.default_rng(3)

    def take(x=0.0, y=0.0, size=(64, 64), level=2.0):
        patch = cv2.getRectSubPix(blots, size, (200 + x, 200 + y))
        patch = patch + noise.normal(0, level, patch.shape)
        return np.clip(np.rint(patch), 0, 255).astype(np.uint8)

    return take


def follow(tracker, *images):
    """Give images to a tracker; return the motion between the last two images, mm."""
    for image in images:
        motion = tracker.follow(image)
    return motion


MOVES = [((64, 64), *each) for each in ((3, 0), (0, -5), (1.5, 2.25), (-20, 12), (0.3, -0.2))]
SIZES = [(each, 2, 1) for each in ((16, 16), (32, 24), (200, 150), (384, 128))]


@pytest.mark.parametrize(("size", "x", "y"), MOVES + SIZES)
def test_the_patch_moves_against_its_print_in_images_of_any_size(profile, look, size, x, y):
    """The field is 5 mm wide and 5 mm high for each image size, so pixels need not be square."""
    zoom = max(1, max(size) // 64)
    seen = size[0] // zoom, size[1] // zoom
    images = [cv2.resize(look(*at, size=seen), size) for at in ((0, 0), (x, y))]
    pixel_mm = FIELD_MM / seen[0], FIELD_MM / seen[1]
    motion = follow(FramePreprocessor(profile), *images)
    assert motion == pytest.approx((x * pixel_mm[0], y * pixel_mm[1]), abs=0.15 * min(pixel_mm))


def test_the_first_image_and_one_after_a_gap_give_no_motion(profile, look):
    tracker = FramePreprocessor(profile)
    assert follow(tracker, look()) == (0, 0)
    tracker.interrupt()
    assert follow(tracker, look(3)) == (0, 0)
    assert follow(tracker, look(6))[0] > 0


@given(st.floats(-180, 180), st.floats(-3, 3), st.floats(-3, 3))
def test_the_scale_is_the_inverse_of_the_registration(profile, changed, degrees, x_mm, y_mm):
    optics = changed(
        profile,
        {"optics.rotation_deg": degrees, "optics.sensor_columns": 80, "optics.sensor_rows": 50},
    ).optics
    turn = math.radians(degrees)
    # Convert a page point to a pixel with the formula of `smarttouch.imaging.sensor_registration`.
    column = (x_mm * math.cos(turn) - y_mm * math.sin(turn)) * 80 / optics.field_width_mm
    row = (x_mm * math.sin(turn) + y_mm * math.cos(turn)) * 50 / optics.field_height_mm
    back = page_per_pixel(optics, (50, 80)) @ [column, row]
    assert back == pytest.approx([x_mm, y_mm], abs=1e-9)


def test_the_scale_of_a_tilted_camera_is_that_of_its_middle(profile, changed):
    homography = np.array([[12.0, 1.0, 31.5], [-0.5, 13.0, 31.5], [0.02, -0.01, 1.0]])
    optics = changed(profile, {"optics.homography": tuple(homography.ravel().tolist())}).optics

    def pixel(x_mm, y_mm):
        x, y, scale = homography @ [x_mm, y_mm, 1]
        return np.array([x, y]) / scale / 2

    middle = pixel(0, 0)
    for x_mm, y_mm in [(1e-4, 0), (0, 1e-4)]:
        back = page_per_pixel(optics, (32, 32)) @ (pixel(x_mm, y_mm) - middle)
        assert back == pytest.approx([x_mm, y_mm], abs=1e-8)


def test_light_that_changes_is_no_motion(profile, look):
    tracker = FramePreprocessor(profile)
    assert follow(tracker, look() // 2, look() // 2 + 110) == pytest.approx((0, 0), abs=0.005)
    x_mm, _ = follow(tracker, look(3) // 2)
    assert x_mm == pytest.approx(3 * FIELD_MM / 64, abs=0.005)


def paper(random, slope=0.0):
    """Return an image of blank paper with noise; ``slope`` is the gradient of light."""
    level = 220 + slope * np.linspace(-16, 16, 64) + random.normal(0, 2, (64, 64))
    return np.clip(np.rint(level), 0, 255).astype(np.uint8)


def test_blank_paper_shows_no_motion(profile):
    random = np.random.default_rng(0)
    tracker = FramePreprocessor(profile)
    motions = [follow(tracker, paper(random, 1.0)) for _ in range(50)]
    assert motions == [(0, 0)] * 50


def test_two_images_that_have_nothing_in_common(profile, look):
    assert follow(FramePreprocessor(profile), look(-100, -100), look(100, 100)) == (0, 0)
    assert follow(FramePreprocessor(profile), look(), look(50, 0)) == (0, 0)


def test_motion_along_an_edge_is_not_known(profile):
    """The image of a long vertical stroke shows only horizontal motion."""
    random = np.random.default_rng(1)
    tracker = FramePreprocessor(profile)
    down = []
    for step in range(30):
        image = paper(random).astype(np.float32)
        image[:, 20 + step // 3 : 34 + step // 3] -= 180
        image = cv2.GaussianBlur(np.clip(image, 0, 255), (0, 0), 0.8).astype(np.uint8)
        down.append(tracker.follow(image)[1])
    assert np.abs(down).max() < 0.003


@pytest.mark.parametrize(("side", "speed_mm_s", "most_px", "most_drift"), [
    (64, 40, 0.03, 0.005), (64, 200, 0.1, 0.005), (32, 40, 0.04, 0.01), (16, 40, 0.06, 0.03),
])  # fmt: skip
def test_a_line_of_print(profile, changed, tmp_path, side, speed_mm_s, most_px, most_drift):
    """The finger moves in waves along a line of the sample page, at 100 images per second."""
    times = np.linspace(0, 60 / speed_mm_s, 200)
    x = 10 + speed_mm_s * times
    y = 34.5 + 0.6 * np.sin(0.2 * x)
    path = tmp_path / "path.csv"
    rows = [
        f"{t:.6f},{a:.6f},{b:.6f},0,1"
        for t, a, b in zip(times.tolist(), x.tolist(), y.tolist(), strict=True)
    ]
    path.write_text("time_s,x_mm,y_mm,angle_deg,force_n\n" + "\n".join(rows))
    optics = {"optics.sensor_columns": side, "optics.sensor_rows": side}
    profile = changed(profile, optics)
    page = Document(data_folder("sample_images") / "page.png").page(0)
    sensor, tracker = PageSource(page, profile, "line", path=path), FramePreprocessor(profile)
    frames = [sensor.read(10_000_000 * k) for k in range(int(100 * times[-1]))]
    motions = np.array([follow(tracker, frame.image) for frame in frames])[1:]
    truth = np.diff([(frame.pose.x_mm, frame.pose.y_mm) for frame in frames], axis=0)
    error_px = np.hypot(*(motions - truth).T) * side / FIELD_MM
    assert np.percentile(error_px, 95) < most_px
    assert np.abs((motions - truth).sum(axis=0)).max() < most_drift * truth[:, 0].sum()


@given(
    st.lists(
        hnp.arrays(np.uint8, hnp.array_shapes(min_dims=2, max_dims=2, max_side=80)),
        min_size=2,
        max_size=4,
    )
)
def test_no_image_is_too_much(profile, images):
    tracker = FramePreprocessor(profile)
    for image in images:
        assert all(map(math.isfinite, follow(tracker, image, image)))


@pytest.fixture(scope="module")
def patch():
    return SimulatedPatch((48, 64), dead=4, hot=3, seed=5)


@pytest.fixture(scope="module")
def field(patch):
    return FlatField.measure(patch.images(32, light=False), patch.images(32, light=True))


def test_every_grey_is_even_after_correction(patch, field):
    for grey in (0.3, 0.6, 1.0):
        images = patch.see(np.full((48, 64), grey), 30)
        seen = np.mean(images, axis=0)
        corrected = np.mean(list(map(field.correct, images)), axis=0)
        assert seen.std() / seen.mean() > 0.1
        # The remaining deviation is noise, averaged over 30 frames, and rounding.
        assert corrected.std() / corrected.mean() < 0.015
        white = np.mean([field.correct(each) for each in patch.images(30, light=True)])
        assert corrected.mean() == pytest.approx(grey * white, rel=0.02)


def test_broken_pixels_show_what_those_around_do(patch, field):
    assert field.broken == 7
    scene = np.ones((48, 64))
    scene[:, 32:] = 0.0
    image = field.correct(patch.see(scene)[0])
    assert image[:, :31].min() > 150
    assert image[:, 33:].max() < 30


@pytest.mark.parametrize("content", [None, b"", b"garbage" * 50])
def test_a_file_that_is_none(tmp_path, content):
    path = tmp_path / "f.npz"
    if content is not None:
        path.write_bytes(content)
    with raises(SourceError, value=path):
        FlatField.load(path)


@pytest.mark.parametrize(("dark", "gain", "value"), [
    (np.zeros((2, 2)), np.ones((2, 3)), ((2, 2), (2, 3))),
    (np.zeros((2, 2)), np.full((2, 2), np.nan), None),
    (np.zeros((2, 2)), -np.ones((2, 2)), None),
    (np.zeros((2, 2)), np.zeros((2, 2)), None),
    (np.zeros(4), np.ones(4), ((4,), (4,))),
])  # fmt: skip
def test_arrays_that_are_no_field(dark, gain, value):
    with raises(SourceError, value=value):
        FlatField(dark.astype(np.float32), gain.astype(np.float32))


def grey(level, shape=(8, 8)):
    return [np.full(shape, level, np.uint8)]


@pytest.mark.parametrize(("dark", "white", "value"), [
    ([], grey(200), None),
    (grey(10), grey(30), 20),
    (grey(200), grey(20), -180),
    (grey(10), grey(255), 1.0),
    (grey(10), grey(200, (8, 9)), (8, 9)),
    (grey(10), grey(200) + grey(200, (9, 9)), ((8, 8), (9, 9))),
])  # fmt: skip
def test_references_that_are_none(dark, white, value):
    with raises(CalibrationError, value=value):
        FlatField.measure(dark, white)
