"""The rows of a problem, its symmetries, and how kernels are judged."""

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.kernels.design_problem import Problem
from smarttouch.physiology.activating_function import af_matrix, everywhere
from smarttouch.profile import load_profile

from ..support.checks import assert_close, raises
from ..support.full import sample

# Axons looked at in fewer places: symmetries, names and sums are the same.
SPACING = "skin.node_spacing_mm"


@pytest.fixture(scope="module")
def coarse(profile, changed):
    return changed(profile, {SPACING: 0.5})


def test_distinct_sites(coarse):
    ra, sai = Problem(coarse, Afferent.RA), Problem(coarse, Afferent.SAI)
    assert len({ra.representative(site)[0] for site in range(64)}) == 10
    assert len({sai.representative(site)[0] for site in range(64)}) == 16


@pytest.mark.parametrize("name", ["electric-mouse", "kajimoto-61", "line-7"])
@pytest.mark.parametrize("afferent", sample(Afferent))
def test_symmetries_leave_the_targets_and_the_rows_alone(changed, name, afferent):
    problem = Problem(changed(load_profile(name), {SPACING: 0.25}), afferent)
    assert np.array_equal(problem.symmetries[0], np.arange(problem.electrodes))
    for move in problem.symmetries:
        moved = problem.target[np.ix_(move, move)]
        assert_close(moved, problem.target)
        rows = problem.other
        before, after = (np.sort(each.max(axis=1)) for each in (rows, rows[:, move]))
        assert_close(after, before)


@pytest.mark.parametrize("keys", [
    {"output.impedance_kohm": [2.0] + [1.0] * 15},
    {"limits.electrode_ma": [2.4] * 15 + [2.5]},
    {"limits.total_ma": 5.0, "perception.threshold_ma": [1.2] * 4 + [1.1] + [1.2] * 11},
], ids=lambda keys: next(iter(keys)))  # fmt: skip
def test_an_electrode_of_its_own_kind_has_no_mirror_image(changed, keys):
    profile = changed(load_profile("smarttouch-4x4"), {SPACING: 0.5})
    assert len(Problem(profile, Afferent.RA).symmetries) == 8
    mine = changed(profile, keys)
    for move in Problem(mine, Afferent.RA).symmetries:
        assert np.array_equal(mine.admittance[move], mine.admittance)
        assert np.array_equal(mine.threshold_ma[move], mine.threshold_ma)
    assert len(Problem(mine, Afferent.RA).symmetries) < 8


FREE = {"layout": "free", "positions_mm": [[0, 0], [2, 0], [1, 1.7], [3.1, 2.4]]}
SQUARE = {"layout": "free", "positions_mm": [[0, 0], [2, 0], [0, 2], [2, 2]], "shape": "rectangle"}


@pytest.mark.parametrize(("name", "keys", "count"), [
    ("electric-mouse", {"array": FREE}, 1),
    ("electric-mouse", {"array": SQUARE | {"size_mm": [0.5, 1.5]}}, 4),
    ("electric-mouse", {"array": SQUARE | {"size_mm": [1.0, 1.0]}}, 8),
    # The diagonal through it is left.
    ("electric-mouse", {"output.masked": [27]}, 2),
    # Thresholds alone do not change kernels.
    ("smarttouch-4x4", {"perception.threshold_ma": [1.2] * 15 + [1.1]}, 8),
], ids=["free", "upright", "square", "masked", "thresholds"])  # fmt: skip
def test_how_many_symmetries_there_are(changed, name, keys, count):
    mine = changed(load_profile(name), keys | {SPACING: 0.5})
    assert len(Problem(mine, Afferent.RA).symmetries) == count


def test_judging_gives_the_effects_of_weights(coarse):
    problem = Problem(coarse, Afferent.SAI)
    weights = np.zeros(64)
    weights[27], weights[0] = 1.0, -1.0
    kernel = problem.judge(weights, 27, kind="three-state")
    assert problem.target[27] @ kernel.weights == pytest.approx(1)
    af = {
        each: (af_matrix(coarse, everywhere(coarse, each)) @ kernel.weights).max()
        for each in Afferent
    }
    assert kernel.off_target == pytest.approx(max(af[Afferent.RA], af[Afferent.PC]))
    assert af[kernel.off_target_class] == pytest.approx(kernel.off_target)
    assert kernel.peak_normalized[27] == 1
    named = ("SAI", "27", "electric-mouse")
    with raises(DesignError, value=named, electrode=27):
        problem.judge(-weights, 27)


def test_no_last_bit_chooses_between_classes_pressed_alike(coarse):
    problem = Problem(coarse, Afferent.PC)
    weights = np.zeros(64)
    weights[27], weights[0] = 1.0, -1.0
    ra, sai = (
        np.flatnonzero(problem.other_class == each)[0] for each in (Afferent.RA, Afferent.SAI)
    )
    rows = problem.other
    rows[sai] = 10 * rows[(rows @ weights).argmax()]
    rows[ra] = rows[sai] * (1 - 1e-12)
    assert problem.judge(weights, 27).off_target_class is Afferent.RA
    rows[ra] = rows[sai] * (1 - 1e-3)
    assert problem.judge(weights, 27).off_target_class is Afferent.SAI
