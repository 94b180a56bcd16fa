"""The joint optimum of a slot: that of the whole programme, and no operator is better."""

import numpy as np
import pytest
from scipy.optimize import linprog

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.kernels.design_problem import Problem
from smarttouch.kernels.frame_fields import FrameBounds
from smarttouch.kernels.frame_judges import FrameJudge
from smarttouch.kernels.frame_operator import FrameOperator
from smarttouch.profile import load_profile

from ..raising import raises
from ..reference.joint_programme import joint_programme
from .test_frame_operator import scattered


@pytest.fixture(scope="module")
def small(profile, changed):
    return changed(profile, {"array.rows": 4, "array.columns": 4, "skin.node_spacing_mm": 1.0})


def whole(problem, judge, level, bounds, total_ma):
    """Minimize t over (w, magnitudes, t), all rows at once."""
    active, rows, count = np.flatnonzero(level), problem.rows[0], problem.electrodes
    smallest = judge.wish_af[active].min() * (1 - bounds.uneven)
    far = np.logical_and.reduce([problem.beyond_a_pitch(site) for site in active])
    others, own = rows.other / smallest, rows.own[far] / smallest
    aims = problem.target[active] / (level * judge.wish_af)[active, None]
    eye, zero = np.eye(count), np.zeros

    def padded(left, middle=None, right=0.0):
        middle = zero((len(left), count)) if middle is None else middle
        return np.c_[left, middle, np.full(len(left), right)]

    upper = [
        padded(others, right=-1.0), padded(own), padded(aims), padded(-aims),
        padded(eye, -eye), padded(-eye, -eye), padded(zero((1, count)), np.full((1, count), 0.5)),
    ]  # fmt: skip
    bound = [
        zero(len(others)), np.full(len(own), bounds.spill), np.full(len(aims), 1 + bounds.uneven),
        np.full(len(aims), bounds.uneven - 1), zero(2 * count), [total_ma],
    ]  # fmt: skip
    answer = linprog(
        np.r_[zero(2 * count), 1],
        np.concatenate(upper),
        np.concatenate(bound),
        np.r_[np.ones(count), zero(count + 1)][None],
        [0],
        bounds=[(-each, each) for each in judge.full_ma] + [(0, None)] * (count + 1),
    )
    return answer.fun if answer.status == 0 else np.inf


@pytest.mark.parametrize("afferent", [Afferent.RA, Afferent.SAI])
@pytest.mark.parametrize(("seed", "points", "total_ma"), [(0, 3, 9.0), (1, 2, 20.0), (2, 5, 20.0)])
def test_linprog_agrees(small, afferent, seed, points, total_ma):
    wish = np.full(16, 2.0 if afferent is Afferent.RA else 0.6)
    judge, bounds = FrameJudge(small, afferent, wish), FrameBounds()
    level = scattered(seed, points, 16)
    optimum = whole(Problem(small, afferent), judge, level, bounds, total_ma)
    mine = joint_programme(judge, level, bounds, total_ma)
    assert mine.optimum == pytest.approx(optimum, rel=2e-3)
    assert mine.figures.off_target <= optimum * 1.002
    assert mine.figures.spill <= bounds.spill * 1.002
    assert mine.figures.total_ma <= total_ma + 1e-6
    assert (
        mine.figures.strongest / mine.figures.weakest
        <= (1 + bounds.uneven) / (1 - bounds.uneven) + 1e-6
    )
    assert (np.abs(mine.current) <= judge.full_ma + 1e-6).all()
    assert mine.current.sum() == pytest.approx(0, abs=1e-6)
    free, _ = FrameOperator(judge).bounded(level, bounds, total_ma)
    assert judge.judge(free, level).off_target >= mine.optimum * 0.998


def test_every_limit_binds_where_it_should(small):
    judge, bounds = FrameJudge(small, Afferent.RA, np.full(16, 2.0)), FrameBounds()
    problem, level = Problem(small, Afferent.RA), scattered(3, 3, 16)
    free = joint_programme(judge, level, bounds)
    total_ma = 0.985 * free.figures.total_ma
    less = joint_programme(judge, level, bounds, total_ma)
    assert less.optimum > free.optimum * 1.001
    assert less.figures.total_ma <= total_ma + 1e-6
    assert less.optimum == pytest.approx(whole(problem, judge, level, bounds, total_ma), rel=2e-3)
    # A faint point beside strong ones would like to be stronger.
    level = np.zeros(16)
    level[5:7] = 1.0, 0.05
    faint = joint_programme(judge, level, bounds, 20.0)
    assert faint.figures.strongest == pytest.approx(1.05, abs=1e-4)
    assert faint.optimum == pytest.approx(whole(problem, judge, level, bounds, 20.0), rel=2e-3)


def test_the_impossible_is_refused(profile):
    judge = FrameJudge(load_profile("smarttouch-4x4"), Afferent.RA, np.full(16, 2.0))
    with raises(DesignError, about="slot"):
        joint_programme(judge, np.ones(16), FrameBounds(), 1.0)
