"""Finished currents on other fingers: the fingers that robust kernels are judged on."""

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.design_problem import Problem

from ..reference.spread import Worst, spread_judges
from .test_frame_operator import scattered


@pytest.mark.parametrize("afferent", [Afferent.RA, Afferent.SAI])
def test_a_single_kernel_is_as_bad_as_on_the_worst_finger_of_its_problem(
    bank, make_operator, afferent
):
    judge = make_operator(afferent).judge
    judges, profile = spread_judges(judge), judge.profile
    current, level = bank.kernels(afferent)[27] * profile.full_ma[27], np.eye(64)[27]
    worst = Worst.of([each.judge(current, level) for each in judges])
    # The problem takes its weakest target and its worst node of any finger: never less.
    whole = Problem(profile, afferent, spread=True).judge(np.asarray(current, np.float64), 27)
    assert worst.off_target <= whole.off_target * 1.01
    assert worst.off_target > 0.75 * whole.off_target
    assert worst.off_target > judge.judge(current, level).off_target
    assert worst.weakest < 1 < worst.strongest


def test_no_spread_is_the_nominal_finger(make_operator):
    operator, level = make_operator(Afferent.RA), scattered(0, 6)
    current = operator.currents(level)
    (same,) = spread_judges(operator.judge, depth=False, angle=False)
    assert same.judge(current, level) == operator.judge.judge(current, level)
    figures = [
        Worst.of([judge.judge(current, level) for judge in judges])
        for judges in (spread_judges(operator.judge, part, angle=False) for part in (0.25, 1.0))
    ]
    assert figures[0].off_target < figures[1].off_target
    tilted = [judge.judge(current, level) for judge in spread_judges(operator.judge, depth=False)]
    assert len(tilted) == 5
    assert Worst.of(tilted).off_target > tilted[0].off_target
