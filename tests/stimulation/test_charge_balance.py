"""Charge balance of electrodes, by reversed polarity or by recharge phases."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.profile import load_profile
from smarttouch.stimulation.charge_balance import (
    ChargeBalance,
    RechargeRules,
    add_recharge,
    net_charge_pc,
    recharge_most_ua,
)
from smarttouch.stimulation.scan_sequence import ScanTiming, SelectivityReport
from smarttouch.stimulation.sequence_limits import (
    MOST_RECHARGE_PC,
    MOST_RECHARGE_US,
)

from ..support.scans import sequence


@st.composite
def balanced(draw):
    """Draw a sequence of one to four charge-balanced slots for the profile smarttouch-4x4."""
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


def rules(most_ua=120, electrodes=4, total_ua=10_000, timing=None):
    most = np.broadcast_to(np.asarray(most_ua, np.int64), (electrodes,))
    return RechargeRules(most, total_ua, timing or ScanTiming())


NOTHING = np.zeros(4, np.int64)
ONE = [[1000, -600, -400, 0]]


@st.composite
def scans(draw, most_slots=30, strongest_ua=2400):
    """Draw a sequence of 2 to 12 electrodes; currents sum to zero and slots fit the period."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    electrodes, slots = draw(st.integers(2, 12)), draw(st.integers(0, most_slots))
    shares = rng.integers(-strongest_ua, strongest_ua, (slots, electrodes)) // electrodes
    shares[:, rng.integers(electrodes)] -= shares.sum(axis=1)
    widths = rng.integers(1, 201, slots)
    shortest_us = max(5000, int(widths.sum()) + 100 * slots)
    return sequence(
        shares, widths, electrodes=electrodes, period_us=draw(st.integers(shortest_us, 60_000))
    )


@st.composite
def situations(draw):
    """Draw a scan, the net charge of electrodes before the scan, and limits of recharge phases."""
    scan = draw(scans())
    carried = np.array(
        [draw(st.integers(-4_000_000, 4_000_000)) for _ in range(scan.electrodes)], np.int64
    )
    carried[draw(st.integers(0, scan.electrodes - 1))] -= carried.sum()
    most_ua = [draw(st.integers(0, 500)) for _ in range(scan.electrodes)]
    total_ua = draw(st.sampled_from([1, 50, 300, 10_000]))
    timing = ScanTiming(whole_hz=draw(st.booleans()))
    return scan, carried, rules(most_ua, scan.electrodes, total_ua, timing)


@settings(deadline=None)
@given(situations())
def test_whatever_comes_the_phase_keeps_its_limits(situation):
    scan, carried_pc, within = situation
    planned = add_recharge(scan, carried_pc, within)
    for name in ("current_ua", "width_us", "discharge_us", "site"):
        assert getattr(planned, name) is getattr(scan, name)
    assert planned.period_us >= scan.period_us
    if planned.recharge_ua is None:
        assert planned is scan
        return
    current_ua, width_us = planned.recharge_ua.astype(int), planned.recharge_us
    wanted_pc = -(carried_pc + net_charge_pc(scan))
    assert current_ua.dtype.kind == "i"
    assert current_ua.any()
    assert current_ua.sum() == 0
    assert not (current_ua * np.sign(wanted_pc) < 0).any(), "a net charge was increased"
    assert not current_ua[wanted_pc == 0].any(), "an electrode that needs no recharge gets current"
    assert (np.abs(current_ua) <= within.most_ua).all()
    passed_pc = np.abs(current_ua) * width_us
    assert (passed_pc <= np.minimum(MOST_RECHARGE_PC, np.abs(wanted_pc) + width_us)).all()
    assert np.maximum(current_ua, 0).sum() <= within.total_ua
    mean_over_us = min(planned.period_us, 40_000)
    slots_pc = scan.width_us.astype(int) @ np.abs(scan.current_ua.astype(int))
    assert (slots_pc + passed_pc)[current_ua != 0].max() <= 500 * mean_over_us
    busy_us = int(scan.width_us.sum()) + int(scan.discharge_us.sum()) + width_us
    assert busy_us + int(scan.discharge_us.max()) <= planned.period_us, "no discharge follows"


@settings(deadline=None)
@given(scans(most_slots=10, strongest_ua=1000), st.integers(1, 500))
def test_what_can_be_brought_back_is_but_for_less_than_a_microampere(scan, most_ua):
    within = rules(most_ua, scan.electrodes)
    net_pc = net_charge_pc(scan)
    planned = add_recharge(scan, 0 * net_pc, within)
    if np.abs(net_pc).max(initial=0) > min(MOST_RECHARGE_PC, most_ua * MOST_RECHARGE_US):
        return
    left_pc = net_charge_pc(planned)
    # Remaining charge keeps its sign, and is at most the rounding error of integer currents.
    assert (left_pc * np.sign(net_pc) >= 0).all()
    if planned.recharge_us:
        assert np.abs(left_pc).sum() <= 2 * scan.electrodes * planned.recharge_us
        # The recharge phase is as short as possible: 1 µs less would break the current limit.
        assert np.abs(net_pc).max() > (planned.recharge_us - 1) * most_ua


def test_the_numbers_of_one():
    planned = add_recharge(sequence(ONE), NOTHING, rules(120))
    # Returning 0.2 µC at 120 µA takes 1667 µs.
    assert planned.recharge_us == 1667
    # Currents are integers in µA with sum 0. No electrode returns more charge than it carries.
    assert planned.recharge_ua.tolist() == [-118, 71, 47, 0]
    assert net_charge_pc(planned).tolist() == [3294, -1643, -1651, 0]
    assert planned.period_us == 20_000
    paid = add_recharge(sequence(ONE), np.array([-200_000, 120_000, 80_000, 0]), rules(120))
    assert paid.recharge_ua is None, "earlier charge was ignored"


def test_one_that_does_not_fit_makes_the_period_longer():
    planned = add_recharge(sequence(ONE, period_us=1000), NOTHING, rules(120))
    # The duty limit of 0.8 sets the period; pulse and recharge alone would need less time.
    assert planned.period_us == 2334 == -(-(200 + 1667) * 5 // 4)
    whole = rules(60, timing=ScanTiming(whole_hz=True))
    # The duty limit needs (200 + 3334) / 0.8 = 4417.5 µs, so the largest integer rate is 226 Hz.
    assert add_recharge(sequence(ONE, period_us=1000), NOTHING, whole).period_us == 4425


def test_the_largest_is_two_microcoulombs_and_twenty_milliseconds():
    carried_pc = np.array([5_000_000, -5_000_000, 0, 0])
    for most_ua, width_us, current_ua in ((500, 4000, 500), (120, 16_666, 120), (40, 20_000, 40)):
        planned = add_recharge(sequence(ONE), carried_pc, rules(most_ua))
        assert (planned.recharge_us, planned.recharge_ua[0]) == (width_us, -current_ua)


def test_a_tenth_of_threshold_is_never_rounded_up():
    # In double precision, 1.2 is stored as slightly less; in single precision, as slightly more.
    assert recharge_most_ua(np.array([1.2, 0.4, 5.0])).tolist() == [119, 40, 500]
    assert recharge_most_ua(np.array([1.2, 0.4], np.float32)).tolist() == [120, 40]
    profile = load_profile("electric-mouse")
    found = RechargeRules.of(profile, ScanTiming())
    assert found.most_ua.tolist() == [120] * 64
    assert found.total_ua == 10_000
