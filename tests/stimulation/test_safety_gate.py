"""Every limit raises, and nothing that keeps them is refused."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.clock import LATE_NS
from smarttouch.base.errors import SafetyError
from smarttouch.profile.device import Output
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits
from smarttouch.stimulation.sequence_limits import STRENGTH

from ..support.checks import raises
from ..support.scans import open_level, sequence

LIMITS = SafetyLimits(
    electrodes=4, current_ma=3.0, pulse_us=200, charge_uc=0.5, rate_hz=100, duty=0.6, ramp_s=0.5,
    full_ma=2.4, total_ma=3.0, electrode_ma=(3.0, 3.0, 3.0, 0.7),
)  # fmt: skip
SECOND = 10**9


def warmed():
    """A gate in which a second of the least current has opened full intensity."""
    gate = SafetyGate(LIMITS)
    open_level(gate.check, sequence(GOOD), gate.limits)
    return gate


GOOD = [[-2400, 1200, 600, 600]]


def changed(**fields):
    return dataclasses.replace(sequence(GOOD), **fields)


def test_one_source_drives_no_more_than_one_electrode_may_carry():
    """Where all but one come off the skin, that one carries what they shared."""
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


class ManualClock:
    """Time as a test sets it."""

    def __init__(self):
        self.time_ns = 0

    def now_ns(self):
        return self.time_ns


weak_or_strong = st.lists(
    st.tuples(
        st.integers(0, 2400), st.integers(1, 200), st.floats(0, 1), st.integers(5_000, 10**6)
    ),
    max_size=20,
)


@given(weak_or_strong)
def test_whatever_weak_current_claims_it_opens_a_multiple_of_itself(asked):
    """And one step of what may be late: a fifth of a full pulse, or a fifth for its fourfold."""
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
    """Written three times, 20 ms apart: its one pass counts from the first."""
    clock, opened = ManualClock(), []
    for noted in (1, 3):
        gate, clock.time_ns = SafetyGate(LIMITS, clock), SECOND
        gate.check(sequence([], intensity=0.0, time_ns=0))
        weak = sequence([[-40, 20, 10, 10]], intensity=0.02, period_us=50_000, time_ns=1)
        proved = gate.prove(weak)
        for _ in range(noted):
            gate.note(proved)
            clock.time_ns += 20_000_000
        clock.time_ns = 2 * SECOND
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
