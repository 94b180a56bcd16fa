"""Each electrode sees the mean of its whole aperture, without aliasing."""

import numpy as np
import pytest

from smarttouch.base.errors import ProfileError
from smarttouch.imaging.sensor_registration import Registration
from smarttouch.profile import list_profiles, load_profile

from ..support.checks import raises


def changed(profile, **optics):
    return profile.optics.model_copy(update=optics)


def felt(registration, ink):
    """Return the mean ink under each electrode, (E,) in [0, 1]. ``ink`` is a mask of 0 and 255."""
    pixel, share = registration.apertures
    return (ink.ravel()[pixel] * share).sum(axis=0)


def test_exact_area_mean_on_the_plain_grid(profile):
    rng = np.random.default_rng(0)
    ink = rng.integers(0, 2, (64, 64), np.uint8) * 255
    registration = Registration(profile.electrodes, profile.optics, (64, 64))
    expected = ink.reshape(8, 8, 8, 8).mean(axis=(1, 3)).ravel() / 255
    assert felt(registration, ink) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("name", list_profiles())
def test_every_electrode_of_every_profile_is_in_the_field(name):
    profile = load_profile(name)
    shape = (profile.optics.sensor_rows, profile.optics.sensor_columns)
    registration = Registration(profile.electrodes, profile.optics, shape)
    full = np.full(registration.working_shape, 255, np.uint8)
    assert felt(registration, full) == pytest.approx(np.ones(len(profile.electrodes)), abs=1e-3)


def test_rotation_and_offset(profile):
    """Turning the sensor by 90° moves a dot from the right to the bottom. An offset moves it."""
    ink = np.zeros((64, 64), np.uint8)
    ink[28:36, 56:64] = 255
    turned = Registration(profile.electrodes, changed(profile, rotation_deg=-90.0), (64, 64))
    row, _ = np.divmod(int(felt(turned, ink).argmax()), 8)
    assert row == 7
    moved = Registration(profile.electrodes, changed(profile, offset_x_mm=0.625), (64, 64))
    plain = Registration(profile.electrodes, profile.optics, (64, 64))
    assert felt(moved, ink).reshape(8, 8)[:, 6] == pytest.approx(
        felt(plain, ink).reshape(8, 8)[:, 7], abs=1e-5
    )


def flat(optics, **changes):
    """Return ``optics`` with a homography equivalent to its field of view, rotation and offset."""
    across = optics.sensor_columns / optics.field_width_mm
    down = optics.sensor_rows / optics.field_height_mm
    turn = np.radians(optics.rotation_deg)
    matrix = np.array(
        [
            [across * np.cos(turn), -across * np.sin(turn), 0],
            [down * np.sin(turn), down * np.cos(turn), 0],
            [0, 0, 1],
        ]
    )
    matrix[0, 2] = across * optics.offset_x_mm + (optics.sensor_columns - 1) / 2
    matrix[1, 2] = down * optics.offset_y_mm + (optics.sensor_rows - 1) / 2
    return optics.model_copy(update={"homography": tuple(matrix.ravel()), **changes})


@pytest.mark.parametrize("name", list_profiles())
@pytest.mark.parametrize("shape", [None, (480, 640)])
def test_an_upright_homography_is_field_rotation_and_offset(name, shape):
    profile = load_profile(name)
    optics = changed(profile, rotation_deg=12.0, offset_x_mm=0.3, offset_y_mm=-0.2)
    shape = shape or (optics.sensor_rows, optics.sensor_columns)
    plain = Registration(profile.electrodes, optics, shape)
    # A homography replaces rotation and offset, so wrong rotation and offset have no effect.
    wrong = {"rotation_deg": -90.0, "offset_x_mm": 9.0, "offset_y_mm": 9.0}
    by_matrix = Registration(profile.electrodes, flat(optics, **wrong), shape)
    assert by_matrix.working_shape == plain.working_shape
    ink = np.random.default_rng(1).integers(0, 2, plain.working_shape, np.uint8) * 255
    assert felt(by_matrix, ink) == pytest.approx(felt(plain, ink), abs=0.01)


def test_each_cell_is_a_quadrilateral_to_a_tilted_camera(profile):
    """Apertures agree with polygons that are filled at 16 times the resolution."""
    import cv2

    matrix = np.array([[9.5, 1.2, 31.0], [-0.8, 9.9, 29.0], [0.012, -0.03, 1.0]])
    optics = changed(profile, homography=tuple(matrix.ravel()))
    ink = np.random.default_rng(2).integers(0, 2, (64, 64), np.uint8) * 255
    found = felt(Registration(profile.electrodes, optics, (64, 64)), ink)
    fine = np.kron(ink, np.ones((16, 16), np.uint8))
    half = np.array(profile.electrodes.cell_mm) / 2
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    for site in (0, 7, 27, 56, 63):
        place = (profile.electrodes.position_mm[site] + corners) / optics.magnification
        seen = np.column_stack([place, np.ones(4)]) @ matrix.T
        pixel = (seen[:, :2] / seen[:, 2:] + 0.5) * 16 - 0.5
        mask = np.zeros(fine.shape, np.uint8)
        cv2.fillConvexPoly(mask, np.rint(pixel).astype(np.int32), 1)
        assert found[site] == pytest.approx(fine[mask == 1].mean() / 255, abs=0.06), site


@pytest.mark.parametrize(
    "matrix",
    [np.zeros(9), [0, 0, 1, 0, 0, 1, 0, 0, 1], [1e9, 0, 0, 0, 1e9, 0, 0, 0, 1],
     [12.8, 0, 32, 0, 12.8, 32, 1.0, 0, 1]],
)  # fmt: skip
def test_a_homography_that_is_none(profile, matrix):
    optics = changed(profile, homography=tuple(map(float, matrix)))
    with raises(ProfileError, key="optics.homography"):
        Registration(profile.electrodes, optics, (64, 64))


@pytest.mark.parametrize(
    ("rows", "columns"), [(480, 640), (128, 64), (64, 128), (192, 64), (320, 192), (1024, 1536)]
)
def test_each_working_pixel_is_the_mean_of_its_part(profile, rows, columns):
    """Averaging in several steps adds only the rounding error of each step."""
    image = np.random.default_rng(0).integers(0, 256, (rows, columns), np.uint8)
    registration = Registration(profile.electrodes, profile.optics, (rows, columns))
    down, across = np.array(image.shape) // registration.working_shape
    parts = image.reshape(rows // down, down, columns // across, across).astype(float)
    assert down * across > 1
    assert np.abs(registration.reduce(image) - parts.mean(axis=(1, 3))).max() <= 2


def test_outside_the_field_is_paper(profile):
    far = changed(profile, offset_x_mm=100.0)
    registration = Registration(profile.electrodes, far, (64, 64))
    assert not felt(registration, np.full((64, 64), 255, np.uint8)).any()
