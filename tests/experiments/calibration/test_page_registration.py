"""Every electrode's point is found, from a coarse patch as from a camera."""

import numpy as np
import pytest
from PIL import Image

from smarttouch.base.errors import CalibrationError
from smarttouch.experiments.calibration.dot_target import (
    LARGE_DOTS,
    DotTarget,
    apply,
    find_dots,
    target_for,
)
from smarttouch.experiments.calibration.page_registration import View, bench_view, register
from smarttouch.imaging.registration import Registration
from smarttouch.profile import list_profiles, load_profile

from ...raising import raises

TENTH = 0.1
COARSE, FINE = (64, 64), (480, 640)


def random_view(seed, shape, optics):
    """Return a view such as a careless bench gives: any turn, up to 25° of tilt."""
    random = np.random.default_rng((seed, *shape))
    field_mm = min(optics.field_width_mm, optics.field_height_mm)
    pixels = min(shape)
    return View(
        tilt_deg=random.uniform(0, 25), toward_deg=random.uniform(0, 360),
        turn_deg=random.uniform(-180, 180),
        offset_mm=tuple(random.uniform(-0.05, 0.05, 2) * field_mm),
        distance_mm=random.uniform(4, 10) * field_mm, zoom=random.uniform(0.8, 1.0),
        blur_px=random.uniform(0.005, 0.012) * pixels, noise_levels=random.uniform(1, 5),
        uneven=random.uniform(0.0, 0.5), seed=seed,
    )  # fmt: skip


def true_error(found, profile, view, shape):
    """Return the error of each electrode's place on the page, in pitches."""
    optics = profile.optics
    truth = view.homography(optics, shape)
    looks_at_mm = apply(np.linalg.inv(truth), found.electrode_pixel)
    places_mm = profile.electrodes.position_mm / optics.magnification
    return np.linalg.norm(looks_at_mm - places_mm, axis=1) / found.pitch_mm


@pytest.mark.parametrize(("shape", "cases"), [(COARSE, 25), (FINE, 6)])
def test_residual_and_true_error_are_below_a_tenth_of_a_pitch(profile, shape, cases):
    """Tilted up to 25°, turned any way, blurred, noisy, unevenly lit."""
    target = target_for(profile)
    for seed in range(cases):
        view = random_view(seed, shape, profile.optics)
        found = register(view.render(target, profile.optics, shape), profile, target)
        assert found.worst_mm / found.pitch_mm < TENTH, view
        assert true_error(found, profile, view, shape).max() < TENTH, view
        # Measured: 0.015 and 0.01 at worst, of 300 cases.
        assert found.rms_mm / found.pitch_mm < 0.01, view
        assert found.tilt_deg == pytest.approx(view.tilt_deg, abs=2.5), view
        assert not found.mirrored


def test_what_is_calibrated_is_what_the_pipeline_looks_at(profile, changed):
    """A square of ink under one electrode is seen by that one, through a tilted camera."""
    target = target_for(profile)
    view = View(tilt_deg=20, toward_deg=30, turn_deg=25, zoom=0.75, seed=3)
    found = register(view.render(target, profile.optics, COARSE), profile, target)
    optics = profile.optics.model_copy(update={"homography": tuple(found.homography.ravel())})
    registration = Registration(profile.electrodes, optics, COARSE)
    fine = np.linspace(-0.5, 63.5, 64 * 8, endpoint=False) + 1 / 16
    pixel = np.column_stack([each.ravel() for each in np.meshgrid(fine, fine)])
    on_page = apply(np.linalg.inv(view.homography(profile.optics, COARSE)), pixel)
    half_mm = np.array(profile.electrodes.cell_mm) / profile.optics.magnification / 2
    for site in (0, 7, 35, 63):
        middle = profile.electrodes.position_mm[site] / profile.optics.magnification
        inside = (np.abs(on_page - middle) < half_mm).all(axis=1)
        ink = 255 * inside.reshape(64, 8, 64, 8).mean(axis=(1, 3))
        felt = registration.sample(ink.astype(np.uint8))
        assert felt.argmax() == site
        assert felt[site] > 0.85
        assert np.delete(felt, site).max() < 0.15


def test_a_mirror_in_the_optics_is_reported(profile):
    target = target_for(profile)
    image = View(turn_deg=40).render(target, profile.optics, COARSE)
    found = register(np.ascontiguousarray(image[:, ::-1]), profile, target)
    assert found.mirrored
    plain = register(image, profile, target)
    assert not plain.mirrored
    assert "mirrored" in found.sentence()
    assert "mirrored" not in plain.sentence()
    assert found.rms_px < 0.1


def test_dirt_and_lost_dots_do_not_count(profile):
    target = target_for(profile)
    image = View(turn_deg=10, zoom=0.8).render(target, profile.optics, FINE)
    clean = register(image, profile, target)
    dirty = image.copy()
    dirty[60:75, 300:312] = 40
    place = apply(clean.homography, np.array([[2.0, -2.0]]))[0].astype(int)
    dirty[place[1] - 30 : place[1] + 31, place[0] - 30 : place[0] + 31] = 190
    found = register(dirty, profile, target)
    assert found.electrode_pixel == pytest.approx(clean.electrode_pixel, abs=0.1)


@pytest.mark.parametrize("name", [n for n in list_profiles() if n != "smarttouch-4x4"])
def test_every_sensor_that_is_fine_enough_has_a_target(name):
    profile = load_profile(name)
    found = register(bench_view(target_for(profile), profile.optics), profile, target_for(profile))
    assert found.worst_mm < TENTH * found.pitch_mm


def test_a_sensor_too_coarse_for_any_target():
    profile = load_profile("smarttouch-4x4")
    with raises(CalibrationError, names="optics") as caught:
        target_for(profile)
    assert "16 × 16" in str(caught.value)
    assert "5 × 5 mm" in str(caught.value)
    assert target_for(profile, 1.0).pitch_mm == 1.0
    with raises(CalibrationError, value=7, allowed=5):
        target_for(profile, 7.0)
    with raises(CalibrationError, value=np.nan):
        target_for(profile, float("nan"))


def test_the_target_as_it_is_printed(tmp_path):
    """A flat scan of the PNG is recognized as the target."""
    target = DotTarget(1.0, 5)
    target.draw(tmp_path / "target.png")
    with Image.open(tmp_path / "target.png") as image:
        dpi = image.info["dpi"][0]
        grey = np.asarray(image)
    assert dpi == pytest.approx(1270, abs=0.1)
    middle, reach = grey.shape[0] // 2, round(3.4 / 25.4 * dpi)
    part = slice(middle - reach, middle + reach)
    dots = find_dots(grey[part, part])
    expected = dots.cell * dpi / 25.4 + middle - part.start
    assert len(dots.cell) == 49
    # Where the paper begins does not matter.
    assert np.ptp(dots.pixel - expected, axis=0).max() < 0.05
    for column, row in LARGE_DOTS:
        assert [column, row] in dots.cell.tolist()
    path = tmp_path / "none" / "target.png"
    with raises(CalibrationError, names="file", value=path):
        target.draw(path)


def speckle(seed):
    return np.random.default_rng(seed).integers(0, 256, COARSE, np.uint8)


def bars():
    return np.tile(np.repeat(np.array([200, 40], np.uint8), 4), 8)[None].repeat(64, axis=0)


@pytest.mark.parametrize(("image", "about"), [
    (np.full(COARSE, 200, np.uint8), "dots"),
    (np.zeros(COARSE, np.uint8), "dots"),
    (bars(), "dots"),
    # By chance an L may be seen in some, whose dots do not lie on a grid.
    (speckle(0), "residual"),
    *((speckle(seed), "dots") for seed in range(1, 5)),
    (np.zeros((2, 2), np.uint8), "image"),
    (speckle(9)[:3], "image"),
])  # fmt: skip
def test_no_target_is_one_sentence(profile, image, about):
    with raises(CalibrationError):
        register(image, profile, target_for(profile))


@pytest.mark.parametrize(
    ("view", "about"), [(View(offset_mm=(2.4, 2.4)), "large dots"), (View(zoom=2.5), "dots")]
)
def test_a_target_that_is_not_in_view(profile, view, about):
    target = target_for(profile)
    with raises(CalibrationError, names=about):
        register(view.render(target, profile.optics, COARSE), profile, target)


def test_a_target_that_does_not_fit_the_fit(profile):
    """A bulging lens, and an array that looks elsewhere."""
    target = target_for(profile)
    image = View(zoom=0.7).render(target, profile.optics, FINE)
    rows, columns = np.indices(FINE)
    y, x = (rows - 239.5) / 240, (columns - 319.5) / 240
    bulge = 1 + 0.22 * (x * x + y * y)
    source = [np.clip(np.rint(a * bulge * 240 + b), 0, c - 1).astype(int)
              for a, b, c in ((y, 239.5, 480), (x, 319.5, 640))]  # fmt: skip
    with raises(CalibrationError, value=lambda worst: worst > 0.05):
        register(image[source[0], source[1]], profile, target)
    wide = profile.model_copy(
        update={"optics": profile.optics.model_copy(update={"magnification": 1.0})}
    )
    with raises(CalibrationError, names="electrodes"):
        register(View().render(target, profile.optics, COARSE), wide, target)
