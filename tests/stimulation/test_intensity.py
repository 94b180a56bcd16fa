"""Finger force gates intensity, and nothing comes on suddenly."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.clock import LATE_NS
from smarttouch.profile import ForceLaw
from smarttouch.stimulation.intensity import MOST_STEP_NS, SoftStart, force_gate
from smarttouch.stimulation.safety_gate import Rise
from smarttouch.stimulation.safety_limits import parts_per_billion

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


steps = st.lists(
    st.tuples(st.floats(0, 1), st.integers(1, 10**9), st.integers(5_000, 10**6), st.booleans()),
    min_size=1, max_size=60,
)  # fmt: skip


@given(steps)
def test_rise_is_bounded_by_what_flows_and_fall_is_immediate(asked):
    soft, rise, time_ns, period_us, drives = SoftStart(0.5), Rise(500_000_000), 0, 0, False
    assert soft.follow(1.0, 0) == 0.0
    before, since_ns = 0.0, 0
    for wanted, wait_ns, next_us, driving in asked:
        time_ns += wait_ns
        now = soft.follow(wanted, time_ns)
        assert now <= wanted
        flowed_s = min((time_ns - since_ns) / 1e9, period_us / 1e6) if drives else 0.0
        # The first step, and as much more as has flowed, up to one.
        most_s = MOST_STEP_NS / 1e9
        assert now <= before + (min(flowed_s, most_s) + most_s) / 0.5 + 1e-9
        ppb = parts_per_billion(now)
        # The gate permits all of it, with time to spare for lateness.
        assert rise.permits(ppb, time_ns - LATE_NS + MOST_STEP_NS) or not driving
        strength_ppb = ppb * driving
        if strength_ppb:
            rise.note(ppb, strength_ppb, time_ns, 1000 * next_us)
        soft.note(next_us, now, strength_ppb)
        if strength_ppb:
            before, since_ns, period_us, drives = now, time_ns, next_us, True


def test_it_rises_while_pulses_flow_and_stays_while_none_do():
    soft = SoftStart(0.5)
    # Nothing to show for a second, then pulses every 20 ms.
    assert {soft.follow(1.0, time_ns) for time_ns in range(1, 10**9, 20_000_000)} == {0.0, 0.04}
    found = []
    for step in range(3):
        found.append(soft.follow(1.0, 10**9 + step * 20_000_000))
        soft.note(20_000, found[-1], parts_per_billion(found[-1]))
    assert found == pytest.approx([0.04, 0.08, 0.12])
    assert soft.follow(1.0, 14 * 10**9) == pytest.approx(0.16)
    assert soft.follow(1.0, 16 * 10**9) == pytest.approx(0.04)


def test_a_first_step_too_weak_for_any_pulse_grows():
    soft, found = SoftStart(0.5), []
    soft.follow(1.0, 0)
    for step in range(1, 6):
        found.append(soft.follow(1.0, step * 20_000_000))
        soft.note(20_000, found[-1], 0)
    assert found == pytest.approx([0.04, 0.08, 0.16, 0.16, 0.16])


def test_vibration_alone_rises_with_time():
    soft = SoftStart(0.5)
    found = [soft.follow(1.0, step * 10**8, current=False) for step in range(7)]
    assert found == pytest.approx([0, 0.2, 0.4, 0.6, 0.8, 1, 1])
    assert soft.follow(1.0, 7 * 10**8) == pytest.approx(0.04)


def test_time_that_goes_back_lets_nothing_rise_or_turn_over():
    start = SoftStart(0.5)
    start.follow(1.0, 0)
    start.follow(1.0, 1)
    start.note(500_000, 0.04, 40_000_000)
    # A sequence of half a second opens no more than one of 80 ms.
    assert start.follow(1.0, 250_000_001) == pytest.approx(0.2)
    start.note(500_000, 0.2, 200_000_000)
    assert start.follow(1.0, -(2**62)) == pytest.approx(0.2)
    assert start.follow(0.1, -(2**63)) == 0.1
