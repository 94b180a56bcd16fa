"""Net charge: what every electrode has passed, and how polarity keeps it down."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.profile import load_profile
from smarttouch.stimulation.recharge import ChargeBalance
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits
from smarttouch.stimulation.scan_sequence import SelectivityReport

from ..rising import open_level
from ..scans import sequence


@st.composite
def balanced(draw):
    """Sequences as a smarttouch-4x4 gets them: one to four slots that sum to zero."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    slots = []
    for _ in range(draw(st.integers(1, 4))):
        shares = rng.integers(-100, 101, 16)
        shares[rng.integers(16)] -= shares.sum()
        slots.append(shares)
    return sequence(slots, rng.integers(10, 201, len(slots)), electrodes=16)


def test_charge_is_current_times_width():
    ledger = ChargeBalance(4)
    ledger.add(sequence([]))
    assert ledger.worst_uc == 0
    ledger.add(sequence([[1000, -600, -400, 0], [0, 0, -2000, 2000]], [200, 100]), 3)
    assert ledger.charge_uc == pytest.approx(3 * np.array([0.2, -0.12, -0.28, 0.2]))
    assert ledger.worst_uc == pytest.approx(0.84)


@given(st.lists(balanced(), min_size=1, max_size=20))
def test_the_choice_is_the_better_one(run):
    ledger = ChargeBalance(16)
    for one in run:
        chosen = ledger.balancing(one)
        found = []
        for sign in (1, -1):
            tried = ChargeBalance(16)
            tried.charge_pc = ledger.charge_pc.copy()
            tried.add(sequence(sign * one.current_ua, one.width_us, electrodes=16))
            found.append((tried.charge_uc**2).sum())
        ledger.add(chosen)
        assert (ledger.charge_uc**2).sum() == pytest.approx(min(found))


@given(balanced())
def test_the_reversed_twin_passes_the_same_gate(one):
    ledger, limits = ChargeBalance(16), SafetyLimits.of(load_profile("smarttouch-4x4"))
    ledger.add(one)
    twin = ledger.balancing(one)
    assert np.array_equal(twin.current_ua, -one.current_ua)
    assert twin.current_ua.dtype == np.int16
    for each in (one, twin):
        gate = SafetyGate(limits)
        open_level(gate.check, each, limits)
        gate.check(each)


def test_what_has_no_twin_stays_as_it_is():
    ledger, extreme = ChargeBalance(4), sequence([[-32768, 32767, 1, 0]], 10)
    ledger.add(extreme)
    assert ledger.balancing(extreme) is extreme
    turned = sequence([[-32767, 32767, 0, 0]], 10)
    assert ledger.balancing(turned).current_ua.tolist() == [[32767, -32767, 0, 0]]


def test_a_turned_scan_has_no_proof():
    proved = sequence([[100, -100, 0, 0]], proof=SelectivityReport.of_nothing(1))
    ledger = ChargeBalance(4)
    assert ledger.balancing(proved) is proved
    ledger.add(proved)
    assert ledger.balancing(proved).proof is None
