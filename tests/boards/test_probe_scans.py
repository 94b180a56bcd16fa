"""Voltages become impedances, also in pairs, and bad electrodes are told from good ones."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.errors import BoardError
from smarttouch.boards.open import make_board
from smarttouch.boards.probe_scans import (
    measure_by_probes,
    measure_in_pairs,
    one_each,
    probe_sequences,
)
from smarttouch.boards.reports import Capabilities, judge
from smarttouch.profile import load_profile
from smarttouch.profile.device import Output
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits

from ..raising import raises

LIMITS = SafetyLimits(8, 3.0, 200, 0.5, 100, 0.6, 0.5, 2.4)


def volts_of(kohm, current_ma):
    """One electrode against all others in parallel, each in turn."""
    admittance = 1 / np.asarray(kohm, float)
    others = admittance.sum() - admittance
    return current_ma * (np.asarray(kohm, float) + 1 / others)


@given(st.lists(st.floats(10, 40), min_size=8, max_size=64))
def test_impedances_are_found_again(kohm):
    found = judge(volts_of(kohm, 0.5), 0.5, 300.0)
    np.testing.assert_allclose(found.kohm, kohm, rtol=1e-3)
    assert found.broken == ()
    assert not found.lifted


def test_open_and_short_are_named():
    volts = volts_of([20.0] * 8, 0.5)
    volts[2], volts[5] = 300.0, 0.6
    found = judge(volts, 0.5, 300.0)
    assert found.condition == tuple(
        {2: "open", 5: "short"}.get(index, "good") for index in range(8)
    )
    assert found.broken == (2, 5)


def test_a_load_beside_the_skin_is_taken_off():
    kohm = np.array([20.0, 25.0, 30.0, 20.0, 25.0, 30.0, 20.0, 25.0])
    can = Capabilities(
        8, "one-against-all", 3.0, 8, None, "", measures=True, compliance_v=300.0, load_kohm=66.0
    )

    def ask(scan):
        """Return the voltage of each slot, of skin and load in parallel."""
        through_ma = scan.source_ua / 1000
        return through_ma / (1 / 66 + 1 / volts_of(kohm, 1.0))[: scan.slots]

    output = Output(kind="one-against-all")
    np.testing.assert_allclose(measure_by_probes(ask, LIMITS, output, can).kohm, kohm, rtol=1e-3)


def test_a_lifted_finger_is_all_open():
    assert judge(np.full(8, 299.0), 0.5, 300.0).lifted


def test_a_probe_rises_from_zero_and_every_step_is_safe():
    gate = SafetyGate(LIMITS)
    sequences = list(probe_sequences(LIMITS, None))
    for sequence in sequences:
        gate.check(sequence)
    assert sequences[0].slots == 0
    assert sequences[-1].slots == 8
    assert np.abs(sequences[-1].current_ua).max() == 500


def test_a_probe_keeps_to_what_the_board_can():
    *_, last = probe_sequences(LIMITS, Output(kind="one-against-all", polarities=("anodic",)))
    assert (last.current_ua[np.arange(8), last.site] < 0).all()


def test_limits_too_low_to_measure_are_named():
    limits = SafetyLimits(2, 0.02, 200, 0.5, 100, 0.6, 0.5, 0.02)
    with raises(BoardError, names="limits", value=18):
        next(probe_sequences(limits, None))


@given(masked=st.sets(st.integers(0, 7), max_size=6), level=st.integers(1, 2000))
def test_masked_electrodes_are_no_returns(masked, level):
    limits = SafetyLimits(8, 5.0, 200, 0.5, 200, 0.8, 0.5, 2.4)
    sites = [site for site in range(8) if site not in masked]
    scan = one_each(limits, level, 50, 1.0, 0, cathodic=True, sites=sites, masked=tuple(masked))
    assert not scan.current_ua[:, sorted(masked)].any()
    assert not scan.current_ua.sum(axis=1).any()
    assert (scan.current_ua.max(axis=1) == level).all()


PAIR_LIMITS = SafetyLimits(24, 5.0, 200, 0.5, 200, 0.8, 0.5, 2.4)
COMPLIANCE_V = 300.0


class Skin:
    """Each electrode an impedance, infinite where it is open; proves what it is sent."""

    def __init__(self, kohm):
        self.kohm, self.scans = np.asarray(kohm, float), 0
        self.gate = SafetyGate(PAIR_LIMITS)

    def __call__(self, scan):
        self.gate.prove(scan, ramped=False)
        self.scans += 1
        volts = (np.abs(scan.current_ua) / 1000 * np.where(scan.current_ua, self.kohm, 0)).sum(1)
        return np.minimum(volts, COMPLIANCE_V)

    def measured(self):
        with np.errstate(invalid="ignore"):
            probe = one_each(PAIR_LIMITS, 400, 50, 0.2, 0, cathodic=True)
            return measure_in_pairs(self, PAIR_LIMITS, probe, COMPLIANCE_V)


@given(
    kohm=st.lists(st.floats(20, 60), min_size=24, max_size=24),
    broken=st.sets(st.integers(0, 23), max_size=12),
)
def test_what_conducts_is_measured_and_what_is_open_named(kohm, broken):
    kohm = np.array(kohm)
    kohm[list(broken)] = np.inf
    found = Skin(kohm).measured()
    assert found.broken == tuple(sorted(broken))
    assert found.kohm == pytest.approx(kohm)
    assert found.current_ma == 0.4


@pytest.mark.parametrize("touching", [[], [5]])
def test_a_lifted_finger(touching):
    kohm = np.full(24, np.inf)
    kohm[touching] = 40
    assert Skin(kohm).measured().lifted


def test_a_short_is_found():
    kohm = np.full(24, 40.0)
    kohm[3] = 0.1
    found = Skin(kohm).measured()
    assert found.condition[3] == "short"
    assert found.broken == (3,)


def test_a_good_reference_is_enough():
    kohm = np.full(24, 40.0)
    kohm[9] = np.inf
    skin = Skin(kohm)
    skin.measured()
    assert skin.scans == 2


@pytest.mark.usefixtures("patient_boards")
def test_an_emulated_board_of_weighted_outputs(start_emulator):
    _, port = start_emulator("event=0 open 7", "event=0 open 40", electrodes=64)
    profile = load_profile("electric-mouse")
    with make_board(f"link:{port}", SafetyLimits.of(profile), profile.output) as board:
        found = board.measure()
        assert board.report().violations == 0
    assert found.broken == (7, 40)
    good = np.delete(found.kohm, [7, 40])
    assert np.isfinite(good).all()
    assert good.max() < 3 * good.min()
