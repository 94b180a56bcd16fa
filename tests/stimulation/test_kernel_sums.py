"""Kernels added up: as many as fit, and what is proved of them is what a judge finds."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.selectivity import FrameJudge, full_wish
from smarttouch.stimulation.frame_slots import FrameSlots
from smarttouch.stimulation.scan_sequence import KernelTable

INTENSITIES = (1.0, 0.6, 0.3, 0.1, 0.03, 0.01, 0.003)


@pytest.fixture(scope="module")
def both(profile, bank):
    """Slots in doubles, and as sums of kernels in whole numbers."""
    plain, whole = (FrameSlots(profile, bank, Afferent.RA) for _ in range(2))
    whole.use_table(KernelTable.of(bank.weights, {Afferent.RA: whole.kernels()}))
    return plain, whole


@pytest.fixture(scope="module")
def judge(profile, bank, changed):
    coarse = changed(profile, {"skin.node_spacing_mm": 0.5})
    kernels = np.asarray(bank.kernels(Afferent.RA), np.float64)
    return FrameJudge(coarse, Afferent.RA, full_wish(profile, kernels, bank.receptor[Afferent.RA]))


@given(
    whole=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
    density=st.floats(0, 1),
    faintest=st.floats(0, 1),
    intensity=st.one_of(st.floats(0, 0.05), st.floats(0, 1), st.sampled_from(INTENSITIES)),
)
def test_a_judge_of_each_frame_finds_no_more_than_is_stated(
    profile, both, judge, whole, seed, density, faintest, intensity
):
    random = np.random.default_rng(seed)
    activation = random.uniform(faintest, 1, 64).astype(np.float32)
    activation *= random.random(64) < density
    slots = both[whole]
    found = slots.slots(activation, intensity)
    several = np.flatnonzero(found.proof.points > 1)
    assert not len(several) or intensity >= slots.certain_from
    assert (np.abs(found.current_ua).sum(axis=1) <= 2000 * profile.total_ma).all()
    threshold = profile.threshold_ma / profile.full_ma
    level = np.where(activation > 0, threshold + (1 - threshold) * activation, 0)
    for slot in several:
        # Its points: those that it reaches best.
        reached = judge.target @ found.current_ua[slot] / judge.wish_af
        mine = np.zeros(64)
        best = np.argsort(-np.where(level > 0, reached / np.where(level > 0, level, 1), -1))
        mine[best[: found.proof.points[slot]]] = level[best[: found.proof.points[slot]]]
        (figures,) = judge.judge(found.current_ua[slot : slot + 1] / 1000, mine[None])
        assert figures.off_target <= found.proof.off_target[slot] * 1.0001
        assert figures.spill <= found.proof.spill[slot] * 1.0001
        assert found.proof.off_target[slot] <= profile.frames.other
        assert found.proof.spill[slot] <= profile.frames.spill


def test_hardly_any_intensity_shows_points_one_by_one(both):
    for slots in both:
        assert 0 < slots.certain_from < 0.02
        activation = np.ones(64, np.float32)
        assert len(slots.slots(activation, 0.99 * slots.certain_from).site) == 64
        assert len(slots.slots(activation, slots.certain_from).site) < 64
