"""Drives of current patterns that come again: as exact as those computed from all nodes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.spikes import DriveMemory
from smarttouch.profile import load_profile

from ..close import assert_close

EXACT_FROM = 0.9


@pytest.fixture(scope="module")
def rows(profile):
    return Finger(profile, 3, "paper").rows


@pytest.fixture(scope="module", params=["paper", "branched"])
def few_rows(request):
    return Finger(load_profile("smarttouch-4x4"), 3, request.param).rows


def dense(rows, current_ma):
    return np.maximum.reduceat(rows[0] @ current_ma.T, rows[1], axis=0)


def whole_ua(current_ma):
    return np.rint(1000 * current_ma).astype(np.float32) / np.float32(1000)


@pytest.mark.parametrize(("mode", "amplitude"), [
    (Afferent.RA, 1.0), (Afferent.SAI, 0.97), (Afferent.RA, 0.75), (Afferent.SAI, 0.55),
])  # fmt: skip
def test_scaled_kernels_are_known(rows, bank, mode, amplitude):
    memory = DriveMemory(*rows, EXACT_FROM)
    kernels = bank.kernels(mode)[20:40]
    for _ in range(2):
        memory.drive(whole_ua(2.4 * kernels))
    again = whole_ua(amplitude * 2.4 * kernels)
    assert np.count_nonzero(memory._find(again)[0] >= 0) >= 18
    found, expected = memory.drive(again), dense(rows, again)
    may_fire = expected >= EXACT_FROM
    assert may_fire.any()
    assert_close(found[may_fire], expected[may_fire], abs=1e-5)
    assert_close(found, expected, abs=0.01)


@given(
    seed=st.integers(0, 2**32 - 1),
    times=st.integers(1, 3),
    scale=st.floats(0.0, 2.0),
    noise_ua=st.floats(0.0, 20.0),
)
def test_drives_are_right_whatever_came_before(few_rows, seed, times, scale, noise_ua):
    """Patterns that differ from known ones a little, a lot, or by any factor."""
    random = np.random.default_rng(seed)
    first = random.normal(0, 1, (3, few_rows[0].shape[1]))
    first -= first.mean(axis=1, keepdims=True)
    memory = DriveMemory(*few_rows, EXACT_FROM)
    for _ in range(times):
        memory.drive(whole_ua(first))
    again = whole_ua(scale * first + random.normal(0, noise_ua / 1000, first.shape))
    found, expected = memory.drive(again), dense(few_rows, again)
    may_fire = expected >= EXACT_FROM
    assert_close(found[may_fire], expected[may_fire], rel=1e-4)
    assert_close(found, expected, abs=0.01)


def test_more_patterns_than_are_remembered(few_rows):
    memory = DriveMemory(*few_rows, EXACT_FROM)
    random = np.random.default_rng(1)
    for _ in range(2):
        patterns = whole_ua(random.normal(0, 0.1, (300, few_rows[0].shape[1])))
        expected = dense(few_rows, patterns)
        assert_close(memory.drive(patterns), expected, abs=1e-4)
        assert_close(memory.drive(patterns[-5:]), expected[:, -5:], abs=1e-4)


def test_currents_of_nothing(few_rows):
    nothing = np.zeros((2, few_rows[0].shape[1]), np.float32)
    memory = DriveMemory(*few_rows, EXACT_FROM)
    assert not memory.drive(nothing).any()
    assert not memory.drive(nothing).any()
    assert memory.drive(nothing[:0]).shape == (len(few_rows[1]), 0)


def test_a_finger_without_afferents():
    memory = DriveMemory(np.zeros((0, 4), np.float32), np.zeros(0, np.intp), EXACT_FROM)
    assert memory.drive(np.ones((3, 4), np.float32)).shape == (0, 3)
