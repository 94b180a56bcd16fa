"""Measured current scales of kits, impedances from voltages, and open or shorted electrodes."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.errors import BoardError, SafetyError
from smarttouch.boards.impedance import judge, measure_by_probes
from smarttouch.boards.open import make_board
from smarttouch.boards.reports import Capabilities
from smarttouch.profile import load_profile
from smarttouch.profile.kit_scales import BAND, NOMINAL_UA, measured_scale
from smarttouch.profile.profile_tables import Output
from smarttouch.stimulation.probe_scans import probe_sequences
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits

from ..support.checks import raises
from ..support.scans import one_each

KINDS = tuple(NOMINAL_UA)
ELECTRODES = {"kajimoto61": 61, "etactilekit": 8}
WIDTH_US = {"kajimoto61": 50, "etactilekit": 200}


def board_of(kind, ua_per_count, **changes):
    count = ELECTRODES[kind]
    fields = {"current_ma": 3.0, "pulse_us": 200, "charge_uc": 0.5, "rate_hz": 100, "duty": 0.6}
    limits = SafetyLimits(count, **fields | {"ramp_s": 0.5, "full_ma": 2.8} | changes)
    output = Output(kind="one-against-all", ua_per_count=ua_per_count)
    return make_board(f"{kind}:/dev/nowhere", limits, output), limits


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "factor", [1e-6, 0.001, 1 / 4.09, 0.5, 1 - BAND - 0.001, 1 + BAND + 0.001, 2.0, 4.09, 1000, 1e6]
)
def test_a_scale_beyond_the_band_is_refused_before_anything_is_opened(kind, factor):
    scale_ua = factor * NOMINAL_UA[kind]
    # The port does not exist: opening it would raise another error.
    with raises(BoardError, names="output.ua_per_count", value=scale_ua):
        board_of(kind, scale_ua)


def counts_of(kind, board, current_ua, limits):
    sequence = one_each(
        limits, current_ua, WIDTH_US[kind], 1.0, 10**9, cathodic=False, sites=[1],
        discharge_us=150, period_us=20_000,
    )  # fmt: skip
    data = board.driver.encode(sequence)
    if kind == "kajimoto61":
        return 16 * data[2]
    return int(np.frombuffer(data[1], "<u2")[1])


@given(ratio=st.floats(1 - BAND, 1 + BAND), kind=st.sampled_from(KINDS), part=st.floats(0, 1))
def test_counts_keep_current_and_charge_by_either_scale(ratio, kind, part):
    limit_ma = 2.4 if kind == "kajimoto61" else 2.0
    own = tuple([limit_ma] * ELECTRODES[kind])
    board, limits = board_of(kind, ratio * NOMINAL_UA[kind], electrode_ma=own, charge_uc=0.3)
    assert board.driver.ua_per_count == pytest.approx(ratio * NOMINAL_UA[kind])
    wanted_ua = int(part * 1000 * min(limit_ma, 300 / WIDTH_US[kind]))
    counts = counts_of(kind, board, wanted_ua, limits)
    for scale_ua in (NOMINAL_UA[kind], board.driver.ua_per_count):
        assert counts * scale_ua <= 1000 * limit_ma * (1 + 1e-9)
        assert counts * scale_ua * WIDTH_US[kind] <= 0.3e6 * (1 + 1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_a_scale_that_is_too_low_does_not_raise_the_largest_current(kind):
    nominal, _ = board_of(kind, None)
    low, limits = board_of(kind, (1 - BAND) * NOMINAL_UA[kind])
    most = 2500 if kind == "etactilekit" else 3000
    assert counts_of(kind, low, most, limits) == counts_of(kind, nominal, most, limits)
    # At 1500 µA, well below the largest current, the driver uses the measured scale.
    ratio = counts_of(kind, low, 1500, limits) / counts_of(kind, nominal, 1500, limits)
    assert ratio == pytest.approx(1 / (1 - BAND), rel=0.05)


@pytest.mark.parametrize(("volts", "ohm", "current_ma"), [
    (0.0, 1000, 1), (-1.0, 1000, 1), (math.nan, 1000, 1), (math.inf, 1000, 1), (1.0, math.nan, 1),
    (1.0, math.inf, 1), (1.0, 0, 1), (1.0, 1000, math.nan), (1.0, 1000, -1), (1000.0, 1000, 1),
    (1.0, 1, 1), (0.001, 1000, 1), (1.0, 1000, 1000), (2.0, 1000, 1), (1e-320, 1e308, 1),
    (1.31, 1000, 1),
])  # fmt: skip
def test_impossible_readings_are_refused(volts, ohm, current_ma):
    with raises(BoardError):
        measured_scale("link", None, volts, ohm, current_ma)


@pytest.mark.parametrize("kind", KINDS)
def test_measuring_again_cannot_leave_the_band(kind):
    before_ua = 1.2 * NOMINAL_UA[kind]
    assert measured_scale(kind, before_ua, 0.9, 1000, 1.0) == pytest.approx((0.9, 0.9 * before_ua))
    with raises(BoardError, names="output.ua_per_count", value=1.44):
        measured_scale(kind, before_ua, 1.2, 1000, 1.0)


LIMITS = SafetyLimits(8, 3.0, 200, 0.5, 100, 0.6, 0.5, 2.4)
WIDE = SafetyLimits(24, 5.0, 200, 0.5, 200, 0.8, 0.5, 2.4)
COMPLIANCE_V = 300.0
SOURCE = Output(kind="one-against-all")


def volts_of(kohm, current_ma):
    """Return the voltage of each electrode against all others in parallel, (E,) V."""
    admittance = 1 / np.asarray(kohm, float)
    others = admittance.sum() - admittance
    return current_ma * (np.asarray(kohm, float) + 1 / others)


@given(st.lists(st.floats(10, 40), min_size=8, max_size=64))
def test_impedances_are_found_again(kohm):
    found = judge(volts_of(kohm, 0.5), 0.5, COMPLIANCE_V)
    np.testing.assert_allclose(found.kohm, kohm, rtol=1e-3)
    assert (found.broken, found.lifted) == ((), False)


def test_open_and_short_are_named():
    volts = volts_of([20.0] * 8, 0.5)
    volts[2], volts[5] = COMPLIANCE_V, 0.6
    found = judge(volts, 0.5, COMPLIANCE_V)
    assert [found.condition[at] for at in (1, 2, 5)] == ["good", "open", "short"]
    assert found.broken == (2, 5)
    assert judge(np.full(8, 299.0), 0.5, COMPLIANCE_V).lifted


def test_a_load_beside_the_skin_is_taken_off():
    kohm, gate = np.array([20.0, 25.0, 30.0, 20.0, 25.0, 30.0, 20.0, 25.0]), SafetyGate(LIMITS)
    can = Capabilities(
        8, SOURCE.kind, 3.0, 8, None, "", measures=True, compliance_v=300.0, load_kohm=66.0
    )

    def ask(scan):
        """Return the voltage of each slot across skin and load in parallel, (S,) V."""
        scan = gate.check(scan)
        return scan.source_ua / 1000 / (1 / 66 + 1 / volts_of(kohm, 1.0))[: scan.slots]

    np.testing.assert_allclose(measure_by_probes(ask, LIMITS, SOURCE, can).kohm, kohm, rtol=1e-3)


def test_a_probe_keeps_to_what_the_board_can():
    output = Output(kind="one-against-all", polarities=("anodic",))
    *_, last = probe_sequences(LIMITS, output, in_pairs=False)
    assert (last.current_ua[np.arange(8), last.site] < 0).all()


def test_limits_too_low_to_measure_are_named():
    limits = SafetyLimits(2, 0.02, 200, 0.5, 100, 0.6, 0.5, 0.02)
    with raises(BoardError, names="limits", value=18):
        next(probe_sequences(limits, None, in_pairs=True))


@given(masked=st.sets(st.integers(0, 7), max_size=6), in_pairs=st.booleans())
def test_masked_electrodes_carry_nothing(masked, in_pairs):
    limits, gate = replace(LIMITS, masked=tuple(masked)), SafetyGate(LIMITS)
    *rising, scan = map(gate.check, probe_sequences(limits, None, in_pairs=in_pairs))
    assert (rising[0].slots, max(each.current_ua.max(initial=0) for each in rising)) == (0, 475)
    assert scan.slots == (8 - len(masked)) * (min(4, (8 - len(masked)) // 2) if in_pairs else 1)
    assert not scan.current_ua[:, sorted(masked)].any()
    assert (scan.current_ua[np.arange(scan.slots), scan.site] == 500).all()
    assert ((scan.current_ua < 0).sum(axis=1) == (1 if in_pairs else 7 - len(masked))).all()
    if in_pairs:
        assert not scan.current_ua.sum(axis=0).any()
    shares = [each.intensity for each in (*rising, scan)]
    np.testing.assert_allclose(shares, np.linspace(0, 0.5 / 2.4, len(shares)))


def measured(kohm):
    """Measure a board that has one current source per electrode; the gate checks each scan."""
    gate = SafetyGate(WIDE)
    can = Capabilities(24, "weighted", 5.0, 999, 0.0, "", measures=True, compliance_v=COMPLIANCE_V)

    def ask(scan):
        scan = gate.check(scan)
        with np.errstate(invalid="ignore"):
            dropped = np.where(scan.current_ua, np.abs(scan.current_ua) / 1000 * kohm, 0)
        return np.minimum(dropped.sum(axis=1), COMPLIANCE_V)

    return measure_by_probes(ask, WIDE, None, can)


@given(
    kohm=st.lists(st.floats(20, 60), min_size=24, max_size=24),
    broken=st.sets(st.integers(0, 23), max_size=7),
)
def test_what_conducts_is_measured_and_what_is_open_named(kohm, broken):
    kohm = np.array(kohm)
    kohm[list(broken)] = np.inf
    found = measured(kohm)
    assert found.broken == tuple(sorted(broken))
    assert found.kohm == pytest.approx(kohm)
    assert found.current_ma == 0.5


@pytest.mark.parametrize(("touching", "lifted"), [([], True), ([5], True), ([5, 7], False)])
def test_a_finger_that_touches_next_to_nothing(touching, lifted):
    kohm = np.full(24, np.inf)
    kohm[touching] = 40
    assert measured(kohm).lifted == lifted


def test_a_short_is_found():
    kohm = np.full(24, 40.0)
    kohm[3] = 0.1
    assert measured(kohm).condition[3] == "short"


@pytest.mark.realtime
def test_an_emulated_board_of_weighted_outputs(start_emulator):
    _, port = start_emulator("event=0 open 7", "event=0 open 40", electrodes=64)
    profile = load_profile("electric-mouse")
    with make_board(f"link:{port}", SafetyLimits.of(profile), profile.output) as board:
        limits = SafetyLimits.of(profile)
        board.send(one_each(limits, 0, 200, 0.0, 10**10, cathodic=True, period_us=20_000))
        found = board.measure()
        # The measurement has not raised the ramp, so the gate refuses this sequence.
        weak = one_each(limits, 300, 200, 0.2, 0, cathodic=True, sites=[3], period_us=20_000)
        with raises(SafetyError, limit="ramp_s", allowed=0):
            board.send(weak)
        assert board.report().violations == 0
    assert found.broken == (7, 40)
    good = np.delete(found.kohm, [7, 40])
    assert good.max() < 3 * good.min()
