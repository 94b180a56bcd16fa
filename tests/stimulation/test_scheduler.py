"""Slots are charge-balanced, ordered and within all limits; periods limit net charge per second."""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import ScheduleError
from smarttouch.base.tactile_image import TactileImage
from smarttouch.kernels.bank import design_bank, load_bank
from smarttouch.profile import list_profiles, load_profile
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanTiming
from smarttouch.stimulation.scheduler import NetPlan, ScanScheduler
from smarttouch.stimulation.sequence_limits import NET_PC
from smarttouch.stimulation.slots import perceived_at, spread_order

from ..support.checks import raises
from ..support.full import sample
from ..support.scans import open_level, prove_alone


def tactile(activation, time_ns=10**9, afferent=Afferent.RA):
    rows = np.zeros((3, len(activation)), np.float32)
    rows[afferent] = activation
    return TactileImage(rows, time_ns, 1.0)


@functools.cache
def shipped(name):
    """Return a shipped profile and its kernel bank."""
    profile = load_profile(name)
    return profile, load_bank(profile)


def started(profile, bank):
    gate = SafetyGate(SafetyLimits.of(profile))
    scan = ScanScheduler(profile, bank, (Afferent.RA,), 20.0)
    driven = profile.driven.tolist()
    silent = scan.schedule(tactile(np.zeros(len(profile.electrodes)), 0), 0.0)
    open_level(gate.check, silent, gate.limits, electrodes=(driven[0], driven[-1]))
    return gate


@pytest.mark.parametrize("name", sample(list_profiles()))
@given(data=st.data())
def test_every_sequence_of_every_profile_is_safe(name, data):
    profile, bank = shipped(name)
    afferent = data.draw(st.sampled_from(sorted(bank.weights)))
    level = st.floats(0, 1, width=32)
    count = len(profile.electrodes)
    seed = data.draw(st.integers(0, 2**32 - 1))
    density, intensity = data.draw(level), data.draw(level)
    rng = np.random.default_rng(seed)
    activation = rng.random(count, np.float32) * (rng.random(count) < density)
    scan = ScanScheduler(profile, bank, (afferent,), profile.pulse.rate_hz)
    sequence = scan.schedule(tactile(activation, afferent=afferent), intensity)
    started(profile, bank).check(sequence)
    assert not sequence.current_ua.sum(axis=1).any()
    felt = perceived_at(profile, afferent)
    places = sequence.site if felt is None else felt[sequence.site]
    assert set(places) <= set(np.flatnonzero(activation))


def test_full_activation_gets_the_comfortable_current_and_faint_the_threshold(profile, bank):
    """RA pulses are anodic at their site."""
    activation = np.zeros(64)
    activation[[9, 50]] = 1.0, 1e-6
    sequence = ScanScheduler(profile, bank, (Afferent.RA,), 50).schedule(tactile(activation), 1.0)
    found = dict(zip(sequence.site.tolist(), sequence.current_ua.tolist(), strict=True))
    for site, peak_ua in ((9, 2400), (50, 1200)):
        assert max(map(abs, found[site])) == pytest.approx(peak_ua, abs=32)
        assert found[site][site] == min(found[site]) < 0
    assert (sequence.state[np.arange(2), sequence.site] == -1).all()


def test_rate_is_kept_where_it_fits_and_lowered_where_not(profile, bank):
    scan = ScanScheduler(profile, bank, (Afferent.RA,), 100)
    few = np.zeros(64)
    few[:33] = 1
    assert scan.schedule(tactile(few), 1.0).rate_hz == pytest.approx(100)
    all_on = scan.schedule(tactile(np.ones(64)), 1.0)
    assert all_on.period_us == 64 * 300


def test_switched_boards_never_lose_an_electrode_to_rounding():
    profile = load_profile("kajimoto-61")
    scan = ScanScheduler(profile, load_bank(profile), (Afferent.RA,), 50)
    for intensity in (0.001, 0.01, 0.02, 0.05, 0.3, 1.0):
        state = scan.schedule(tactile(np.ones(61)), intensity).state
        assert np.all(state != 0)
    assert len(state) == 61


@pytest.mark.parametrize("rate", [0, -1, 1000, float("nan")])
def test_impossible_rates(profile, bank, rate):
    same = pytest.approx(rate, nan_ok=True)
    with raises(ScheduleError, value=same):
        ScanScheduler(profile, bank, (Afferent.RA,), rate)


@pytest.fixture(scope="module", params=["line-7", "kajimoto-61"])
def masked(request, changed):
    """Return a profile with masked electrodes 2 and 5, and its kernel bank."""
    keys = {"output.masked": [2, 5], "skin.node_spacing_mm": 0.5}
    profile = changed(load_profile(request.param), keys)
    return profile, design_bank(profile)


@given(data=st.data())
def test_a_masked_electrode_is_never_driven(masked, data):
    profile, bank = masked
    afferent = data.draw(st.sampled_from(sorted(bank.weights)))
    count = len(profile.electrodes)
    activation = np.array(data.draw(st.lists(st.floats(0, 1), min_size=count, max_size=count)))
    scan = ScanScheduler(profile, bank, (afferent,), 20)
    sequence = scan.schedule(tactile(activation, afferent=afferent), 1.0)
    started(*shipped(profile.name)).check(sequence)
    assert not np.isin(sequence.site, profile.output.masked).any()
    assert not sequence.current_ua[:, list(profile.output.masked)].any()
    felt = np.setdiff1d(np.flatnonzero(activation.astype(np.float32)), profile.output.masked)
    assert set(sequence.site) == set(felt)


def test_kernels_of_before_the_mask_are_refused(profile, bank, changed):
    mine = changed(profile, {"output.masked": [27]})
    with raises(ScheduleError, names="output.masked", value=(27,)):
        ScanScheduler(mine, bank, (Afferent.RA,), 50)


def test_the_board_s_clock_sets_the_period():
    profile = load_profile("etactilekit-32")
    timing = ScanTiming(slot_extra_us=10, every_electrode=True, whole_hz=True, load=0.9)
    few = tactile(np.r_[np.ones(3), np.zeros(29)])
    for asked_hz, got_hz in ((50, 50), (60, 60), (52.5, 52), (133, 133), (134, 133), (200, 133)):
        scan = ScanScheduler(profile, load_bank(profile), (Afferent.SAI,), asked_hz, timing)
        sequence = scan.schedule(tactile(few.activation[Afferent.RA], afferent=Afferent.SAI), 1.0)
        assert sequence.slots == 3
        assert sequence.period_us == math.ceil(1e6 / got_hz)


def test_a_board_in_index_order_gets_its_order():
    profile = load_profile("kajimoto-61")
    timing = ScanTiming(50, 150, slot_extra_us=8, scan_us=700, in_index_order=True, load=1 / 1.1)
    scan = ScanScheduler(profile, load_bank(profile), (Afferent.RA,), 100, timing)
    sequence = scan.schedule(tactile(np.ones(61)), 1.0)
    assert sequence.site.tolist() == list(range(61))
    assert sequence.period_us == pytest.approx((700 + 208 * 61) * 1.1, abs=1)
    few = scan.schedule(tactile(np.r_[np.zeros(40), np.ones(21)]), 1.0)
    assert few.period_us == 10_000


@given(st.integers(0, 1100))
def test_spread_order_is_a_permutation(count):
    assert sorted(spread_order(count)) == list(range(count))


@pytest.mark.parametrize("count", [9, 16, 25, 64, 144])
def test_successive_points_are_apart(count):
    steps = np.abs(np.diff(spread_order(count)))
    assert steps.min() >= count // 4


def natural_image():
    """Return an image of RA and SAI points with different activations, so that all slots differ."""
    rows = np.zeros((3, 64), np.float32)
    rows[Afferent.RA, ::3] = np.linspace(1, 0.3, 22)
    rows[Afferent.SAI, 1::5] = np.linspace(0.2, 0.9, len(rows[1, 1::5]))
    return TactileImage(rows, 10**9, 1.0)


def test_classes_that_are_due_together_follow_one_another(profile, bank):
    """The sequence has the slots of an RA sequence, then those of an SAI sequence, unchanged."""
    both = (Afferent.RA, Afferent.SAI)
    joined = ScanScheduler(profile, bank, both).schedule(natural_image(), 0.7)
    first, second = (
        ScanScheduler(profile, bank, (each,), 10.0).schedule(natural_image(), 0.7) for each in both
    )
    assert (first.slots, second.slots) == (22, 13)
    for name in ("site", "current_ua", "width_us", "discharge_us"):
        alone = np.concatenate([getattr(each, name) for each in (first, second)])
        assert getattr(joined, name).tolist() == alone.tolist(), name
    assert joined.proof is None
    prove_alone(profile, joined)


@given(
    intensity=st.floats(0, 1, width=32),
    seed=st.integers(0, 2**32 - 1),
    mode=st.sampled_from([each for each in Mode if each is not Mode.COLOR]),
    softness=st.floats(0, 1),
    pressure=st.floats(0, 1),
)
def test_every_sequence_of_every_mode_is_safe(
    profile, bank, intensity, seed, mode, softness, pressure
):
    activation = np.random.default_rng(seed).random(64, np.float32)
    activation[activation < 0.3] = 0
    scan = ScanScheduler(profile, bank, mode.afferents, softness=softness)
    gate = SafetyGate(SafetyLimits.of(profile))
    rows = np.stack([activation, activation, np.zeros(64, np.float32)])
    silent = scan.schedule(TactileImage(rows, 0, 1.0), 0.0)
    open_level(gate.check, silent, gate.limits)
    gate.check(scan.schedule(TactileImage(rows, 10**9, 1.0), intensity, pressure))


@pytest.mark.parametrize(("options", "attributes"), [
    ({"rate_hz": 50.0}, {"names": "rate_hz", "value": 50}),
    ({"timing": ScanTiming(whole_hz=True)}, {"names": "mode", "allowed": ("RA", "SAI")}),
    ({"timing": ScanTiming(in_index_order=True)}, {"names": "mode", "allowed": ("RA", "SAI")}),
])  # fmt: skip
def test_where_two_rates_are_not_possible(profile, bank, options, attributes):
    with raises(ScheduleError, **attributes):
        ScanScheduler(profile, bank, Mode.NATURAL.afferents, **options)


@pytest.mark.parametrize("keys", [
    {"perception.comfort_ma": (2.0,) * 8},
    {"limits.electrode_ma": (1.0,) * 8},
])  # fmt: skip
def test_a_comfort_that_is_just_the_limit_stays_within_it(changed, keys):
    """Rounding never raises the current of the strongest electrode above its limit."""
    line = changed(load_profile("line-8"), keys)
    bank = load_bank(line)
    for afferent in Afferent:
        scan = ScanScheduler(line, bank, (afferent,), 10.0)
        for level in np.linspace(0.5, 1, 30):
            prove_alone(line, scan.schedule(tactile(np.ones(8), 0, afferent), float(level)))


def test_rounding_of_a_thousand_small_currents_is_no_charge_above_the_limit(profile, bank, changed):
    """Rounding 2.6 µA to 3 µA at 923 electrodes would leave a remainder of 370 µA."""
    wide = changed(profile, {"array.rows": 32, "array.columns": 32})
    weights = np.zeros((1024, 1024))
    for site in range(100):
        weights[site, site] = 1
        weights[site, 101:] = -1 / 923
    scan = ScanScheduler(
        wide, replace(bank, weights={Afferent.SAI: weights}), (Afferent.SAI,), 10.0
    )
    ramp = tactile(np.r_[np.linspace(0.1, 1, 100), np.zeros(924)], 0, Afferent.SAI)
    for intensity in np.linspace(0.1, 1, 10):
        sequence = scan.schedule(ramp, float(intensity))
        prove_alone(wide, sequence)
        assert sequence.slots == 100
        assert np.abs(sequence.current_ua).max() <= 2500
    strongest = sequence.site.tolist().index(99)
    assert np.abs(sequence.current_ua[strongest] - 2400 * weights[99]).max() < 1.01


@given(st.integers(0, 2**32 - 1))
def test_no_second_has_more_than_its_net_charge(seed):
    rng, plan, sent, time_us = np.random.default_rng(seed), NetPlan(3), [], 0
    for _ in range(200):
        most_pc, period_us = rng.choice([2e4, 1e6, 9e6]), int(rng.choice([2000, 20_000, 200_000]))
        net_pc = np.rint(rng.uniform(-0.2, 1, 3) * most_pc)
        next_us = plan.next_period_us(net_pc, time_us, period_us, period_us // 2)
        if next_us is not None:
            sent.append((time_us + period_us // 2, net_pc))
        # Sum the net charges of the last pass, the last two passes and so on. Each sum is limited.
        kept = [net_pc for end_us, net_pc in reversed(sent) if end_us > time_us - 1_000_000]
        assert np.abs(np.cumsum(kept, axis=0)).max(initial=0) <= NET_PC
        time_us += math.ceil(next_us or period_us)


def planned(rate_hz, net_pc, wanted, seconds=6.0):
    """Return the start times and periods of passes, µs, and the number of omitted passes."""
    plan, time_us, period_us = NetPlan(1), 0.0, round(1e6 / rate_hz)
    each_pc = np.array([float(net_pc)])
    times, periods, left_out = [], [], 0
    while time_us < 1e6 * seconds:
        next_us = period_us
        if wanted(time_us):
            needed_us = plan.next_period_us(each_pc, time_us, period_us, 300)
            left_out += needed_us is None
            if needed_us is not None:
                next_us = math.ceil(needed_us)
                times.append(time_us)
                periods.append(next_us)
        time_us += next_us
    return np.array(times), np.array(periods), left_out


@pytest.mark.parametrize("rate_hz", [50, 100, 200])
@pytest.mark.parametrize("net_pc", [480_000, 1_200_000])
def test_pauses_are_short_and_no_longer_than_net_charge_requires(rate_hz, net_pc):
    times, periods, left_out = planned(rate_hz, net_pc, lambda _: True)
    assert left_out == 0
    # All passes are slowed evenly: no long pause follows a series of fast passes.
    assert periods.max() < 60_000
    steady = times[-1] - times[times > 3e6][0]
    allowed_us = max(1e6 / rate_hz, 1e6 * net_pc / NET_PC)
    assert allowed_us <= steady / (np.count_nonzero(times > 3e6) - 1) + 1e-6 <= 1.2 * allowed_us


@pytest.mark.parametrize(("net_pc", "wanted"), [
    (1_200_000, lambda time_us: int(time_us // 10_000) % 5 == 0),  # every fifth frame of 10 ms
    (480_000, lambda time_us: time_us % 1_000_000 < 400_000),  # 0.4 s of each second
])  # fmt: skip
def test_what_pauses_by_itself_keeps_its_rate(net_pc, wanted):
    _, periods, left_out = planned(100, net_pc, wanted)
    assert set(periods) == {10_000}
    assert left_out == 0
