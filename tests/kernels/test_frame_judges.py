"""Figures of finished currents: those that all rows give."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.kernels.design_problem import Problem
from smarttouch.kernels.frame_fields import FrameBounds
from smarttouch.kernels.frame_judges import FrameJudge, full_wish
from smarttouch.profile import load_profile

from ..raising import raises
from ..whole import WHOLE


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
    # Rough currents, so that every figure counts.
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
    # What the quick judge may miss of either figure: below 2 %.
    assert figures.off_target == pytest.approx((problem.other @ current).max() / smallest, rel=0.02)
    far = np.logical_and.reduce([problem.beyond_a_pitch(site) for site in active])
    spill = max((problem.own[far] @ current).max(initial=0) / smallest, 0)
    assert figures.spill == pytest.approx(spill, rel=0.02, abs=0.002)
    assert np.array_equal(judge.far(active), far)


@pytest.mark.parametrize("afferent", [Afferent.RA, Afferent.SAI])
@pytest.mark.parametrize("shallow", [Afferent.SAI, Afferent.PC])
def test_every_class_counts(profile, changed, afferent, shallow):
    """Whichever lies highest answers most."""
    if afferent is shallow:
        shallow = Afferent.RA
    depth = {f"skin.{shallow.name.lower()}_depth_mm": 0.45}
    mine = changed(profile, depth | {"skin.node_spacing_mm": 0.25})
    problem, judge = Problem(mine, afferent), FrameJudge(mine, afferent, np.ones(64))
    level = np.zeros(64)
    level[[9, 27, 50]] = 1.0
    current = np.linalg.solve(problem.target, level)
    reached = problem.other @ current
    assert problem.other_class[reached.argmax()] == shallow
    expected = reached.max() / (problem.target[level > 0] @ current).min()
    assert judge.judge(current[None], level[None])[0].off_target == pytest.approx(
        expected, rel=0.02
    )


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


@pytest.mark.parametrize(("name", "value"), [("other", 0.0), ("spill", -1.0), ("uneven", 1.0)])
def test_bounds_that_are_none_are_refused(name, value):
    with raises(DesignError, value=value, allowed=(0, 1)):
        FrameBounds(**{name: value})
