"""Moving parts drive RA, resting ones drive SAI."""

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.imaging.tactile_mapper import FAINTEST_CHANGE, LEAVING, NaturalDrive


def follow(drive, images, touching=True, start_ns=0):
    """Drive with an image every 20 ms; return RA and SAI, (T, E) each."""
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
    # On leaving it is a change again, and at once no longer sustained.
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
