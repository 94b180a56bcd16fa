"""Ramp by a clock: never more than current that has flowed, and one late step."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.clock import LATE_NS
from smarttouch.stimulation.safety_gate import LEEWAY_PPB, MOST_STEP_NS, PPB, Ramp

RAMP_NS = 500_000_000
LATE_PPB = LATE_NS * PPB // RAMP_NS
STEP_NS = 20_000_000
steps = st.lists(
    st.tuples(
        st.integers(0, 300_000_000), st.integers(0, PPB), st.integers(0, PPB), st.integers(0, 10**9)
    ),
    max_size=40,
)  # fmt: skip


def begun():
    """A ramp after a silent sequence."""
    ramp = Ramp(RAMP_NS)
    ramp.claim(PPB, 0, 0)
    return ramp


def opened():
    """A ramp that is full, and the time at which its last current ends."""
    ramp = begun()
    ramp.note(0, PPB, 0, RAMP_NS)
    ramp.note(PPB, PPB, RAMP_NS, STEP_NS)
    assert ramp.open_ppb(RAMP_NS) == PPB
    return ramp, RAMP_NS + STEP_NS


@given(steps)
def test_what_is_planned_is_permitted_though_it_is_written_late_or_never(asked):
    """Planned from what was proved before, of which each third is replaced."""
    ramp, now_ns = begun(), 0
    for index, (wait_ns, wanted_ppb, weak_ppb, lasting_ns) in enumerate(asked):
        now_ns += wait_ns
        strength_ppb = min(wanted_ppb, round(PPB * ramp.allowed_level(now_ns)))
        assert ramp.permits(strength_ppb, now_ns)
        ramp.claim(strength_ppb, strength_ppb, now_ns)
        if index % 3 and ramp.permits(strength_ppb, now_ns + 5_000_000):
            ramp.note(strength_ppb, min(weak_ppb, strength_ppb), now_ns + 5_000_000, lasting_ns)


@pytest.mark.parametrize("now_ns", [0, 10**12])
def test_a_restart_begins_at_zero_without_current(now_ns):
    ramp, _ = opened()
    ramp.restart()
    assert ramp.open_ppb(now_ns) == ramp.allowed_level(now_ns) == 0
    assert not ramp.permits(LEEWAY_PPB + 1, now_ns)
    ramp.claim(PPB, 0, now_ns)
    assert ramp.permits(LATE_PPB, now_ns)
    assert not ramp.permits(LATE_PPB + LEEWAY_PPB + 1, now_ns)


@pytest.mark.parametrize(("period_ms", "planned"), [
    (20, [0.04, 0.08, 0.12, 0.16]), (50, [0.04, 0.14, 0.24, 0.34]), (500, [0.04, 0.2, 0.36, 0.52]),
])  # fmt: skip
def test_planned_steps_are_as_long_as_pulses_flow(period_ms, planned):
    """From one step of 20 ms, by one of 80 ms at most; after a pause, on from there."""
    ramp, found, now_ns = begun(), [], 10**9
    for _ in planned:
        found.append(ramp.allowed_level(now_ns))
        ppb = round(PPB * found[-1])
        ramp.claim(ppb, ppb, now_ns)
        ramp.note(ppb, ppb, now_ns, period_ms * 1_000_000)
        now_ns += period_ms * 1_000_000
    assert found == pytest.approx(planned, abs=1e-6)
    step = min(period_ms * 1_000_000, MOST_STEP_NS) / RAMP_NS
    assert ramp.allowed_level(now_ns + 13 * 10**9) == pytest.approx(planned[-1] + step, abs=1e-6)
    assert ramp.open_level(now_ns + 13 * 10**9) == pytest.approx(planned[-1], abs=1e-6)
    # A second sooner than the gate closes it.
    assert ramp.allowed_level(now_ns + 15 * 10**9) == pytest.approx(0.04)
    assert ramp.open_level(now_ns + 15 * 10**9) == 0


def test_a_sequence_that_is_still_to_be_written_lowers_what_is_planned():
    ramp, now_ns = opened()
    ramp.claim(PPB // 2, PPB // 2, now_ns)
    assert ramp.allowed_level(now_ns) == pytest.approx(0.5 + STEP_NS / RAMP_NS)
    # So does one without current, as that of a lifted finger.
    ramp.claim(0, 0, now_ns)
    assert ramp.allowed_level(now_ns) == pytest.approx(STEP_NS / RAMP_NS)
