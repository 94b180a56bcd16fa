"""Flat field and registration agree with the known optics of simulated sensors."""

import numpy as np
import pytest
from PIL import Image

from smarttouch.base.errors import CalibrationError
from smarttouch.experiments.sensor_calibration import (
    MODULES,
    MOST_UNEVEN,
    PageTarget,
    apply,
    collect_images,
    measure_optics,
    register,
    target_for,
    uncorrected,
)
from smarttouch.imaging.sensor_registration import Registration
from smarttouch.profile import load_profile
from smarttouch.sources.source_contract import Frame, OpticalSource, Pose

from ..support.checks import raises
from ..support.full import sample
from .simulated_sensors import SimulatedPatch, View


def found(patch, frames=16):
    return measure_optics(patch.images(frames, light=False), patch.images(frames, light=True))


def test_a_known_patch():
    patch = SimulatedPatch((64, 64), noise_levels=3.0, dead=5, hot=2, seed=1)
    result = found(patch)
    assert result.uneven_before > 0.08
    assert result.uneven_after < 0.012
    assert all(each in result.sentence() for each in ("64 × 64", "7 dead or hot"))


def test_after_is_judged_on_frames_that_the_correction_was_not_made_from():
    """A flat field from one noisy frame makes this frame even, but leaves another frame uneven."""
    result = found(SimulatedPatch(noise_levels=5.0), frames=2)
    assert result.uneven_after > 0.03


def test_paper_that_moved_is_refused():
    patch = SimulatedPatch()
    scene = np.ones((64, 64))
    scene[:, ::2] = 0.8
    white = patch.see(scene, 8) + patch.see(scene[:, ::-1], 8)
    alternating = [each for pair in zip(white[:8], white[8:], strict=True) for each in pair]
    moved = {"value": lambda uneven: uneven > MOST_UNEVEN, "allowed": MOST_UNEVEN}
    with raises(CalibrationError, **moved):
        measure_optics(patch.images(16, light=False), alternating)


class Listed(OpticalSource):
    """Source that returns each image of a list twice. The third image of the list is stale."""

    def __init__(self, images, end=True):
        super().__init__("a list")
        self._looks = [(i // 2, image) for i, image in enumerate(np.repeat(images, 2, axis=0))]
        self._end = end

    def read(self, time_ns):
        if not self._looks and self._end:
            return None
        number, image = self._looks.pop(0) if self._looks else (0, np.zeros((2, 2), np.uint8))
        return Frame(image, time_ns, Pose(0, 0), np.nan, number=number, stale=number == 2)


def images(count):
    return [np.full((2, 2), i, np.uint8) for i in range(count)]


def test_each_image_once_and_none_that_is_stale():
    assert [int(each[0, 0]) for each in collect_images(Listed(images(5)), 9)] == [0, 1, 3, 4]
    assert len(collect_images(Listed(images(5)), 2)) == 2


def test_a_sensor_that_gives_nothing(monkeypatch):
    with raises(CalibrationError, names="frames", value="no frames"):
        collect_images(Listed(np.empty((0, 2, 2), np.uint8)), 3)
    monkeypatch.setattr("smarttouch.experiments.sensor_calibration.IMAGE_TIMEOUT_S", 0.05)
    with raises(CalibrationError, names="frames", value=2, allowed=3):
        collect_images(Listed(images(2), end=False), 3)


def test_the_sensor_to_be_calibrated_is_seen_without_its_flat_field(profile, changed):
    named = changed(profile, {"optics.flat_field": "gone.npz"})
    assert uncorrected(named).optics.flat_field is None


COARSEST, COARSE, FINE = (32, 32), (64, 64), (480, 640)


def random_view(seed, shape, optics):
    """Return a random view of a careless setup: any rotation, and up to 25° of tilt."""
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
    """Return the error of each electrode's registered place on the page, in pitches, (E,)."""
    optics = profile.optics
    looks_at_mm = apply(np.linalg.inv(view.homography(optics, shape)), found.electrode_pixel)
    away_mm = looks_at_mm - profile.electrodes.position_mm / optics.magnification
    pitch_mm = profile.electrodes.pitch_mm / optics.magnification
    return np.linalg.norm(away_mm, axis=1) / pitch_mm


@pytest.mark.parametrize(("shape", "cases"), [(COARSEST, 24), (COARSE, 24), (FINE, 6)])
def test_the_true_error_is_below_a_tenth_of_a_pitch(profile, shape, cases):
    """Registration tolerates tilt up to 25°, any rotation, blur, noise and uneven light."""
    target = target_for(profile)
    for seed in sample(range(cases)):
        view = random_view(seed, shape, profile.optics)
        found = register(view.render(target, profile.optics, shape), profile, target)
        assert true_error(found, profile, view, shape).max() < 0.1, view
        assert found.correlation > 0.88, view


def test_what_is_calibrated_is_what_the_pipeline_looks_at(profile):
    """Through a tilted camera, only the electrode above a square of ink sees the ink."""
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
        aperture, share = registration.apertures
        felt = (ink.astype(np.uint8).ravel()[aperture] * share).sum(axis=0)
        assert felt.argmax() == site
        assert felt[site] > 0.85
        assert np.delete(felt, site).max() < 0.15


def test_a_mirror_in_the_optics_is_allowed_for(profile):
    target = target_for(profile)
    image = View(turn_deg=40).render(target, profile.optics, COARSE)
    plain = register(image, profile, target)
    found = register(np.ascontiguousarray(image[:, ::-1]), profile, target)
    there = plain.electrode_pixel * (-1, 1) + (63, 0)
    assert found.electrode_pixel == pytest.approx(there, abs=0.2)


def test_a_sensor_too_coarse_for_any_target():
    profile = load_profile("smarttouch-4x4")
    with pytest.raises(CalibrationError, match=r"16 × 16 pixels, .* 24 pixels a side"):
        target_for(profile)


def test_the_target_as_it_is_printed(tmp_path, profile):
    """The drawn PNG file is recognized. The file's dpi gives the target its stated size."""
    target = PageTarget(0.3)
    target.draw(tmp_path / "target.png")
    with Image.open(tmp_path / "target.png") as image:
        dpi, grey = image.info["dpi"][0], np.asarray(image)
    assert dpi == pytest.approx(1270, abs=0.1)
    middle, reach = grey.shape[0] // 2, round(2.5 / 25.4 * dpi)
    part = slice(middle - reach, middle + reach)
    found = register(grey[part, part], profile, target)
    assert found.correlation > 0.9
    corners_mm = np.array([[-1.0, -1.0], [1.0, 1.0]])
    expected = corners_mm * dpi / 25.4 + reach - 0.5
    assert apply(found.homography, corners_mm) == pytest.approx(expected, abs=1)
    ink = np.flatnonzero(grey[middle] < 128)
    assert (np.ptp(ink) + 1) / dpi * 25.4 == pytest.approx(MODULES * 0.3)
    with pytest.raises(CalibrationError, match="none"):
        target.draw(tmp_path / "none" / "target.png")


@pytest.mark.parametrize("image", [
    np.full(COARSE, 200, np.uint8), np.zeros(COARSE, np.uint8), np.zeros((2, 2), np.uint8),
    np.zeros((3, 64), np.uint8), np.random.default_rng(1).integers(0, 256, COARSE, np.uint8),
])  # fmt: skip
def test_no_target_is_one_sentence(profile, image):
    with pytest.raises(CalibrationError, match="no marker"):
        register(image, profile, target_for(profile))


@pytest.mark.parametrize(("view", "words"), [
    (View(offset_mm=(2.4, 2.4)), "electrodes lie outside the image"), (View(zoom=2.5), "no marker"),
])  # fmt: skip
def test_a_target_that_is_not_in_view(profile, view, words):
    target = target_for(profile)
    with pytest.raises(CalibrationError, match=words):
        register(view.render(target, profile.optics, COARSE), profile, target)


def test_a_target_that_does_not_fit_the_fit(profile):
    """Lens distortion, or a wrong magnification in the profile, is refused."""
    target = target_for(profile)
    image = View(zoom=0.7).render(target, profile.optics, FINE)
    rows, columns = np.indices(FINE)
    y, x = (rows - 239.5) / 240, (columns - 319.5) / 240
    bulge = 1 + 0.22 * (x * x + y * y)
    source = [np.clip(np.rint(a * bulge * 240 + b), 0, c - 1).astype(int)
              for a, b, c in ((y, 239.5, 480), (x, 319.5, 640))]  # fmt: skip
    with pytest.raises(CalibrationError, match=r"correlates with the target by 0\.[0-7]"):
        register(image[source[0], source[1]], profile, target)
    optics = profile.optics.model_copy(update={"magnification": 1.0})
    wide = profile.model_copy(update={"optics": optics})
    with pytest.raises(CalibrationError, match=r"optics\.magnification"):
        register(View().render(target, profile.optics, COARSE), wide, target)
