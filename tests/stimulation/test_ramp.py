"""Ramp by a clock: never more than current that has flowed, and one late step."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.clock import LATE_NS
from smarttouch.stimulation.ramp import LEEWAY_PPB, LEVEL_KEPT_NS, MOST_STEP_NS, PPB, Ramp

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
    ramp.claim(PPB, 0)
    return ramp


def opened():
    """A ramp that is full, and the time at which its last current ends."""
    ramp = begun()
    ramp.note(0, PPB, 0, RAMP_NS)
    ramp.note(PPB, PPB, RAMP_NS, STEP_NS)
    assert ramp.open_ppb(RAMP_NS) == PPB
    return ramp, RAMP_NS + STEP_NS


@given(steps)
def test_what_begins_is_below_the_ramp_of_current_since_its_first_step(asked):
    """And no more than a step above the strongest that has flowed."""
    ramp, now_ns, spans, strongest_ppb = begun(), 0, [], 0
    for wait_ns, ppb, strength_ppb, lasting_ns in asked:
        now_ns += wait_ns
        # Passes one after another, and no more of them than time has gone by.
        driven_ns = sum(min(lasting, now_ns - start) for start, lasting in spans)
        if ramp.permits(strength_ppb, now_ns):
            if strength_ppb:
                ramp_ppb = min(strongest_ppb, driven_ns * PPB // RAMP_NS)
                assert strength_ppb <= ramp_ppb + LATE_PPB + LEEWAY_PPB
                spans.append((now_ns, lasting_ns))
                strongest_ppb = max(strongest_ppb, strength_ppb)
            ramp.note(ppb, strength_ppb, now_ns, lasting_ns)


@given(steps)
def test_what_is_planned_is_permitted_though_it_is_written_late_or_never(asked):
    """Planned from what was proved before, of which each third is replaced."""
    ramp, now_ns = begun(), 0
    for index, (wait_ns, wanted_ppb, weak_ppb, lasting_ns) in enumerate(asked):
        now_ns += wait_ns
        strength_ppb = min(wanted_ppb, round(PPB * ramp.allowed_level(now_ns)))
        assert ramp.permits(strength_ppb, now_ns)
        ramp.claim(strength_ppb, strength_ppb)
        if index % 3 and ramp.permits(strength_ppb, now_ns + 5_000_000):
            ramp.note(strength_ppb, min(weak_ppb, strength_ppb), now_ns + 5_000_000, lasting_ns)


@given(st.integers(0, PPB), st.integers(0, RAMP_NS))
def test_it_goes_on_from_what_was_reached(reached_ppb, wait_ns):
    ramp, now_ns = opened()
    ramp.note(reached_ppb, PPB, now_ns, RAMP_NS)
    assert ramp.open_ppb(now_ns) == reached_ppb
    open_ppb = min(PPB, reached_ppb + wait_ns * PPB // RAMP_NS)
    assert ramp.open_ppb(now_ns + wait_ns) == open_ppb


@pytest.mark.parametrize("now_ns", [0, 10**12])
def test_a_restart_begins_at_zero_without_current(now_ns):
    ramp, _ = opened()
    ramp.restart()
    assert ramp.open_ppb(now_ns) == ramp.allowed_level(now_ns) == 0
    assert not ramp.permits(LEEWAY_PPB + 1, now_ns)
    ramp.claim(PPB, 0)
    assert ramp.permits(LATE_PPB, now_ns)
    assert not ramp.permits(LATE_PPB + LEEWAY_PPB + 1, now_ns)


@pytest.mark.parametrize("silence", ["none is sent", "empty passes", "repetitions end"])
def test_a_level_stays_through_silence_and_not_for_ever(silence):
    """Never higher: a second of silence opens no more than the pass before it."""
    ramp, _ = opened()
    ramp.note(PPB // 2, PPB, 10**9, 10**12 if silence == "repetitions end" else STEP_NS)
    end_ns, wanted_ppb = 10**9 + STEP_NS, PPB // 2 + STEP_NS * PPB // RAMP_NS
    if silence != "none is sent":
        ramp.note(PPB, 0, end_ns, 0)
    if silence == "repetitions end":
        # The pass that runs is finished.
        end_ns, wanted_ppb = end_ns + LATE_NS, wanted_ppb + LATE_PPB
    for later_ns in (STEP_NS, 10**9, LEVEL_KEPT_NS):
        assert ramp.open_ppb(end_ns + later_ns) in (wanted_ppb, wanted_ppb - 1)
    assert ramp.open_ppb(end_ns + LEVEL_KEPT_NS + 1) == 0


def test_current_alone_opens_it():
    ramp = begun()
    for step in range(100):
        ramp.note(PPB, 0, step * STEP_NS, STEP_NS)
    assert ramp.open_ppb(100 * STEP_NS) == 0
    ramp.note(LATE_PPB, LATE_PPB, 10**10, STEP_NS)
    assert ramp.open_ppb(2 * 10**10) == STEP_NS * PPB // RAMP_NS


@given(st.integers(1, PPB), st.integers(0, PPB))
def test_weak_current_neither_raises_a_level_nor_lowers_it(weak_ppb, ppb):
    """Whatever it claims, and however long it flows; a lower claim lowers it."""
    ramp = begun()
    ramp.note(PPB, weak_ppb, 0, 10 * RAMP_NS)
    assert ramp.open_ppb(10 * RAMP_NS) == weak_ppb
    ramp, now_ns = opened()
    ramp.note(ppb, 1, now_ns, 10 * RAMP_NS)
    assert ramp.open_ppb(now_ns + 10 * RAMP_NS) == max(1, ppb)


def test_jitter_costs_nothing():
    """Steps that come by turns early and late count as much as regular ones."""
    ramp = begun()
    for step in range(1, 27):
        now_ns = step * STEP_NS + (step % 2) * 9_000_000
        ppb = min(PPB, step * STEP_NS * PPB // RAMP_NS)
        assert ramp.permits(ppb, now_ns)
        ramp.note(ppb, ppb, now_ns, STEP_NS)
    assert ramp.open_ppb(27 * STEP_NS + 9_000_000) > 0.95 * PPB


def test_a_clock_that_falls_stands_still():
    ramp = begun()
    ramp.note(0, PPB, 10**9, 10**9)
    assert ramp.open_ppb(0) == 0


@pytest.mark.parametrize(("period_ms", "planned"), [
    (20, [0.04, 0.08, 0.12, 0.16]), (50, [0.04, 0.14, 0.24, 0.34]), (500, [0.04, 0.2, 0.36, 0.52]),
])  # fmt: skip
def test_planned_steps_are_as_long_as_pulses_flow(period_ms, planned):
    """From one step of 20 ms, by one of 80 ms at most; after a pause, on from there."""
    ramp, found, now_ns = begun(), [], 10**9
    for _ in planned:
        found.append(ramp.allowed_level(now_ns))
        ppb = round(PPB * found[-1])
        ramp.claim(ppb, ppb)
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
    ramp.claim(PPB // 2, PPB // 2)
    assert ramp.allowed_level(now_ns) == pytest.approx(0.5 + STEP_NS / RAMP_NS)
    # So does one without current, as that of a lifted finger.
    ramp.claim(0, 0)
    assert ramp.allowed_level(now_ns) == pytest.approx(STEP_NS / RAMP_NS)
