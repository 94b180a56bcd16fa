"""Finger force gates intensity, and nothing comes on suddenly."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.profile import ForceLaw
from smarttouch.stimulation.intensity import SoftStart, force_gate

LINEAR = ForceLaw(law="linear", contact_n=0.2, full_n=1.0)
LOGARITHMIC = ForceLaw(law="logarithmic", contact_n=0.2, full_n=1.0)


def test_linear_law():
    assert force_gate(0.6, LINEAR) == pytest.approx(0.5)


def test_logarithmic_law_rises_faster_at_first():
    assert force_gate(math.sqrt(0.2), LOGARITHMIC) == pytest.approx(0.5)


@pytest.mark.parametrize("law", [LINEAR, LOGARITHMIC])
@pytest.mark.parametrize("force", [0.0, 0.2, -3.0, math.nan, -math.inf])
def test_no_contact_no_current(law, force):
    assert force_gate(force, law) == 0.0


@pytest.mark.parametrize("law", [LINEAR, LOGARITHMIC])
def test_full_force_and_beyond(law):
    assert force_gate(1.0, law) == force_gate(50.0, law) == force_gate(math.inf, law) == 1.0


@given(st.floats(0, 5), st.floats(0, 5), st.sampled_from([LINEAR, LOGARITHMIC]))
def test_intensity_never_falls_with_force(one, other, law):
    low, high = sorted((one, other))
    assert 0 <= force_gate(low, law) <= force_gate(high, law) <= 1


@given(st.lists(st.tuples(st.floats(0, 1), st.integers(1, 10**9)), min_size=1, max_size=50))
def test_rise_is_bounded_and_fall_is_immediate(steps):
    soft, time_ns, before = SoftStart(0.5), 0, 0.0
    assert soft.follow(1.0, 0) == 0.0
    for wanted, wait in steps:
        time_ns += wait
        now = soft.follow(wanted, time_ns)
        assert now <= wanted
        assert now - before <= wait / 1e9 / 0.5 + 1e-12
        before = now


def test_time_that_goes_back_lets_nothing_rise_or_turn_over():
    start = SoftStart(0.5)
    assert [start.follow(1.0, time_ns) for time_ns in (0, 250_000_000)] == [0, 0.5]
    assert start.follow(1.0, -(2**62)) == 0.5
    assert start.follow(1.0, -(2**62) + 125_000_000) == 0.75
    assert start.follow(0.2, -(2**63)) == 0.2
