"""Whole µA, and what a proof shows."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.stimulation.scan_sequence import SelectivityReport, round_charge_balanced


@given(st.integers(0, 6), st.integers(1, 80), st.integers(0, 2**32 - 1), st.floats(0, 5000))
def test_whole_currents_sum_to_zero_and_none_is_off_by_one(slots, electrodes, seed, most_ua):
    current_ua = np.random.default_rng(seed).uniform(-1, 1, (slots, electrodes))
    current_ua -= current_ua.mean(axis=1, keepdims=True)
    current_ua *= most_ua / 2
    whole = round_charge_balanced(current_ua)
    assert whole.dtype == np.int16
    assert not whole.sum(axis=1).any()
    assert (np.abs(whole - current_ua) < 1).all()


def test_whole_currents_stay_as_they_are():
    current_ua = np.array([[2400.0, -2400.0, 0.0], [1.0, 1.0, -2.0]])
    assert (round_charge_balanced(current_ua) == current_ua).all()


def test_shared_slots_are_reported_apart_from_single_points():
    ratio = np.array([0.5, 0.2, 0.25, np.nan], np.float32)
    proof = SelectivityReport(np.array([1, 2, 3, 0], np.uint16), ratio, ratio / 2)
    assert proof.shared == (0.25, 0.125)
    assert SelectivityReport(np.ones(4, np.uint16), ratio, ratio).shared is None
    assert SelectivityReport.of_nothing(3).shared is None
