"""Kernels added up: as many as fit, and what is certain of them is what a judge finds."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent
from smarttouch.stimulation.frame_slots import FrameSlots
from smarttouch.stimulation.kernel_sums import _parts
from smarttouch.stimulation.scan_sequence import KernelTable

from ..whole import WHOLE

INTENSITIES = (1.0, 0.6, 0.3, 0.1, 0.03, 0.01, 0.003)


def made(profile, bank, whole):
    """Slots of sums of kernels, in whole numbers or in doubles."""
    slots = FrameSlots(profile, bank, Afferent.RA)
    if whole:
        slots.table = KernelTable.of(bank.weights, {Afferent.RA: slots.kernels()})
    return slots


@pytest.fixture(scope="module")
def slots(profile, bank):
    return made(profile, bank, whole=False)


@pytest.fixture(scope="module")
def both(profile, bank):
    """The same, without and with a judge for each frame."""
    found = {}
    for whole in (False, True):
        found[whole] = made(profile, bank, whole), made(profile, bank, whole)
        found[whole][1]._sums.certain_from = np.inf
    return found


def activations(count):
    for seed in range(count):
        random = np.random.default_rng(seed)
        drawn = random.random(64, np.float32)
        yield drawn * (random.random(64) < random.choice([0.05, 0.2, 0.5, 1]))


@given(
    whole=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
    density=st.floats(0, 1),
    faintest=st.floats(0, 1),
    intensity=st.one_of(st.floats(0, 0.05), st.floats(0, 1), st.sampled_from(INTENSITIES)),
)
def test_without_a_judge_for_each_frame_currents_are_the_same(
    both, whole, seed, density, faintest, intensity
):
    random = np.random.default_rng(seed)
    activation = random.uniform(faintest, 1, 64).astype(np.float32)
    activation *= random.random(64) < density
    found, expected = (each.slots(activation, intensity) for each in both[whole])
    assert np.array_equal(found.current_ua, expected.current_ua)
    assert np.array_equal(found.site, expected.site)
    assert np.array_equal(found.proof.points, expected.proof.points)
    several = found.proof.points > 1
    for name in ("off_target", "spill"):
        stated, true = getattr(found.proof, name), getattr(expected.proof, name)
        assert np.array_equal(stated[~several], true[~several])
        assert (stated[several] >= true[several]).all()


def test_hardly_any_intensity_needs_a_judge(slots, profile):
    sums = slots._sums
    assert 0 < sums.certain_from < 0.02
    worst = sums.figures(sums.certain_from)
    assert worst[0].max() <= profile.frames.other * 1.0001
    assert worst[1].max() <= profile.frames.spill * 1.0001
    assert (sums.figures(1.0) < worst).all()


def test_parts_are_filled_one_after_the_other():
    """Each owner has parts of its own, and what is alone is left out."""
    totals_ma, owners = [6.0, 5.0, 4.0, 4.0, 9.0, 1.0, 1.0], [0, 0, 0, 0, 1, 1, 1]
    parts, most_ma = _parts(totals_ma, owners, 10.0)
    assert parts == [[0, 2], [1, 3], [4, 5]]
    assert most_ma == 10.0
    assert _parts([], [], 10.0) == ([], 0.0)


def test_no_frame_exposes_an_electrode_more_than_all_points_can(slots, profile):
    """By this bound schedulers know that a period is long enough without adding up a frame."""
    for intensity in INTENSITIES:
        for activation in [np.ones(64, np.float32), *activations(30 if WHOLE else 8)]:
            current_ua = slots.slots(activation, intensity).current_ua.astype(np.int64)
            assert (np.abs(current_ua).sum(axis=0) <= slots.most_ua).all()
