"""Feelings of steps and sequences."""

import numpy as np
import pytest

import smarttouch as st
from smarttouch.base.afferent import Afferent
from smarttouch.physiology.response import fire_all
from smarttouch.physiology.spikes import SpikeModel


@pytest.fixture(scope="module")
def finger():
    return st.Finger(st.load_profile("electric-mouse"), seed=1, anatomy="paper")


@pytest.fixture(scope="module")
def steps(finger):
    source = st.open_source("text:TTTT", finger.profile, speed_mm_s=30)
    return list(st.steps(source, finger.profile, seconds=2.5))


def strongest(steps):
    """Return the step of most slots among those of the highest level, which pulses open."""
    return max(steps, key=lambda step: (step.sequence.intensity, step.sequence.slots))


def test_steps_sequences_and_lists_of_them_give_the_same_response(finger, steps):
    strong = strongest(steps)
    one, bare, several = (finger.feel(each) for each in (strong, strong.sequence, [strong]))
    for other in (bare, several):
        np.testing.assert_array_equal(one.counts, other.counts)
    assert one.counts.sum() > 0
    assert (one.wanted, bare.wanted) == ((Afferent.RA,), tuple(Afferent))
    np.testing.assert_array_equal(one.active, strong.tactile.activation.any(axis=0))
    # What is too faint for a pulse is in no sequence.
    assert not (bare.active & ~one.active).any()
    assert bare.active.any()
    assert bare.quality.wrong_class == 0
    assert one.quality.spikes == one.counts.sum()


def test_a_list_is_one_stretch_of_time(finger, steps):
    """Refractoriness goes on from sequence to sequence, and equal slots are computed once."""
    feeling = finger.feel(steps, seed=3)
    model = SpikeModel(finger, 3)
    for step, spikes in zip(steps, feeling.spikes, strict=True):
        alone = model.fire(step.sequence)
        np.testing.assert_array_equal(spikes.time_us, alone.time_us)
        # One product of a matrix and another differ in the last digit.
        assert np.count_nonzero(spikes.fired != alone.fired) <= 2
    np.testing.assert_array_equal(feeling.counts, finger.feel(steps, seed=3).counts)


def test_nothing_is_felt_of_nothing(finger):
    feeling = finger.feel([])
    assert feeling.spikes == ()
    assert feeling.quality.spikes == 0
    assert list(fire_all(SpikeModel(finger), [])) == []
