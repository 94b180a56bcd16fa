"""Finger force gates intensity."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.profile import ForceLaw
from smarttouch.stimulation.pulse_rates import force_gate

LINEAR = ForceLaw(law="linear", contact_n=0.2, full_n=1.0)
LOGARITHMIC = ForceLaw(law="logarithmic", contact_n=0.2, full_n=1.0)


@pytest.mark.parametrize(("law", "half_n"), [(LINEAR, 0.6), (LOGARITHMIC, math.sqrt(0.2))])
def test_half_of_full_intensity(law, half_n):
    assert force_gate(half_n, law) == pytest.approx(0.5)


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
