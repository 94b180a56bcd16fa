"""Each electrode sees its own aperture, whole and without aliasing."""

import dataclasses

import numpy as np
import pytest

from smarttouch.imaging.registration import Registration
from smarttouch.profile import load_profile, profile_names


def changed(profile, **optics):
    return profile.optics.model_copy(update=optics)


def test_exact_area_mean_on_the_plain_grid(profile):
    rng = np.random.default_rng(0)
    ink = rng.integers(0, 2, (64, 64), np.uint8) * 255
    registration = Registration(profile.electrodes, profile.optics, (64, 64))
    expected = ink.reshape(8, 8, 8, 8).mean(axis=(1, 3)).ravel() / 255
    assert registration.sample(ink) == pytest.approx(expected, abs=1e-5)


def test_a_large_frame_is_averaged_not_sampled(profile):
    """A checkerboard finer than an aperture is grey everywhere: a bare warp would alias."""
    rows, columns = np.indices((480, 640))
    checker = ((rows + columns) % 2 * 255).astype(np.uint8)
    registration = Registration(profile.electrodes, profile.optics, (480, 640))
    assert np.abs(registration.reduce(checker).astype(int) - 127).max() <= 3


@pytest.mark.parametrize("name", profile_names())
def test_every_electrode_of_every_profile_sees_the_field(name):
    profile = load_profile(name)
    shape = (profile.optics.sensor_rows, profile.optics.sensor_columns)
    registration = Registration(profile.electrodes, profile.optics, shape)
    full = np.full(registration.working_shape, 255, np.uint8)
    assert registration.sample(full) == pytest.approx(np.ones(len(profile.electrodes)), abs=1e-3)


def test_rotation_and_offset(profile):
    """A dot at the right of the field lands below the center for a sensor turned by 90°."""
    ink = np.zeros((64, 64), np.uint8)
    ink[28:36, 56:64] = 255
    turned = Registration(profile.electrodes, changed(profile, rotation_deg=-90.0), (64, 64))
    row, _ = np.divmod(int(turned.sample(ink).argmax()), 8)
    assert row == 7
    moved = Registration(profile.electrodes, changed(profile, offset_x_mm=0.625), (64, 64))
    plain = Registration(profile.electrodes, profile.optics, (64, 64))
    assert moved.sample(ink).reshape(8, 8)[:, 6] == pytest.approx(
        plain.sample(ink).reshape(8, 8)[:, 7], abs=1e-5
    )


def test_outside_the_field_is_paper(profile):
    far = changed(profile, offset_x_mm=100.0)
    registration = Registration(profile.electrodes, far, (64, 64))
    assert not registration.sample(np.full((64, 64), 255, np.uint8)).any()


def test_free_positions(profile):
    places = np.array([[0.3, -0.7], [3.1, 2.2]])
    two = dataclasses.replace(profile.electrodes, position_mm=places)
    registration = Registration(two, profile.optics, (64, 64))
    assert registration.sample(np.full((64, 64), 255, np.uint8)) == pytest.approx([1.0, 1.0])
