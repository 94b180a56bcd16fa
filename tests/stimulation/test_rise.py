"""Rise by a clock: never more than the ramp and one late step, however steps are delayed."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.clock import LATE_NS
from smarttouch.stimulation.limits import PPB
from smarttouch.stimulation.safety import LEEWAY_PPB, Rise

RAMP_NS = 500_000_000
HURRIED_PPB = LATE_NS * PPB // RAMP_NS
steps = st.lists(st.tuples(st.integers(0, 300_000_000), st.integers(0, PPB)), max_size=40)


@given(steps)
def test_what_begins_is_below_the_ramp_from_its_first_step(asked):
    rise, now_ns, first_ns = Rise(RAMP_NS), 0, None
    for wait_ns, ppb in asked:
        now_ns += wait_ns
        if rise.permits(ppb, now_ns):
            rise.note(ppb, now_ns)
            first_ns = now_ns if first_ns is None else first_ns
            ramp_ppb = (now_ns - first_ns) * PPB // RAMP_NS
            assert ppb <= ramp_ppb + HURRIED_PPB + LEEWAY_PPB


@given(st.integers(0, PPB), st.integers(0, RAMP_NS))
def test_it_goes_on_from_what_was_reached(reached_ppb, wait_ns):
    rise = Rise(RAMP_NS)
    rise.note(0, 0)
    rise.note(PPB, RAMP_NS)
    rise.note(reached_ppb, RAMP_NS)
    assert rise.risen_ppb(RAMP_NS) == reached_ppb
    assert rise.permits(min(PPB, reached_ppb + wait_ns * PPB // RAMP_NS), RAMP_NS + wait_ns)


@pytest.mark.parametrize("now_ns", [0, 10**12])
def test_it_begins_at_zero_whenever_that_is(now_ns):
    rise = Rise(RAMP_NS)
    rise.note(0, 0)
    rise.note(PPB, RAMP_NS)
    rise.restart()
    assert rise.risen_ppb(now_ns) == 0
    assert not rise.permits(HURRIED_PPB + 2 * LEEWAY_PPB, now_ns)


def test_a_clock_that_falls_stands_still():
    rise = Rise(RAMP_NS)
    rise.note(0, 10**9)
    assert rise.risen_ppb(0) == 0
