"""Open electrodes are found, and all others measured, where every output forces its own current."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.boards.open import make_board
from smarttouch.boards.probe_scans import measure_in_pairs, one_each
from smarttouch.profile import load_profile
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits

pytestmark = pytest.mark.usefixtures("patient_boards")

LIMITS = SafetyLimits(24, 5.0, 200, 0.5, 200, 0.8, 0.5, 2.4)
COMPLIANCE_V = 300.0


class Skin:
    """Each electrode an impedance, infinite where it is open; proves what it is sent."""

    def __init__(self, kohm):
        self.kohm, self.scans = np.asarray(kohm, float), 0
        self.gate = SafetyGate(LIMITS)

    def __call__(self, scan):
        self.gate.prove(scan, ramped=False)
        self.scans += 1
        volts = (np.abs(scan.current_ua) / 1000 * np.where(scan.current_ua, self.kohm, 0)).sum(1)
        return np.minimum(volts, COMPLIANCE_V)

    def measured(self):
        with np.errstate(invalid="ignore"):
            probe = one_each(LIMITS, 400, 50, 0.2, 0, cathodic=True)
            return measure_in_pairs(self, LIMITS, probe, COMPLIANCE_V)


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
