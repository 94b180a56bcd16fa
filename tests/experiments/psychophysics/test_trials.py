"""Trains have the frequency, the sites and the length that were asked for."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ExperimentError
from smarttouch.experiments.psychophysics.trials import Stimuli
from smarttouch.profile import load_profile

from ...raising import raises


@pytest.fixture(scope="module")
def stimuli(profile):
    return Stimuli(profile, Afferent.PC, 0.5)


HALF_A_SECOND = Stimuli(load_profile("electric-mouse"), Afferent.RA, 0.5)


@given(st.floats(4, 200))
def test_a_train_is_as_fast_and_as_long_as_asked(rate_hz):
    train = HALF_A_SECOND.train([3], rate_hz)
    assert abs(train.period_us - 1e6 / rate_hz) <= 0.5
    assert abs(train.pulses * train.period_us - 500_000) <= train.period_us
    assert train.pulses >= 2
    assert [*np.flatnonzero(train.activation[Afferent.RA])] == [3]
    assert not train.activation[[Afferent.SAI, Afferent.PC]].any()


def test_a_blank_is_as_long_as_its_train(stimuli):
    train = stimuli.train([1, 2], 30)
    blank = train.blank()
    assert not blank.activation.any()
    assert (blank.pulses, blank.period_us, blank.level) == (15, 33_333, 1.0)
    assert train.activation[Afferent.PC].sum() == 2


def test_a_rising_train_reaches_its_level_at_its_last_pulse(stimuli):
    train = replace(stimuli.train([1], 20), rises=True, level=0.8)
    levels = [train.level_at(each) for each in range(train.pulses)]
    assert levels[0] == pytest.approx(0.08)
    assert levels[-1] == pytest.approx(0.8)
    assert np.diff(levels) == pytest.approx(0.08)


@pytest.mark.parametrize(("rate_hz", "attributes"), [
    (201, {"value": 201, "allowed": (0, 200)}),
    (0, {"value": 0, "allowed": (0, 200)}),
    (2.9, {"value": 1, "allowed": 2}),
])  # fmt: skip
def test_trains_that_cannot_be(stimuli, rate_hz, attributes):
    with raises(ExperimentError, **attributes):
        stimuli.train([0], rate_hz)


@pytest.mark.parametrize("train_s", [0, -1, float("nan"), 1e9])
def test_lengths_that_cannot_be(profile, train_s):
    with raises(ExperimentError, value=train_s, allowed=(0, 60)):
        Stimuli(profile, Afferent.RA, train_s)


def test_the_middle_is_driven(profile, changed):
    middle = Stimuli(profile, Afferent.RA, 1).middle
    assert np.hypot(*profile.electrodes.position_mm[middle]) < 1.5
    without = changed(profile, {"output.masked": (middle,)})
    other = Stimuli(without, Afferent.RA, 1).middle
    assert other != middle
    assert np.hypot(*profile.electrodes.position_mm[other]) < 1.5


def test_beside_is_to_the_right_and_on_the_same_row(profile, stimuli):
    place_mm = profile.electrodes.position_mm
    for right_mm, other in stimuli.beside(27).items():
        assert place_mm[other] - place_mm[27] == pytest.approx((right_mm, 0))
