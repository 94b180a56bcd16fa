"""Tests of the skin circuit (against a numerical solution), the finger and the delivery log."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import solve_ivp

from smarttouch.base.errors import BoardError
from smarttouch.emulator.firmware_base import RECHARGE, DeliveryLog, read_slots, read_state
from smarttouch.emulator.skin import (
    FORMS,
    Delivered,
    EmulatedFinger,
    SkinCircuit,
)

from ..support.checks import raises
from ..support.full import sample

HEALTHY = SkinCircuit(16).series_ohm


def unequal(electrodes, seed, **options):
    skin = SkinCircuit(electrodes, **options)
    generator = np.random.default_rng(seed)
    skin.scale(generator.uniform(0.3, 4, electrodes), 1 / generator.uniform(0.3, 4, electrodes))
    return skin


def solve(skin, currents, duration_us, volts=0.0):
    """Solve the circuit's equations numerically; return charge, pC, and capacitor voltages."""
    count = skin.electrodes

    def change(_, y):
        current = currents(y[:count])
        leak = y[:count] / skin.parallel_ohm
        return np.concatenate([(current - leak) / skin.capacitance_f, current])

    start = np.concatenate([volts + np.zeros(count), np.zeros(count)])
    answer = solve_ivp(
        change, (0, duration_us * 1e-6), start, "LSODA", rtol=1e-8, atol=1e-14, max_step=1e-6
    )
    return answer.y[count:, -1] * 1e12, answer.y[:count, -1]


def switched(skin, state, source_ua, shunt_ohm=np.inf):
    def currents(volts):
        out = np.zeros(skin.electrodes)
        admittance, ends, ohm = 1 / skin.series_ohm, [], 0.0
        for pole in (state > 0, state < 0):
            ohm += 1 / admittance[pole].sum()
            ends.append((volts * admittance)[pole].sum() / admittance[pole].sum())
        before = ends[0] - ends[1]
        total = (source_ua * 1e-6 - before / shunt_ohm) / (1 + ohm / shunt_ohm)
        total = min(total, (skin.compliance_v - before) / ohm)
        for pole, end, sign in ((state > 0, ends[0], 1), (state < 0, ends[1], -1)):
            node = end + sign * total / admittance[pole].sum()
            out[pole] = ((node - volts) * admittance)[pole]
        return out

    return currents


@pytest.mark.parametrize("seed", sample(range(6), 4))
@pytest.mark.parametrize("width_us", [50, 200])
@pytest.mark.parametrize(("compliance_v", "shunt_ohm"), [(300, np.inf), (60, np.inf), (300, 66e3)])
def test_a_switched_pulse_divides_by_the_equations(seed, width_us, compliance_v, shunt_ohm):
    skin = unequal(12, seed, compliance_v=compliance_v)
    state = np.random.default_rng(seed).integers(-1, 2, 12).astype(np.int8)
    state[:2] = 1, -1
    charge_pc, volts = solve(skin, switched(skin, state, 3000, shunt_ohm), width_us)
    delivered = skin.switched_pulse(state, 3000, width_us, shunt_ohm)
    np.testing.assert_allclose(delivered.charge_pc, charge_pc, rtol=0.03, atol=0.003 * 3000 * 50)
    np.testing.assert_allclose(
        skin.residual_uc, skin.capacitance_f * volts * 1e6, rtol=0.03, atol=2e-4
    )
    assert delivered.source_v <= compliance_v * (1 + 1e-9)
    assert delivered.source_v == pytest.approx(
        delivered.volts[state > 0].max() - delivered.volts[state < 0].min()
    )


def test_a_weighted_pulse_is_what_was_asked_and_exact():
    skin = unequal(6, 3)
    current = np.array([900.0, -100, -200, -300, -400, 100])
    _, volts = solve(skin, lambda _: current * 1e-6, 150)
    delivered = skin.pulse(current, 150)
    np.testing.assert_array_equal(delivered.current_ua, current)
    expected = volts + current * 1e-6 * skin.series_ohm
    np.testing.assert_allclose(delivered.volts, expected, rtol=1e-4)
    assert delivered.source_v == pytest.approx(expected[0] - expected.min(), rel=1e-4)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("duration_us", [3, 12, 50, 300])
def test_a_short_circuit_is_solved_and_keeps_the_charge(seed, duration_us):
    """If impedances differ by a factor of ten, errors are below 5 % of the largest charge."""
    skin = unequal(6, seed)
    skin.pulse(np.array([900.0, -100, -200, -300, -400, 100]), 150)
    before_uc, admittance = skin.residual_uc, 1 / skin.series_ohm

    def currents(volts):
        return ((volts * admittance).sum() / admittance.sum() - volts) * admittance

    _, volts = solve(skin, currents, duration_us, before_uc / skin.capacitance_f / 1e6)
    skin.short(duration_us)
    left_uc = skin.capacitance_f * volts * 1e6
    assert np.abs(skin.residual_uc - left_uc).max() <= 0.05 * np.abs(before_uc).max()
    skin.parallel_ohm = np.full(6, 1e13)
    total_uc = skin.residual_uc.sum()
    skin._shorts_of.cache_clear()
    skin.short(duration_us)
    assert skin.residual_uc.sum() == pytest.approx(total_uc, abs=1e-6)


def test_impedances_differ_by_no_more_than_asked():
    even, uneven = SkinCircuit(500, spread=0.0), SkinCircuit(500, spread=0.2)
    for name in ("series_ohm", "parallel_ohm", "capacitance_f"):
        ratio = getattr(uneven, name) / getattr(even, name)
        assert (ratio.min(), ratio.max()) == pytest.approx((0.8, 1.2), abs=0.01)


PULSES = st.lists(
    st.tuples(
        arrays(np.int8, 6, elements=st.integers(-1, 1)),
        arrays(np.float64, 6, elements=st.floats(-2e4, 2e4)),
        st.floats(0.5, 500),
        st.floats(0, 300),
    ),
    min_size=1,
    max_size=5,
)


@given(pulses=PULSES, seed=st.integers(0, 9), compliance_v=st.sampled_from([5.0, 300.0]))
def test_currents_sum_to_zero_and_never_pass_the_compliance(pulses, seed, compliance_v):
    one_source, own_sources = (unequal(6, seed, compliance_v=compliance_v) for _ in range(2))
    most_v = compliance_v * (1 + 1e-9) + 1e-9
    for state, current, width_us, short_us in pulses:
        switched = one_source.switched_pulse(state, abs(current[0]), width_us)
        # A shared source has at most the compliance voltage between its poles.
        assert switched.source_v <= most_v
        # An electrode with its own source has at most the compliance voltage against the tissue.
        own = own_sources.pulse(current, width_us)
        assert np.abs(own.volts).max() <= most_v
        for skin, delivered in ((one_source, switched), (own_sources, own)):
            size = np.abs(delivered.charge_pc).sum()
            assert abs(delivered.charge_pc.sum()) <= 1e-9 * size + 1e-9
            assert np.isfinite(delivered.volts).all()
            skin.short(short_us)


def test_a_finger_lifts_and_touches_and_electrodes_break():
    events = ["3.0 touch", "2 lift", "0 force 0.9", "1 open 7", "1 short 8"]
    finger, skin = EmulatedFinger(16, events), SkinCircuit(16)
    current = np.r_[1500.0, np.full(15, -100.0)]
    skin.pulse(current, 100)
    volts = skin.residual_uc / skin.capacitance_f
    for now_s, force_n, cut in ((0.5, 0.9, 0), (1.5, 0.9, 1), (2.0, 0, 16), (3.0, 0.9, 1)):
        finger.at(now_s, skin)
        assert finger.force_n == force_n
        assert (skin.series_ohm > 5e8).sum() == cut
        # The voltages of capacitors stay the same when impedances change.
        np.testing.assert_allclose(skin.residual_uc / skin.capacitance_f, volts)
    np.testing.assert_allclose(skin.series_ohm[:7], HEALTHY[:7])
    assert skin.series_ohm[8] + skin.parallel_ohm[8] < 10
    switch = EmulatedFinger(16, ["1 emergency", "2 release"])
    assert list(map(switch.opens_switch, (0.9, 1.0, 1.9, 2.0))) == [False, True, True, False]


@pytest.mark.parametrize(("text", "allowed"), [
    ("", tuple(FORMS)),
    ("lift", tuple(FORMS)),
    ("1 jump", tuple(FORMS)),
    ("soon lift", "TIME lift"),
    ("1 lift 3", "TIME lift"),
    ("1 open 1.5", "TIME open ELECTRODE"),
    ("1 force", "TIME force NEWTON"),
    ("-1 lift", None),
    ("inf lift", None),
    ("1 force nan", None),
    ("1 open -1", None),
    ("1 open 16", "0 to 15"),
])  # fmt: skip
def test_bad_text_is_one_clear_sentence(text, allowed):
    with raises(BoardError, names="event", allowed=allowed):
        EmulatedFinger(16, [text])


def enter(books, current_ua, width_us=100, residual_uc=0.0, **other):
    current = np.array(current_ua, np.float64)
    delivered = Delivered(current, current * width_us, current / 50, float(np.ptp(current) / 50))
    books.enter(7, 2, 1, delivered, width_us, current * 0 + residual_uc, 1234.6, **other)
    return books


def test_what_is_read_is_what_was_entered(tmp_path):
    books = DeliveryLog(3, tmp_path)
    enter(books, [300.4, -100, -200.4], residual_uc=-0.001)
    books.write()
    enter(books, [40_000, -20_000, -20_000])
    books.write()
    slots = read_slots(tmp_path)
    assert slots["number"].tolist() == [7, 7]
    assert (slots["slot"][0], slots["site"][0], slots["time_us"][0]) == (2, 1, 1234)
    assert slots["current_ua"].tolist() == [[300, -100, -200], [40_000, -20_000, -20_000]]
    np.testing.assert_allclose(slots["volts"][0], [6, -2, -4], rtol=0.01)
    np.testing.assert_allclose(slots["residual_uc"][0], -0.001, rtol=0.001)
    state = read_state(tmp_path)
    assert (state["slots"], state["pulses"], state["unsafe"]) == (2, 6, 1)
    assert state["max_volts"] == pytest.approx(1200)


@pytest.mark.parametrize(("current_ua", "width_us", "unsafe"), [
    (5000, 100, 0), (5000.004, 100, 0), (5001, 50, 1), (-5001, 50, 1), (5000, 101, 1),
    (100, 200, 0), (100, 201, 1), (2500, 200, 0), (2501, 200, 1), (0, 60_000, 0),
])  # fmt: skip
def test_unsafe_is_what_flowed_above_a_safe_value(current_ua, width_us, unsafe):
    assert enter(DeliveryLog(2), [current_ua, -current_ua], width_us).unsafe == unsafe


@pytest.mark.parametrize(("current_ua", "width_us", "unsafe"), [
    (500, 4000, 0), (501, 10, 1), (100, 20_001, 1), (500, 4001, 1),
])  # fmt: skip
def test_a_recharge_phase_has_its_own_safe_values(current_ua, width_us, unsafe):
    books, current = DeliveryLog(2), np.array([current_ua, -current_ua], float)
    delivered = Delivered(current, current * width_us, current, 0.0)
    books.enter(1, RECHARGE, RECHARGE, delivered, width_us, current * 0, 0.0)
    assert (books.unsafe, books.recharges, books.slots) == (unsafe, 1, 0)


def test_two_pulses_of_a_slot_count_as_one_slot():
    books = DeliveryLog(2)
    enter(books, [100, -100], residual_uc=0.5, more=True)
    enter(books, [-100, 100], residual_uc=0.25)
    assert (books.slots, books.pulses, books.max_net_charge_uc) == (1, 4, 0.25)


def test_what_rounds_to_nothing_is_no_pulse():
    assert enter(DeliveryLog(3), [0.4, -0.4, 0]).pulses == 0
