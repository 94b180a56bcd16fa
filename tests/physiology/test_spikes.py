"""Spikes: by threshold, width, refractoriness and noise; felt where the receptor is."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import smarttouch
from smarttouch.base.afferent import Afferent
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.response import response_quality
from smarttouch.physiology.spikes import NodeDrives, SpikeModel
from smarttouch.profile import load_profile

from ..support.checks import assert_close
from ..support.full import WHOLE


@pytest.fixture(scope="module")
def finger():
    return Finger(load_profile("smarttouch-4x4"), 2, "paper")


def slots(finger, count=3, current_ma=4.0, width_us=200, discharge_us=100):
    """One electrode against all others, several times."""
    electrodes = len(finger.profile.electrodes)
    pattern = np.full(electrodes, -1000 * current_ma / (electrodes - 1))
    pattern[5] = 1000 * current_ma
    return SimpleNamespace(
        current_ua=np.tile(pattern, (count, 1)).astype(np.int16),
        width_us=np.full(count, width_us, np.uint16),
        discharge_us=np.full(count, discharge_us, np.uint16),
        period_us=20_000,
    )


def test_an_axon_is_refractory_after_a_spike(finger):
    model = SpikeModel(finger)
    first, second = model.fire(slots(finger)), model.fire(slots(finger))
    assert first.fired.any()
    assert first.counts.max() == 1
    assert second.counts.max() == 1
    assert np.array_equal(first.time_us, [0, 300, 600])
    assert np.array_equal(second.time_us, 20_000 + first.time_us)


def test_without_refractoriness_every_slot_counts(finger):
    anatomy = finger.anatomy.model_copy(
        update={
            name: finger.anatomy.of(Afferent[name.upper()]).model_copy(
                update={"refractory_us": 0.0, "noise": 0.0}
            )
            for name in ("ra", "sai", "pc")
        }
    )
    spikes = SpikeModel(Finger(finger.profile, 2, anatomy)).fire(slots(finger))
    assert set(spikes.counts) == {0, 3}


def test_more_current_fires_all_that_less_does(finger):
    fired = [
        SpikeModel(finger).fire(slots(finger, 1, each)).fired[:, 0] for each in (1.0, 2.0, 4.0)
    ]
    assert fired[2].sum() > fired[0].sum()
    for less, more in pairwise(fired):
        assert np.all(more[less])


def test_a_shorter_pulse_does_less_by_weiss_s_law(finger):
    model, pattern = SpikeModel(finger), slots(finger, 2).current_ua
    long, short = model.drive(pattern, np.array([200, 100])).T
    expected = (1 + 151 / 200) / (1 + 151 / 100)
    assert short == pytest.approx(expected * long, rel=1e-4)


def test_measures_of_what_was_felt(finger):
    places = finger.profile.electrodes.position_mm
    active = np.zeros(len(places), bool)
    active[[0, 15]] = True
    away = np.linalg.norm(finger.receptor_mm - places[0], axis=1)
    ra = np.flatnonzero(finger.classes == Afferent.RA)
    near_ra = ra[away[ra].argmin()]
    beyond = np.linalg.norm(finger.receptor_mm[:, None] - places[active], axis=2).min(axis=1)
    far_sai = np.flatnonzero(finger.classes == Afferent.SAI)
    far_sai = far_sai[beyond[far_sai].argmax()]
    counts = np.zeros(len(finger.classes), np.intp)
    counts[near_ra], counts[far_sai] = 3, 1
    found = response_quality(finger, counts, active, [Afferent.RA])
    assert (found.spikes, found.silent_points) == (4, 0.5)
    assert (found.wrong_class, found.misplaced) == (0.25, 0.25)
    assert found.afferents == {Afferent.RA: 1, Afferent.SAI: 1, Afferent.PC: 0}
    nothing = response_quality(finger, 0 * counts, active, [Afferent.RA])
    assert nothing.silent_points == 1
    assert np.isnan(nothing.wrong_class)


@pytest.fixture(scope="module", params=["paper", "branched"])
def either(request):
    return Finger(load_profile("smarttouch-4x4"), 3, request.param)


@pytest.fixture(scope="module")
def drives(either):
    return NodeDrives(*either.rows)


def dense(rows, current_ma):
    return np.maximum.reduceat(rows[0] @ current_ma.T, rows[1], axis=0)


@settings(max_examples=100 if WHOLE else 10)
@given(
    seed=st.integers(0, 2**32 - 1), strongest_ma=st.floats(0.01, 8.0), least=st.floats(-0.5, 1.5)
)
def test_only_drives_below_the_least_are_left_out(either, drives, seed, strongest_ma, least):
    random = np.random.default_rng(seed)
    current = strongest_ma * random.normal(0, 1, (3, either.rows[0].shape[1])).astype(np.float32)
    expected = dense(either.rows, current)
    found, near = drives.highest_from(least, current), expected >= least
    assert_close(drives.highest(current), expected, rel=1e-4, abs=1e-5)
    assert_close(found[near], expected[near], rel=1e-4, abs=1e-5)
    assert np.all(found <= expected + 1e-4 * (1 + np.abs(expected)))


@pytest.mark.parametrize("widths", [(200,), (100, 200, 500)])
def test_many_slots_fire_what_each_fires_alone(either, widths):
    """Hundreds are bounded first, a few are not; slots come again, with other widths, too."""
    random, electrodes = np.random.default_rng(1), either.rows[0].shape[1]
    current = np.rint(random.normal(0, 1500, (150, electrodes)))[np.arange(300) // 2]
    width = np.array(widths)[np.arange(300) % len(widths)]
    many = SpikeModel(either).drive(current, width, firing=True)
    model, fires = SpikeModel(either), 0
    for first in range(0, 300, 50):
        part = slice(first, first + 50)
        alone = model.drive(current[part], width[part], firing=True)
        near = alone >= 0.94
        assert_close(many[:, part][near], alone[near], rel=1e-4)
        assert np.all(many[:, part][~near] < 0.95)
        fires += np.count_nonzero(near)
    assert fires > 100


@pytest.fixture(scope="module")
def mouse():
    return smarttouch.Finger(smarttouch.load_profile("electric-mouse"), seed=1, anatomy="paper")


@pytest.fixture(scope="module")
def steps(mouse):
    source = smarttouch.open_source("text:TTTT", mouse.profile, speed_mm_s=30)
    return list(smarttouch.steps(source, mouse.profile, seconds=2.5))


def strongest(steps):
    """Return the step of most slots among those of the highest level, which pulses open."""
    return max(steps, key=lambda step: (step.sequence.intensity, step.sequence.slots))


def test_steps_sequences_and_lists_of_them_give_the_same_response(mouse, steps):
    strong = strongest(steps)
    one, bare, several = (mouse.feel(each) for each in (strong, strong.sequence, [strong]))
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


def test_a_list_is_one_stretch_of_time(mouse, steps):
    """Refractoriness goes on from sequence to sequence, and equal slots are computed once."""
    feeling = mouse.feel(steps, seed=3)
    model = SpikeModel(mouse, 3)
    for step, spikes in zip(steps, feeling.spikes, strict=True):
        alone = model.fire(step.sequence)
        np.testing.assert_array_equal(spikes.time_us, alone.time_us)
        # One product of a matrix and another differ in the last digit.
        assert np.count_nonzero(spikes.fired != alone.fired) <= 2
    np.testing.assert_array_equal(feeling.counts, mouse.feel(steps, seed=3).counts)
