"""Currents of a slot from precomputed matrices, alone and within bounds."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.kernels.frame_fields import FrameBounds
from smarttouch.kernels.frame_judges import FrameJudge
from smarttouch.kernels.frame_operator import FrameOperator, Weights, keeps
from smarttouch.physiology.activating_function import af_matrix, everywhere
from smarttouch.profile import load_profile

from ..raising import raises
from ..whole import WHOLE

LETTER_T = "........ .#####.. ...#.... ...#.... ...#.... ...#.... ...#.... ...#...."


def drawn(picture):
    return np.array([each == "#" for each in picture.replace(" ", "")], np.float64)


def scattered(seed, points, sites=64):
    level = np.zeros(sites)
    level[np.random.default_rng(seed).choice(sites, points, replace=False)] = 1.0
    return level


@settings(max_examples=25 if WHOLE else 10, deadline=None)
@given(
    st.sampled_from([Afferent.RA, Afferent.SAI]), st.integers(0, 2**32 - 1), st.integers(1, 30)
)  # fmt: skip
def test_targets_get_their_wish_and_currents_sum_to_zero(make_operator, afferent, seed, points):
    operator = make_operator(afferent)
    level = scattered(seed, points) * np.random.default_rng(seed).uniform(0.5, 1, 64)
    current = operator.currents(level)
    active = level > 0
    reached = operator.judge.target[active] @ current
    assert reached == pytest.approx((level * operator.judge.wish_af)[active], rel=1e-3)
    assert current.sum() == pytest.approx(0, abs=1e-9)


def test_no_other_currents_with_the_same_targets_cause_less(make_operator):
    operator = FrameOperator(make_operator(Afferent.SAI).judge, Weights(1.0, 0.3, 0.2))
    judge, level = operator.judge, scattered(4, 6)
    current, active = operator.currents(level), np.flatnonzero(level)

    squares = []
    for afferent, factor in ((Afferent.RA, 1.0), (Afferent.PC, 1.0), (Afferent.SAI, 0.3)):
        rows = af_matrix(judge.profile, everywhere(judge.profile, afferent))
        squares.append(factor * 64 * rows.T @ rows / (rows**2).sum())
    squares = np.sum(squares, axis=0) + 0.2 * np.eye(64)

    def harm(each):
        return each @ squares @ each

    kept = np.vstack([judge.target[active], np.ones(64)])
    free = np.linalg.svd(kept)[2][len(kept) :]
    least = harm(current)
    for seed in range(5):
        step = np.random.default_rng(seed).normal(size=len(free)) @ free
        for size in (1e-2, -1e-2):
            assert harm(current + size * step) > least * (1 - 1e-6)


def test_a_letter_in_one_slot_is_as_selective_as_a_single_point_of_the_paper(make_operator):
    operator = make_operator(Afferent.RA)
    figures = operator.judge.judge(operator.currents(drawn(LETTER_T)), drawn(LETTER_T))
    assert figures.off_target < 0.25
    assert figures.spill < 0.10


@pytest.mark.parametrize("seed", range(4))
def test_bounds_hold_where_the_least_squares_break_them(make_operator, seed):
    operator, level = make_operator(Afferent.SAI), scattered(seed, 3)
    judge, bounds = operator.judge, FrameBounds()
    assert judge.judge(operator.currents(level), level).off_target > bounds.other
    current, figures = operator.bounded(level, bounds)
    assert figures == judge.judge(current, level)
    assert keeps(judge, figures, bounds, current, judge.profile.limits.total_ma)
    assert figures.off_target <= bounds.other
    assert figures.spill <= bounds.spill
    assert figures.weakest >= 1 - bounds.uneven
    assert figures.total_ma <= 10
    assert (np.abs(current) <= judge.full_ma).all()
    assert current.sum() == pytest.approx(0, abs=1e-9)


def test_what_cannot_be_kept_shows_in_its_figures(make_operator):
    operator, level = make_operator(Afferent.SAI), scattered(0, 30)
    current, figures = operator.bounded(level, FrameBounds(), 10.0)
    assert not keeps(operator.judge, figures, FrameBounds(), current, 10.0)
    assert figures.off_target > 0.3


def test_each_bound_counts(make_operator):
    judge = make_operator(Afferent.RA).judge
    current, level = np.zeros(64), scattered(0, 1)
    good = judge.judge(make_operator(Afferent.RA).currents(level), level)
    good = replace(good, off_target=0.1, spill=0.1, weakest=1.0, strongest=1.0, total_ma=5.0)
    assert keeps(judge, good, FrameBounds(), current, 10.0)
    for bad in (
        {"off_target": 0.31}, {"spill": 0.31}, {"weakest": 0.94}, {"strongest": 1.06},
        {"total_ma": 10.1},
    ):  # fmt: skip
        assert not keeps(judge, replace(good, **bad), FrameBounds(), current, 10.0)
    over = current + 2.5 * np.eye(64)[3]
    assert not keeps(judge, good, FrameBounds(), over, 10.0)


def test_masked_electrodes_carry_nothing(profile, changed):
    mine = changed(profile, {"output.masked": [0, 28]})
    operator = FrameOperator(FrameJudge(mine, Afferent.RA, np.full(64, 2.2)))
    level = np.zeros(64)
    level[[10, 27, 52]] = 1
    current, _ = operator.bounded(level, FrameBounds())
    assert (current[[0, 28]] == 0).all()
    assert np.abs(current[27]) > 1
    assert not keeps(
        operator.judge,
        operator.judge.judge(current, level),
        FrameBounds(),
        current + 1e-6 * np.eye(64)[28],
        None,
    )
    level[28] = 1
    with raises(DesignError, about="site", value=28, electrode=28):
        operator.currents(level)


def test_arrays_that_are_no_grid_have_operators(changed):
    keys = {"output": {"kind": "weighted"}, "skin.node_spacing_mm": 0.5}
    mine = changed(load_profile("kajimoto-61"), keys)
    operator = FrameOperator(FrameJudge(mine, Afferent.RA, np.full(61, 1.0)))
    level = scattered(1, 4, 61)
    reached = operator.judge.target[level > 0] @ operator.currents(level)
    assert reached == pytest.approx(np.ones(4), rel=1e-3)
