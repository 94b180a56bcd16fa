"""Drives of the afferents that may fire: as those computed of all nodes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.physiology.finger import Finger
from smarttouch.physiology.spikes import NodeDrives, SpikeModel
from smarttouch.profile import load_profile

from ..close import assert_close
from ..whole import WHOLE


@pytest.fixture(scope="module", params=["paper", "branched"])
def finger(request):
    return Finger(load_profile("smarttouch-4x4"), 3, request.param)


@pytest.fixture(scope="module")
def drives(finger):
    return NodeDrives(*finger.rows)


def dense(rows, current_ma):
    return np.maximum.reduceat(rows[0] @ current_ma.T, rows[1], axis=0)


@settings(max_examples=100 if WHOLE else 10)
@given(
    seed=st.integers(0, 2**32 - 1), strongest_ma=st.floats(0.01, 8.0), least=st.floats(-0.5, 1.5)
)
def test_only_drives_below_the_least_are_left_out(finger, drives, seed, strongest_ma, least):
    random = np.random.default_rng(seed)
    current = strongest_ma * random.normal(0, 1, (3, finger.rows[0].shape[1])).astype(np.float32)
    expected = dense(finger.rows, current)
    found, near = drives.highest_from(least, current), expected >= least
    assert_close(drives.highest(current), expected, rel=1e-4, abs=1e-5)
    assert_close(found[near], expected[near], rel=1e-4, abs=1e-5)
    assert np.all(found <= expected + 1e-4 * (1 + np.abs(expected)))


@pytest.mark.parametrize("widths", [(200,), (100, 200, 500)])
def test_many_slots_fire_what_each_fires_alone(finger, widths):
    """Hundreds are bounded first, a few are not; slots come again, with other widths, too."""
    random, electrodes = np.random.default_rng(1), finger.rows[0].shape[1]
    current = np.rint(random.normal(0, 1500, (150, electrodes)))[np.arange(300) // 2]
    width = np.array(widths)[np.arange(300) % len(widths)]
    many = SpikeModel(finger).drive(current, width, firing=True)
    model, fires = SpikeModel(finger), 0
    for first in range(0, 300, 50):
        part = slice(first, first + 50)
        alone = model.drive(current[part], width[part], firing=True)
        near = alone >= 0.94
        assert_close(many[:, part][near], alone[near], rel=1e-4)
        assert np.all(many[:, part][~near] < 0.95)
        fires += np.count_nonzero(near)
    assert fires > 100


def test_currents_of_nothing(finger):
    model = SpikeModel(finger)
    for count in (2, 100, 0):
        nothing = np.zeros((count, finger.rows[0].shape[1]))
        drive = model.drive(nothing, np.full(count, 200), firing=True)
        assert drive.shape == (len(finger.classes), count)
        assert not (drive > 0).any()


def test_a_finger_without_afferents():
    drives = NodeDrives(np.zeros((0, 4), np.float32), np.zeros(0, np.intp))
    for found in (drives.highest(np.ones((3, 4))), drives.highest_from(0.9, np.ones((3, 4)))):
        assert found.shape == (0, 3)
