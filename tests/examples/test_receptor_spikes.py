"""Afferents under vibrations and presses: each class by its tuning, near what touches the skin."""

from itertools import pairwise

import numpy as np
import pytest
from studies.receptor_spikes import skin_spikes

from smarttouch.base.afferent import Afferent
from smarttouch.instruments.skin_trace import open_trace
from smarttouch.physiology.finger import Finger
from smarttouch.profile import load_profile

SEEDS = range(1, 13)
SECONDS = 1.0


@pytest.fixture(scope="module")
def fingers():
    return [Finger(load_profile("smarttouch-4x4"), seed, "paper") for seed in SEEDS]


def nearest_hz(fingers, spec, afferent, count):
    """Rates of the nearest afferents of a class, (F, count) Hz."""
    rates = []
    for finger in fingers:
        mine = np.flatnonzero(finger.classes == afferent)
        mine = mine[np.linalg.norm(finger.receptor_mm[mine], axis=1).argsort()[:count]]
        rates.append(skin_spikes(finger, open_trace(spec, SECONDS)).counts[mine] / SECONDS)
    return np.array(rates)


def test_rates_are_those_of_touchsim(fingers):
    """No RA of nine answers 8 µm at 30 Hz, some 45 µm are needed; a press gives SAI 24 Hz."""
    assert (nearest_hz(fingers, "tone:30Hz,8um", Afferent.RA, 9) > 0).mean() < 1 / 18
    assert (nearest_hz(fingers, "tone:30Hz,45um", Afferent.RA, 2) > 0).mean() > 0.8
    pressed = nearest_hz(fingers, "press:0.45N", Afferent.SAI, 2)
    assert pressed.mean() == pytest.approx(24, abs=8)
    assert nearest_hz(fingers, "tone:250Hz,1.5um", Afferent.PC, 1).max() > 200


@pytest.mark.parametrize(
    ("spec", "alone"), [("tone:30Hz,30um", Afferent.RA), ("tone:250Hz,2um", Afferent.PC)]
)
def test_most_spikes_are_of_the_class_that_is_best_there(fingers, spec, alone):
    counts = sum(
        np.bincount(finger.classes, skin_spikes(finger, open_trace(spec, 0.5)).counts, 3)
        for finger in fingers
    )
    assert counts.argmax() == alone
    assert counts[Afferent.SAI] == 0


def test_spikes_keep_to_the_phase_and_none_comes_twice_in_a_cycle(fingers):
    spikes = skin_spikes(fingers[0], open_trace("tone:30Hz,80um", SECONDS))
    mine = fingers[0].classes[spikes.afferent] == Afferent.RA
    within = (spikes.time_s > 0.1) & (spikes.time_s < 0.9) & mine
    assert np.ptp(np.mod(spikes.time_s[within] * 30 + 0.5, 1)) < 0.02
    assert spikes.counts[fingers[0].classes == Afferent.RA].max() <= 31


def test_more_amplitude_and_nearness_fire_more(fingers):
    counts = [
        skin_spikes(fingers[1], open_trace(f"tone:30Hz,{um}um", 0.5)).counts for um in (20, 40, 80)
    ]
    for less, more in pairwise(counts):
        assert more[less > 0].all()
        assert more.sum() > less.sum()
    away = np.linalg.norm(fingers[1].receptor_mm, axis=1)
    fired = (counts[1] > 0) & (fingers[1].classes == Afferent.RA)
    assert away[fired].mean() < away[fingers[1].classes == Afferent.RA].mean() / 2


def test_the_same_seed_gives_the_same_spikes_and_silence_none(fingers):
    trace = open_trace("tone:30Hz,50um+press:0.2N", 0.3)
    one, again, other = (skin_spikes(fingers[0], trace, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(one.time_s, again.time_s)
    assert not np.array_equal(one.counts, other.counts)
    assert not len(skin_spikes(fingers[0], open_trace("press:0N", 0.3)).time_s)
