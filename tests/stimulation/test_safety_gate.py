"""The gate refuses sequences beyond a limit. Its ramp permits each strength that is planned."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.clock import LATE_NS
from smarttouch.base.errors import SafetyError
from smarttouch.profile import load_profile
from smarttouch.profile.profile_tables import Output
from smarttouch.stimulation.safety_gate import (
    LEEWAY_PPB,
    MOST_STEP_NS,
    PPB,
    Ramp,
    SafetyGate,
    SafetyLimits,
)
from smarttouch.stimulation.safety_limits import decimal, rms_ma_cm2
from smarttouch.stimulation.sequence_limits import STRENGTH

from ..support.checks import raises
from ..support.scans import open_level, sequence

LIMITS = SafetyLimits(
    electrodes=4, current_ma=3.0, pulse_us=200, charge_uc=0.5, rate_hz=100, duty=0.6, ramp_s=0.5,
    full_ma=2.4, total_ma=3.0, electrode_ma=(3.0, 3.0, 3.0, 0.7),
)  # fmt: skip
SECOND = 10**9


def warmed():
    """Return a gate whose ramp was raised to full intensity by weak current."""
    gate = SafetyGate(LIMITS)
    open_level(gate.check, sequence(GOOD), gate.limits)
    return gate


GOOD = [[-2400, 1200, 600, 600]]


def changed(**fields):
    return dataclasses.replace(sequence(GOOD), **fields)


def test_one_source_drives_no_more_than_one_electrode_may_carry():
    """If the other electrodes lose contact, one electrode carries all current of the source."""
    shared, strong = [[1300, 1300, -1300, -1300]], [[1600, 1600, -1600, -1600]]
    limits = dataclasses.replace(LIMITS, total_ma=10.0, electrode_ma=None)
    for current, width, limit in ((shared, 200, "charge_uc"), (strong, 50, "total_ma")):
        of_one = SafetyGate(limits.on(Output(kind="three-state")))
        of_many = SafetyGate(limits.on(Output(kind="weighted")))
        for gate in (of_one, of_many):
            open_level(gate.check, sequence(GOOD), gate.limits)
        of_many.check(sequence(current, widths=width))
        with raises(SafetyError, limit=limit, slot=0):
            of_one.check(sequence(current, widths=width))
        of_one.check(sequence(shared, widths=190))


@pytest.mark.parametrize(("bad", "limit", "slot", "electrode"), [
    (sequence([[-2400, 1200, 600, 599]]), "balance", 0, None),
    (sequence([[0, 0, 0, 0], [1, 0, 0, 0]]), "balance", 1, None),
    (sequence([[-3001, 3001, 0, 0]], widths=100), "current_ma", 0, 0),
    (sequence([[-2600, 2600, 0, 0]], widths=200), "charge_uc", 0, 0),
    (sequence([[-2500, 2500, 0, 0]], widths=190), "intensity", None, None),
    (sequence([[-2400, 2400, 0, 0]], intensity=0.5), "intensity", None, None),
    (sequence([GOOD[0], [-2100, -2100, 2100, 2100]], widths=100), "current_ma", 1, 3),
    (sequence([GOOD[0], [-2100, -2100, 2100, 2100], GOOD[0]]), "current_ma", 1, 3),
    (sequence([[-2100, -2100, 4200, 0]], widths=90), "current_ma", 0, 2),
    (sequence([[-2400, -700, 2400, 700]]), "total_ma", 0, None),
    (sequence([[-1200, 300, 199, 701]]), "current_ma", 0, 3),
    (sequence(GOOD, widths=201), "pulse_us", None, None),
    (sequence(GOOD, widths=0), "pulse_us", None, None),
    (sequence(GOOD, discharge_us=19), "discharge_us", 0, None),
    (sequence(GOOD, discharge_us=0), "discharge_us", 0, None),
    (sequence(GOOD, period_us=9_999), "rate_hz", None, None),
    (sequence(GOOD, period_us=0), "rate_hz", None, None),
    (sequence(GOOD, period_us=-20_000), "rate_hz", None, None),
    (sequence(GOOD, period_us=2**62), "rate_hz", None, None),
    (sequence(GOOD * 67), "period_us", None, None),
    (sequence(GOOD * 61, discharge_us=20), "duty", None, None),
    (sequence(GOOD, intensity=1.1), "intensity", None, None),
    (sequence(GOOD, intensity=float("nan")), "intensity", None, None),
    (sequence(GOOD, intensity=True), "intensity", None, None),
    (sequence(GOOD, intensity=10**400), "intensity", None, None),
    (sequence(GOOD, period_us=float("nan")), "period_us", None, None),
    (sequence(GOOD, period_us=20_000.0), "period_us", None, None),
    (sequence(GOOD, time_ns=float("nan")), "time_ns", None, None),
    (sequence(GOOD, time_ns=-1), "time_ns", None, None),
    (sequence(GOOD, time_ns=0), "time_ns", None, None),
    (sequence([[-700, 700, 0, 0]] * 31, widths=50), "pulses_hz", None, 0),
    (sequence(GOOD * 25), "mean_ma", None, 0),
    (changed(site=np.full(1, 4, np.uint16)), "site", None, None),
    (changed(current_ua=np.array(GOOD, np.int32)), "current_ua", None, None),
    (changed(current_ua=[[0, 0, 0, 0]]), "current_ua", None, None),
    (changed(width_us=np.array([200.0])), "width_us", None, None),
    (changed(width_us=np.full(2, 200, np.uint16)), "width_us", None, None),
    (changed(current_ua=np.zeros((1, 5), np.int16)), "electrodes", None, None),
])  # fmt: skip
def test_each_limit_raises(bad, limit, slot, electrode):
    named = {} if electrode is None else {"electrode": electrode}
    with raises(SafetyError, limit=limit, slot=slot, **named):
        warmed().check(bad)


@pytest.mark.parametrize(("bad", "limit", "value", "allowed"), [
    # In a period of 20 ms, an electrode may have 30 perceptible pulses and a charge of 10 µC.
    (sequence([[-700, 700, 0, 0]] * 31, widths=50), "pulses_hz", 31, 30),
    (sequence(GOOD * 25), "mean_ma", 12, 10),
])  # fmt: skip
def test_what_is_too_much_is_told_in_pulses_and_microcoulombs(bad, limit, value, allowed):
    with raises(SafetyError, limit=limit, value=value, allowed=allowed):
        warmed().check(bad)


weak_or_strong = st.lists(
    st.tuples(
        st.integers(0, 2400), st.integers(1, 200), st.floats(0, 1), st.integers(5_000, 10**6)
    ),
    max_size=20,
)


@given(weak_or_strong)
def test_whatever_weak_current_claims_it_opens_a_multiple_of_itself(asked):
    """A pulse has at most 4 times the largest earlier charge, plus the ramp's rise in `LATE_NS`."""
    gate, flowed_pc, time_ns = SafetyGate(LIMITS), 0, 0
    gate.check(sequence([], intensity=0.0, time_ns=0))
    for current_ua, width_us, intensity, period_us in asked:
        time_ns += 10**9
        made = sequence(
            [[-current_ua, current_ua, 0, 0]] if current_ua else [],
            widths=width_us, intensity=intensity, period_us=period_us, time_ns=time_ns,
        )  # fmt: skip
        try:
            gate.check(made)
        except SafetyError:
            continue
        full_pc, peak_pc = LIMITS.full_ua * LIMITS.width_whole_us, current_ua * width_us
        step_pc = full_pc * LATE_NS / LIMITS.ramp_ns
        assert peak_pc <= STRENGTH * flowed_pc + step_pc + full_pc / 10**6
        flowed_pc = max(flowed_pc, peak_pc)


def test_parts_and_repetitions_of_a_sequence_open_the_level_once():
    """Of three writes of a sequence, 20 ms apart, only the first raises the level."""
    time_ns, opened = [SECOND], []
    for noted in (1, 3):
        time_ns[0] = SECOND
        gate = SafetyGate(LIMITS, SimpleNamespace(now_ns=lambda: time_ns[0]))
        gate.check(sequence([], intensity=0.0, time_ns=0))
        weak = sequence([[-40, 20, 10, 10]], intensity=0.02, period_us=50_000, time_ns=1)
        proved = gate.prove(weak)
        for _ in range(noted):
            gate.note(proved)
            time_ns[0] += 20_000_000
        time_ns[0] = 2 * SECOND
        opened.append(gate.ramp.allowed_level(2))
    assert opened[0] == opened[1]


def test_an_array_that_answers_for_another_is_read_as_what_it_is():
    class Liar(np.ndarray):
        def tobytes(self, order="C"):
            return np.full(self.shape, 5000, np.int16).tobytes()

        def max(self, *_args, **_kwargs):
            return 0

    lying = changed(current_ua=np.array([[-3001, 3001, 0, 0]], np.int16).view(Liar))
    with raises(SafetyError, value=3.001):
        warmed().check(lying)


@pytest.mark.parametrize(
    "change",
    [
        {"current_ma": 5.1}, {"pulse_us": 201}, {"charge_uc": 0.51}, {"ramp_s": 0.1},
        {"full_ma": 4}, {"total_ma": float("nan")}, {"total_ma": 0}, {"electrode_ma": (1.0,)},
        {"total_ma": 10.1}, {"electrode_ma": (1.0, float("nan"), 1.0, 1.0)},
        {"rate_hz": float("nan")}, {"rate_hz": 201}, {"duty": float("nan")}, {"duty": 0.81},
        {"ramp_s": float("inf")},
        {"ramp_s": float("nan")}, {"area_mm2": float("inf")}, {"area_mm2": 400.1},
        {"electrode_ma": (1.0, 1.0, 1.0, 5.1)}, {"threshold_ma": 5.1}, {"threshold_ma": 1e6},
        {"electrodes": 0}, {"electrodes": 65_536}, {"electrodes": 4.0}, {"masked": (4,)},
        {"masked": (0.0,)}, {"threshold_ma": (1.0, 1.0, 1.0, 0.0)}, {"density_uc_cm2": 101},
        {"session_s": 3601}, {"session_mc": float("nan")},
    ],
)  # fmt: skip
def test_limits_stay_under_the_ceilings(change):
    with raises(SafetyError, limit=next(iter(change))):
        dataclasses.replace(LIMITS, **change)


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
    """Return a ramp that has seen one sequence without current."""
    ramp = Ramp(RAMP_NS)
    ramp.claim(PPB, 0, 0)
    return ramp


def opened():
    """Return a ramp at full strength, and the time at which its last current ends."""
    ramp = begun()
    ramp.note(0, PPB, 0, RAMP_NS)
    ramp.note(PPB, PPB, RAMP_NS, STEP_NS)
    assert ramp.open_at(RAMP_NS)[1] == PPB
    return ramp, RAMP_NS + STEP_NS


@given(steps)
def test_what_is_planned_is_permitted_though_it_is_written_late_or_never(asked):
    """Every third planned sequence is never written; the others are written 5 ms late."""
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
    assert ramp.open_at(now_ns)[1] == ramp.allowed_level(now_ns) == 0
    assert not ramp.permits(LEEWAY_PPB + 1, now_ns)
    ramp.claim(PPB, 0, now_ns)
    assert ramp.permits(LATE_PPB, now_ns)
    assert not ramp.permits(LATE_PPB + LEEWAY_PPB + 1, now_ns)


@pytest.mark.parametrize(("period_ms", "planned"), [
    (20, [0.04, 0.08, 0.12, 0.16]), (50, [0.04, 0.14, 0.24, 0.34]), (500, [0.04, 0.2, 0.36, 0.52]),
])  # fmt: skip
def test_planned_steps_are_as_long_as_pulses_flow(period_ms, planned):
    """Plans first rise as the ramp does in 20 ms, later as in a period, but at most as in 80 ms."""
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
    # Plans restart at zero after 14 s without current; the gate keeps the level for 15 s.
    assert ramp.allowed_level(now_ns + 15 * 10**9) == pytest.approx(0.04)
    assert ramp.open_level(now_ns + 15 * 10**9) == 0


def test_a_sequence_that_is_still_to_be_written_lowers_what_is_planned():
    ramp, now_ns = opened()
    ramp.claim(PPB // 2, PPB // 2, now_ns)
    assert ramp.allowed_level(now_ns) == pytest.approx(0.5 + STEP_NS / RAMP_NS)
    # After a sequence without current (finger lifted), plans restart at the first step.
    ramp.claim(0, 0, now_ns)
    assert ramp.allowed_level(now_ns) == pytest.approx(STEP_NS / RAMP_NS)


def test_a_limit_is_the_decimal_that_a_person_wrote():
    # The nearest double to 2.3 is below 2.3: rounded down, the limit would be 2,299 µA.
    limits = SafetyLimits(2, 2.3, 200, 0.5, 200, 0.8, 0.5, 2.3)
    assert limits.current_ua.tolist() == [2300, 2300]
    assert decimal(0.1) * 10 == 1
    # Fractions of a µs are cut off, so that no pulse is longer than its limit.
    shorter = [dataclasses.replace(limits, pulse_us=pulse_us) for pulse_us in (1.9, 2.0, 99.5)]
    assert [each.width_whole_us for each in shorter] == [1, 2, 99]


@pytest.mark.parametrize(("total_ma", "allowed_ua"), [(6.5, 6500), (None, 10_000)])
def test_the_total_of_a_profile_is_its_own_or_the_ceiling(changed, total_ma, allowed_ua):
    keys = {"limits.total_ma": total_ma, "frames.share": False}
    limits = SafetyLimits.of(changed(load_profile("electric-mouse"), keys))
    assert limits.total_ua == allowed_ua


def test_density_is_that_of_the_paper_s_pulse():
    assert rms_ma_cm2(load_profile("electric-mouse")) == pytest.approx(30.6, abs=0.1)


def test_each_shape_of_an_array_is_bound_by_its_own_area(changed):
    array = {
        "layout": "free",
        "positions_mm": [[0, 0], [0, 0]],
        "shapes": ["disc", "annulus"],
        "sizes_mm": [[0.5, 0.0], [8.0, 6.0]],
    }
    limits = SafetyLimits.of(changed(load_profile("electric-mouse"), {"array": array}))
    area_cm2 = np.pi / 400 * np.array([0.25, 28.0])
    assert limits.charge_pc[0] == pytest.approx(1e8 * area_cm2[0], abs=1)
    assert limits.charge_pc[0] < limits.charge_pc[1] == 500_000
