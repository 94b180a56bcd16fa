"""Rise by a clock: never more than the ramp of current that has flowed, and one late step."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.clock import LATE_NS
from smarttouch.stimulation.safety_gate import LEEWAY_PPB, LEVEL_KEPT_NS, Rise
from smarttouch.stimulation.safety_limits import PPB

RAMP_NS = 500_000_000
HURRIED_PPB = LATE_NS * PPB // RAMP_NS
STEP_NS = 20_000_000
steps = st.lists(
    st.tuples(
        st.integers(0, 300_000_000), st.integers(0, PPB), st.integers(0, PPB), st.integers(0, 10**9)
    ),
    max_size=40,
)  # fmt: skip


def opened():
    """A level that a whole ramp of current has opened, which is over by now."""
    rise = Rise(RAMP_NS)
    rise.note(0, PPB, 0, RAMP_NS)
    rise.note(PPB, PPB, RAMP_NS, STEP_NS)
    assert rise.risen_ppb(RAMP_NS) == PPB
    return rise, RAMP_NS + STEP_NS


@given(steps)
def test_what_begins_is_below_the_ramp_of_current_since_its_first_step(asked):
    """And no more than a step above the strongest that has flowed."""
    rise, now_ns, driven_ns, spans, strongest_ppb = Rise(RAMP_NS), 0, 0, [], 0
    for wait_ns, ppb, strength_ppb, lasting_ns in asked:
        now_ns += wait_ns
        # Passes one after another, and no more of them than time has gone by.
        driven_ns = sum(min(lasting, now_ns - start) for start, lasting in spans)
        if rise.permits(strength_ppb, now_ns):
            if lasting_ns:
                ramp_ppb = min(strongest_ppb, driven_ns * PPB // RAMP_NS)
                assert strength_ppb <= ramp_ppb + HURRIED_PPB + LEEWAY_PPB
                spans.append((now_ns, lasting_ns))
                strongest_ppb = max(strongest_ppb, strength_ppb)
            rise.note(ppb, strength_ppb, now_ns, lasting_ns)


@given(st.integers(0, PPB), st.integers(0, RAMP_NS))
def test_it_goes_on_from_what_was_reached(reached_ppb, wait_ns):
    rise, now_ns = opened()
    rise.note(reached_ppb, PPB, now_ns, RAMP_NS)
    assert rise.risen_ppb(now_ns) == reached_ppb
    risen_ppb = min(PPB, reached_ppb + wait_ns * PPB // RAMP_NS)
    assert rise.risen_ppb(now_ns + wait_ns) == risen_ppb


@pytest.mark.parametrize("now_ns", [0, 10**12])
def test_it_begins_at_zero_whenever_that_is(now_ns):
    rise, _ = opened()
    rise.restart()
    assert rise.risen_ppb(now_ns) == 0
    assert not rise.permits(HURRIED_PPB + 2 * LEEWAY_PPB, now_ns)


@pytest.mark.parametrize("silence", ["none is sent", "empty passes", "repetitions end"])
def test_a_level_stays_through_silence_and_not_for_ever(silence):
    """Never higher: a second of silence opens no more than the pass before it."""
    rise, _ = opened()
    rise.note(PPB // 2, PPB, 10**9, 10**12 if silence == "repetitions end" else STEP_NS)
    end_ns, wanted_ppb = 10**9 + STEP_NS, PPB // 2 + STEP_NS * PPB // RAMP_NS
    if silence != "none is sent":
        rise.note(PPB, 0, end_ns, 0)
    if silence == "repetitions end":
        # The pass that runs is finished.
        end_ns, wanted_ppb = end_ns + LATE_NS, wanted_ppb + HURRIED_PPB
    for later_ns in (STEP_NS, 10**9, LEVEL_KEPT_NS):
        assert rise.risen_ppb(end_ns + later_ns) in (wanted_ppb, wanted_ppb - 1)
    assert rise.risen_ppb(end_ns + LEVEL_KEPT_NS + 1) == 0


def test_current_alone_opens_it():
    rise = Rise(RAMP_NS)
    for step in range(100):
        rise.note(PPB, 0, step * STEP_NS, 0)
    assert rise.risen_ppb(100 * STEP_NS) == 0
    rise.note(HURRIED_PPB, HURRIED_PPB, 10**10, STEP_NS)
    assert rise.risen_ppb(2 * 10**10) == STEP_NS * PPB // RAMP_NS


@given(st.integers(0, PPB), st.integers(0, PPB))
def test_weak_current_neither_raises_a_level_nor_lowers_it(weak_ppb, ppb):
    """Whatever it claims, and however long it flows; a lower claim lowers it."""
    rise = Rise(RAMP_NS)
    rise.note(PPB, weak_ppb, 0, 10 * RAMP_NS)
    assert rise.risen_ppb(10 * RAMP_NS) == weak_ppb
    rise, now_ns = opened()
    rise.note(ppb, 0, now_ns, 10 * RAMP_NS)
    assert rise.risen_ppb(now_ns + 10 * RAMP_NS) == ppb


def test_jitter_costs_nothing():
    """Steps that come by turns early and late count as much as regular ones."""
    rise = Rise(RAMP_NS)
    for step in range(1, 27):
        now_ns = step * STEP_NS + (step % 2) * 9_000_000
        ppb = min(PPB, step * STEP_NS * PPB // RAMP_NS)
        assert rise.permits(ppb, now_ns)
        rise.note(ppb, ppb, now_ns, STEP_NS)
    assert rise.risen_ppb(27 * STEP_NS + 9_000_000) > 0.95 * PPB


def test_a_clock_that_falls_stands_still():
    rise = Rise(RAMP_NS)
    rise.note(0, PPB, 10**9, 10**9)
    assert rise.risen_ppb(0) == 0
