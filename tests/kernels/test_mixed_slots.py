"""Points of RA and SAI in one slot: judged by all rows, and each the other's return."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.kernels.design_problem import Problem
from smarttouch.kernels.frame_fields import FrameBounds
from smarttouch.kernels.frame_judges import FrameJudge, SlotJudge, full_wish, judge_all
from smarttouch.kernels.frame_operator import FrameOperator, keeps
from smarttouch.kernels.slot_plans import likely_slots, plan_slots

from ..raising import raises
from ..whole import WHOLE, sample

BOTH = (Afferent.RA, Afferent.SAI)


@pytest.fixture(scope="module")
def coarse(profile, changed):
    return changed(profile, {"skin.node_spacing_mm": 0.25})


@pytest.fixture(scope="module")
def judges(coarse, bank):
    return [
        FrameJudge(coarse, each, full_wish(coarse, bank.kernels(each), bank.receptor[each]))
        for each in BOTH
    ]


@pytest.fixture(scope="module")
def operator(judges):
    return FrameOperator(SlotJudge(judges))


@pytest.fixture(scope="module")
def problems(coarse):
    return [Problem(coarse, each) for each in (*BOTH, Afferent.PC)]


def wished(seed, ra, sai):
    """Return levels of random points, no two of them at one site."""
    rng = np.random.default_rng(seed)
    site = rng.choice(64, ra + sai, replace=False)
    level = np.zeros(128)
    level[site + 64 * (np.arange(ra + sai) >= ra)] = rng.uniform(0.5, 1, ra + sai)
    return level


@settings(max_examples=25 if WHOLE else 8, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 9), st.integers(0, 9))
def test_figures_are_those_of_all_rows(operator, problems, seed, ra, sai):
    level = wished(seed, ra, sai)
    judge = operator.judge
    if not level.any():
        with raises(DesignError, about="slot"):
            judge.judge(np.zeros(64), level)
        return
    rough = 0.05 * np.random.default_rng(seed).normal(size=64)
    current = operator.currents(level) + rough - rough.mean()
    figures = judge.judge(current, level)
    smallest, far = [], []
    for problem, mine in zip(problems, level.reshape(2, 64), strict=False):
        active = np.flatnonzero(mine)
        reached = problem.target[active] @ current / mine[active]
        smallest.append(reached.min(initial=np.inf))
        away = np.ones(len(problem.rows[0].own), bool)
        for site in active:
            away &= problem.beyond_a_pitch(site)
        far.append(max((problem.rows[0].own[away] @ current).max(), 0))
    if min(smallest) <= 0:
        assert figures.off_target == figures.spill == np.inf
        return
    deep = (problems[2].rows[0].own @ current).max()
    ratios = [
        max(far[1 - index], deep) / smallest[index]
        for index in (0, 1)
        if np.isfinite(smallest[index])
    ]
    assert figures.off_target == pytest.approx(max(ratios), rel=0.02, abs=0.002)
    spill = max(each / least for each, least in zip(far, smallest, strict=True))
    assert figures.spill == pytest.approx(spill, rel=0.02, abs=0.002)


@pytest.mark.parametrize("index", [0, 1])
def test_where_one_class_is_active_it_is_judged_as_alone(judges, operator, index):
    level = wished(3, *((5, 0), (0, 5))[index])
    current = operator.currents(level) + 0.01 * np.sin(np.arange(64))
    alone = judges[index].judge(current, level.reshape(2, 64)[index])
    assert operator.judge.judge(current, level) == alone


@settings(max_examples=20 if WHOLE else 8, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 14), st.integers(0, 14))
def test_every_point_once_and_every_slot_within_its_bounds(profile, bank, operator, seed, ra, sai):
    level, bounds = wished(seed, ra, sai), FrameBounds()
    alone = np.concatenate([bank.kernels(each) * profile.full_ma[:, None] for each in BOTH])
    slots = plan_slots(operator, level, bounds, None, alone)
    points = np.concatenate([np.zeros(0, int), *(slot.sites for slot in slots)])
    assert sorted(points) == np.flatnonzero(level).tolist()
    for slot in slots:
        wanted = np.where(np.isin(np.arange(128), slot.sites), level, 0)
        assert slot.kept
        assert slot.figures == operator.judge.judge(slot.current, wanted)
        assert keeps(operator.judge, slot.figures, bounds, slot.current, 10.0)
    levels = np.array([np.where(np.isin(np.arange(128), each.sites), level, 0) for each in slots])
    currents = np.array([each.current for each in slots])
    for quick, slot in zip(judge_all(operator.judge, currents, levels), slots, strict=True):
        assert quick.off_target == pytest.approx(slot.figures.off_target, rel=1e-4)
        assert quick.spill == pytest.approx(slot.figures.spill, rel=1e-4, abs=1e-6)


def test_one_class_carries_back_what_the_other_needs(judges, operator):
    """Two RA points and two SAI points: less than the half of what they need by themselves."""
    bounds, level = FrameBounds(), np.zeros(128)
    level[[9, 54, 64 + 14, 64 + 49]] = 1
    current, figures = operator.bounded(level, bounds)
    assert keeps(operator.judge, figures, bounds, current, 10.0)
    apart = [
        FrameOperator(judge).bounded(mine, bounds)[1].total_ma
        for judge, mine in zip(judges, level.reshape(2, 64), strict=True)
    ]
    assert figures.total_ma < 0.65 * sum(apart)
    # An anode over RA, a cathode over SAI (Fig. 10).
    assert (current[[9, 54]] < -1).all()
    assert (current[[14, 49]] > 1).all()


def test_mixed_frames_take_fewer_slots(judges, operator):
    apart = [FrameOperator(judge) for judge in judges]
    mixed = separate = 0
    for seed in sample(range(8)):
        level = np.ceil(wished(seed, 16, 16))
        mixed += len(plan_slots(operator, level, FrameBounds()))
        separate += sum(
            len(plan_slots(one, mine, FrameBounds()))
            for one, mine in zip(apart, level.reshape(2, 64), strict=True)
        )
        assert likely_slots(operator, level, FrameBounds(), 10.0) <= 4
    # As many of each class in every slot: dealt without that, .71.
    assert mixed <= 0.66 * separate


def test_a_class_cannot_be_mixed_with_itself(judges):
    for judged in ([judges[0], judges[0]], []):
        with raises(DesignError, about="judges"):
            SlotJudge(judged)
