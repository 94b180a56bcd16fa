"""Blank paper looks blank, and a damaged file is reported in one sentence."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.errors import CalibrationError, SourceError
from smarttouch.experiments.calibration.sensor_optics import SimulatedPatch
from smarttouch.sources.preprocess import FlatField

from ..raising import raises


def measured(patch, frames=32):
    return FlatField.measure(patch.images(frames, light=False), patch.images(frames, light=True))


@pytest.fixture(scope="module")
def patch():
    return SimulatedPatch((48, 64), dead=4, hot=3, seed=5)


@pytest.fixture(scope="module")
def field(patch):
    return measured(patch)


def test_every_grey_is_even_after_correction(patch, field):
    for grey in (0.3, 0.6, 1.0):
        seen = np.mean(patch.see(np.full((48, 64), grey), 30), axis=0)
        corrected = np.mean(
            [field.correct(each) for each in patch.see(np.full((48, 64), grey), 30)], axis=0
        )
        assert seen.std() / seen.mean() > 0.1
        # What is left is the noise of 30 frames, and rounding.
        assert corrected.std() / corrected.mean() < 0.015
        assert corrected.mean() == pytest.approx(grey * corrected_white(patch, field), rel=0.02)


def corrected_white(patch, field):
    return np.mean([field.correct(each) for each in patch.images(30, light=True)])


def test_black_is_zero_and_white_as_bright_as_before(patch, field):
    dark = np.mean([field.correct(each) for each in patch.images(30, light=False)])
    assert dark < 2
    white = np.median(np.mean(patch.images(30, light=True), axis=0))
    assert corrected_white(patch, field) == pytest.approx(white, rel=0.02)


def test_broken_pixels_show_what_the_nearest_good_one_does(patch, field):
    assert field.broken == 7
    scene = np.ones((48, 64))
    scene[:, 32:] = 0.0
    image = field.correct(patch.see(scene)[0])
    assert image[:, :31].min() > 150
    assert image[:, 33:].max() < 30


def test_it_is_a_new_image_and_saturates(field):
    image = np.full((48, 64), 255, np.uint8)
    before = image.copy()
    assert field.correct(image).max() == 255
    assert field.correct(np.zeros((48, 64), np.uint8)).max() == 0
    assert (image == before).all()


def test_another_shape(field):
    misfit = {"value": (48, 64), "allowed": (64, 48)}
    with raises(SourceError, **misfit):
        field.correct(np.zeros((64, 48), np.uint8))


@given(rows=st.integers(1, 12), columns=st.integers(1, 12), seed=st.integers(0, 2**32 - 1))
def test_any_field_is_read_back_as_it_was_written(tmp_path_factory, rows, columns, seed):
    random = np.random.default_rng(seed)
    dark = random.uniform(0, 60, (rows, columns)).astype(np.float32)
    gain = random.uniform(0.5, 3, (rows, columns)).astype(np.float32)
    path = tmp_path_factory.mktemp("field") / "f.npz"
    path.write_bytes(FlatField(dark, gain).to_bytes())
    again = FlatField.load(path)
    assert (again.dark == dark).all()
    assert (again.gain == gain).all()


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


@pytest.mark.parametrize(("dark", "white", "about", "value"), [
    ([], grey(200), "frames", None),
    (grey(10), grey(30), "white", 20),
    (grey(200), grey(20), "white", -180),
    (grey(10), grey(255), "white", 1.0),
    (grey(10), grey(200, (8, 9)), "frames", (8, 9)),
    (grey(10), grey(200) + grey(200, (9, 9)), "frames", ((8, 8), (9, 9))),
])  # fmt: skip
def test_references_that_are_none(dark, white, about, value):
    with raises(CalibrationError, value=value):
        FlatField.measure(dark, white)


def test_too_many_broken_pixels():
    # Two in a hundred of 64 x 64 may be broken.
    with raises(CalibrationError, names="pixels", value=200):
        measured(SimulatedPatch(dead=200))
