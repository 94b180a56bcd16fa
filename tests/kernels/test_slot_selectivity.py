"""Selectivity of slots agrees with the design problem, and proofs hold for all subsets of sites."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.kernels.design_problem import Problem
from smarttouch.kernels.slot_selectivity import (
    Certainty,
    FrameBounds,
    FrameJudge,
    FrameOperator,
    SharedKernels,
    color_classes,
    full_wish,
    proved_sets,
)
from smarttouch.profile import load_profile
from smarttouch.stimulation.scan_sequence import (
    KernelLists,
    KernelTable,
    quantized,
    round_charge_balanced,
)

from ..support.checks import raises
from ..support.full import WHOLE, sample


@pytest.fixture(scope="module")
def make_operator(profile, bank, changed):
    """Return a function that makes the `FrameOperator` of a class, with nodes 0.5 mm apart."""
    made, profile = {}, changed(profile, {"skin.node_spacing_mm": 0.5})

    def make(afferent):
        if afferent not in made:
            wish = full_wish(profile, bank.kernels(afferent), bank.receptor[afferent])
            made[afferent] = FrameOperator(FrameJudge(profile, afferent, wish))
        return made[afferent]

    return make


@pytest.fixture(scope="module", params=[Afferent.RA, Afferent.SAI], ids=lambda each: each.name)
def judged(request, profile, changed, bank):
    afferent, coarse = request.param, changed(profile, {"skin.node_spacing_mm": 0.25})
    wish = full_wish(profile, bank.kernels(afferent), bank.receptor[afferent])
    return FrameJudge(coarse, afferent, wish), Problem(coarse, afferent)


@settings(max_examples=25 if WHOLE else 10, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 30))
def test_figures_are_those_of_all_rows(judged, seed, points):
    judge, problem = judged
    rng = np.random.default_rng(seed)
    level = np.zeros(64)
    active = rng.choice(64, points, replace=False)
    level[active] = rng.uniform(0.5, 1, points)
    # Add random errors to the currents, so that off-target and spill are not zero.
    current = np.linalg.solve(problem.target, level * judge.wish_af) + 0.1 * rng.normal(size=64)
    (figures,) = judge.judge(current[None], level[None])
    reached = problem.target[active] @ current
    smallest = (reached / level[active]).min()
    assert figures.total_ma == pytest.approx(np.abs(current).sum() / 2)
    assert figures.electrode_ma == pytest.approx(np.abs(current).max())
    ratio = reached / (level * judge.wish_af)[active]
    assert (figures.weakest, figures.strongest) == pytest.approx((ratio.min(), ratio.max()))
    if smallest <= 0:
        assert figures.off_target == figures.spill == np.inf
        return
    # Allow an error of 2 %: `FrameJudge` is fast, but not exact.
    assert figures.off_target == pytest.approx((problem.other @ current).max() / smallest, rel=0.02)
    far = np.logical_and.reduce([problem.beyond_a_pitch(site) for site in active])
    spill = max((problem.own[far] @ current).max(initial=0) / smallest, 0)
    assert figures.spill == pytest.approx(spill, rel=0.02, abs=0.002)
    assert np.array_equal(judge.far(active), far)


def test_a_single_kernel_has_its_bank_s_figures(judged, profile, bank):
    judge, _ = judged
    level = np.eye(64)[27]
    current = bank.kernels(judge.afferent)[27] * profile.full_ma[27]
    (figures,) = judge.judge(current[None], level[None])
    assert figures.weakest == figures.strongest == pytest.approx(1, abs=1e-3)
    assert figures.off_target == pytest.approx(bank.off_target[judge.afferent][27], rel=0.02)
    assert figures.spill == pytest.approx(bank.spill[judge.afferent][27], rel=0.02)


def test_limits_are_the_smallest_of_all(profile, changed):
    keys = {"output.masked": [3], "limits.electrode_ma": [2.5] + [5.0] * 63}
    keys["perception.comfort_ma"] = [2.4] * 63 + [2.0]
    judge = FrameJudge(changed(profile, keys), Afferent.RA, np.ones(64))
    assert judge.full_ma[[0, 3, 10, 63]] == pytest.approx([2.4, 0, 2.4, 2.0])


def test_what_cannot_be_judged_is_refused(profile):
    with raises(DesignError, value=3, allowed=64):
        FrameJudge(profile, Afferent.RA, np.ones(3))
    judge = FrameJudge(load_profile("smarttouch-4x4"), Afferent.RA, np.ones(16))
    with raises(DesignError):
        judge.judge(np.zeros((1, 16)), np.zeros((1, 16)))


def test_classes_are_all_driven_sites_once(profile, changed):
    mine = changed(profile, {"output.masked": [0, 9]})
    operator = FrameOperator(FrameJudge(mine, Afferent.RA, np.full(64, 2.2)))
    classes = color_classes(operator, 2)
    assert len(classes) == 4
    assert sorted(np.concatenate([each.sites for each in classes])) == mine.driven.tolist()
    wide = operator.judge.profile.electrodes.distance_mm
    for each in classes:
        apart = wide[np.ix_(each.sites, each.sites)] + 99 * np.eye(len(each.sites))
        assert apart.min() >= 2 * mine.electrodes.pitch_mm - 1e-9


def test_sets_are_as_large_as_can_be_proved(make_operator):
    bounds = FrameBounds()
    sets = proved_sets(make_operator(Afferent.RA).judge, bounds)
    assert [len(each.sites) for each in sets] == [16] * 4
    assert sorted(np.concatenate([each.sites for each in sets])) == list(range(64))
    # A bound of 0.15 instead of 0.3 gives more sets with fewer sites; a bound of 0.05 gives none.
    assert len(proved_sets(make_operator(Afferent.RA).judge, FrameBounds(other=0.15))) == 9
    assert proved_sets(make_operator(Afferent.RA).judge, FrameBounds(other=0.05)) == []
    assert proved_sets(make_operator(Afferent.SAI).judge, bounds) == []
    judge = sets[0].operator.judge
    for one in sets:
        assert one.off_target <= 0.3
        assert (0.96 * one.electrode_ma <= judge.full_ma).all()


@pytest.mark.long
def test_what_is_proved_holds_every_tenth_of_a_millimeter(make_operator, profile, bank):
    wish = full_wish(profile, bank.kernels(Afferent.RA), bank.receptor[Afferent.RA])
    fine = FrameOperator(FrameJudge(profile, Afferent.RA, wish))
    for one in sample(proved_sets(make_operator(Afferent.RA).judge, FrameBounds()), 4):
        # Kernels were made with nodes 0.5 mm apart. Check them with nodes 0.1 mm apart.
        closer = SharedKernels(fine, one.sites)
        closer.__dict__["kernels"] = one.kernels
        assert closer.off_target == pytest.approx(one.off_target, rel=0.005)
        assert closer.spill == pytest.approx(one.spill, rel=0.05)


def test_what_is_no_grid_or_large_has_no_sets(profile, changed):
    hexagon = changed(load_profile("kajimoto-61"), {"skin.node_spacing_mm": 0.5})
    wish = np.full(61, 2.0)
    assert proved_sets(FrameJudge(hexagon, Afferent.RA, wish), FrameBounds()) == []
    many = {"array.rows": 18, "array.columns": 18, "skin.node_spacing_mm": 1.0}
    wide = changed(profile, many)
    judge = FrameJudge(wide, Afferent.RA, np.full(324, 2.2))
    assert proved_sets(judge, FrameBounds()) == []


@given(
    st.sampled_from([Afferent.RA, Afferent.SAI]),
    st.integers(2, 4),
    st.floats(0.01, 1),
    st.floats(0.2, 1),
    st.integers(0, 2**32 - 1),
)
def test_no_subset_breaks_what_is_certain_after_rounding(
    make_operator, afferent, step, intensity, faintest, seed
):
    operator = make_operator(afferent)
    rng = np.random.default_rng(seed)
    one = rng.choice(color_classes(operator, step))
    most_ma = 0.96 * one.totals_ma.sum()
    certain = Certainty.of([one], 0.96, faintest, most_ma)
    on = rng.random(len(one.sites)) < rng.uniform(0.1, 1)
    on[rng.integers(len(on))] = True
    level = np.zeros(64)
    level[one.sites[on]] = rng.choice([faintest, 1, rng.uniform(faintest, 1)], on.sum())
    share = 0.96 * level[one.sites]
    exact_ua = 1000 * intensity * (share @ one.kernels)
    peak_ua = 1000 * np.abs(one.kernels).max(axis=1)
    # Besides the actual rounding errors of amplitudes, try the largest possible ones.
    amplitude = 4 * intensity * share * peak_ua
    amplitude += rng.choice([0, -0.4999, 0.4999]) * (share > 0)
    kernel = np.flatnonzero(share).astype(np.uint16)
    table = KernelTable(quantized(one.kernels), one.sites.astype(np.uint16), {}, {})
    first = np.array([0, len(kernel)])
    lists = KernelLists(table, first, kernel, np.rint(amplitude[kernel]).astype(np.uint16))
    for current_ua in (round_charge_balanced(exact_ua[None])[0], lists.current_ua[0]):
        (figures,) = operator.judge.judge(current_ua[None] / 1000, level[None])
        off_target, spill = certain.figures(intensity)[:, 0]
        assert figures.off_target <= off_target
        assert figures.spill <= spill
        assert 1000 * figures.total_ma <= np.abs(exact_ua).sum() / 2 + certain.total_ua


def test_from_the_least_intensity_on_bounds_are_kept(make_operator):
    bounds = FrameBounds(0.3, 0.3)
    sets = color_classes(make_operator(Afferent.RA), 2)
    certain = Certainty.of(sets, 0.96, 0.5, 10.0)
    least = certain.least(bounds)
    assert 0 < least < 1
    for intensity in (least * 1.0001, 0.5, 1.0):
        assert (certain.figures(intensity) <= 0.3).all()
    assert (certain.figures(least * 0.9) > 0.3).any()
    assert certain.least(FrameBounds(0.001, 0.3)) == np.inf
    assert np.isinf(certain.figures(0.0)).all()
