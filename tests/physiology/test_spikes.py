"""Spikes: by threshold, width, refractoriness and noise; felt where the receptor is."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.response import response_map, response_quality
from smarttouch.physiology.spikes import SpikeModel
from smarttouch.profile import load_profile


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


def test_a_restarted_model_fires_as_at_first(finger):
    model, near = SpikeModel(finger), slots(finger, current_ma=1.5)
    first = model.fire(near)
    model.fire(near)
    model.reset()
    again = model.fire(near)
    assert first.fired.any()
    assert np.array_equal(again.fired, first.fired)
    assert np.array_equal(again.time_us, first.time_us)


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


def test_what_is_felt_is_put_where_the_receptor_is(finger):
    counts = np.zeros(len(finger.classes), np.intp)
    pc = int(np.flatnonzero(finger.classes == Afferent.PC)[0])
    counts[pc] = 2
    places = np.array([finger.receptor_mm[pc], finger.receptor_mm[pc] + 10.0])
    felt_there = response_map(finger, counts, places)
    assert felt_there[Afferent.PC] == pytest.approx([2, 0], abs=1e-6)
    assert not felt_there[[Afferent.RA, Afferent.SAI]].any()
