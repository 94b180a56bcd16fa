"""Weighted kernels agree with an independent optimum and with the values of the paper."""

import contextlib

import numpy as np
import pytest
from scipy.optimize import linprog

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.kernels import linear_program
from smarttouch.kernels.design_problem import Problem, limits_ma
from smarttouch.kernels.minmax_design import design_any_node, design_kernel
from smarttouch.profile import load_profile

from ..support.checks import raises
from ..support.full import sample

SPACING = "skin.node_spacing_mm"


@pytest.fixture(scope="module")
def line():
    return load_profile("line-7")


@pytest.fixture(scope="module")
def three_by_three(changed):
    profile = load_profile("electric-mouse")
    few = {"array.rows": 3, "array.columns": 3, "limits.total_ma": None, "frames.share": False}
    return changed(profile, few)


@pytest.mark.parametrize("spill", [None, 0.2])
@pytest.mark.parametrize(("afferent", "spacing", "worst", "weights"), [
    (Afferent.SAI, 1.0, 0.3025, [-0.191, -0.164, -0.145, 1]),
    (Afferent.SAI, 0.25, 0.3025, [-0.191, -0.164, -0.145, 1]),
    (Afferent.RA, 1.0, 0.1072, [0.168, 0.123, 0.209, -1]),
    (Afferent.RA, 0.25, 0.1173, [0.183, 0.139, 0.179, -1]),
])  # fmt: skip
def test_figure_8(line, changed, afferent, spacing, worst, weights, spill):
    problem = Problem(changed(line, {SPACING: spacing}), afferent)
    kernel = design_kernel(problem, 3, spill, given_up=0)
    assert kernel.off_target == pytest.approx(worst, abs=5e-5)
    assert kernel.peak_normalized == pytest.approx(weights + weights[-2::-1], abs=6e-4)
    assert abs(kernel.weights.sum()) < 1e-9
    assert problem.target[3] @ kernel.weights == pytest.approx(1, abs=1e-9)
    assert (problem.axon(3) @ kernel.weights).max() == pytest.approx(1, abs=1e-6)  # paper, Eq. 11


def test_pc_cannot_be_selected_and_is_symmetric(line):
    problem = Problem(line, Afferent.PC)
    kernel = design_kernel(problem, 3, given_up=0)
    assert kernel.off_target == pytest.approx(3.04, abs=5e-4)
    assert kernel.weights == pytest.approx(kernel.weights[::-1], abs=1e-9)
    assert kernel.off_target_class is Afferent.RA, "off-target is equal for RA and SAI: expected RA"
    assert (problem.axon(3) @ kernel.weights).max() == pytest.approx(1, abs=1e-6)  # paper, Eq. 11


METHODS = [
    {"solver": "simplex", "simplex_strategy": 1},
    {"solver": "simplex", "simplex_strategy": 4},
    {"solver": "ipm"},
    {"presolve": "on"},
    {"random_seed": 7, "simplex_dual_edge_weight_strategy": 2},
]


@pytest.mark.parametrize("options", sample(METHODS), ids=str)
@pytest.mark.parametrize("afferent", list(Afferent))
def test_no_method_of_the_solver_gives_another_kernel(line, afferent, options):
    problem = Problem(line, afferent)
    usual, other = design_kernel(problem, 3), design_kernel(problem, 3, options=options)
    assert other.off_target == pytest.approx(usual.off_target, abs=1e-8)
    assert other.weights == pytest.approx(usual.weights, rel=1e-6)


def test_a_simplex_that_runs_in_circles_gives_way(line, monkeypatch):
    problem = Problem(line, Afferent.RA)
    usual = design_kernel(problem, 3)
    monkeypatch.setattr(linear_program, "_PATIENCE", 0)
    assert design_kernel(problem, 3).weights == pytest.approx(usual.weights, rel=1e-6)


def test_a_kernel_that_could_be_mirrored_is_not(profile, changed):
    """Each solver returns the same PC kernel, although its mirror image is equally good."""
    problem = Problem(changed(profile, {SPACING: 0.5}), Afferent.PC)
    usual = design_kernel(problem, 27).weights
    for options in sample(METHODS):
        other = design_kernel(problem, 27, options=options).weights
        assert other == pytest.approx(usual, abs=1e-6 * np.abs(usual).max()), options


@pytest.mark.parametrize("afferent", list(Afferent))
def test_row_generation_misses_no_row(three_by_three, changed, afferent):
    problem = Problem(changed(three_by_three, {SPACING: 0.25}), afferent)
    for site in sample((0, 1, 4), 3):
        kernel = design_kernel(problem, site, given_up=0)
        best = max(kernel.off_target, kernel.spill if kernel.spill > 0.2001 else 0)
        assert best == pytest.approx(optimum(problem, site), rel=1e-6)


def test_two_nerves_are_easier_than_three(line):
    """Off-target is smaller if only one other class counts (Eq. 10) than if two do (Eq. 16)."""
    three = design_kernel(Problem(line, Afferent.SAI), 3, given_up=0)
    two = [
        design_kernel(Problem(line, Afferent.SAI, [other]), 3, given_up=0)
        for other in (Afferent.RA, Afferent.PC)
    ]
    assert all(each.off_target <= three.off_target + 1e-9 for each in two)
    assert min(each.off_target for each in two) < 0.9 * three.off_target
    assert [each.off_target_class for each in two] == [Afferent.RA, Afferent.PC]


@pytest.mark.parametrize(("afferent", "least", "aside_mm"), [
    (Afferent.RA, 0.1072, 0), (Afferent.SAI, 0.2424, 3), (Afferent.PC, 2.4548, 2),
])  # fmt: skip
def test_brute_force_over_the_node(line, changed, afferent, least, aside_mm):
    """All nodes of the axon are tried; only for RA the node under the electrode is best."""
    problem = Problem(changed(line, {SPACING: 1.0}), afferent)
    found = design_any_node(problem, 3)
    assert abs(problem.axon_mm(3)[found.node, 0]) == pytest.approx(aside_mm)
    exact = design_kernel(problem, 3, node=found.node, given_up=0)
    assert exact.off_target == pytest.approx(least, abs=5e-5)
    fired = problem.axon(3) @ found.weights
    assert fired[found.node] == pytest.approx(1)
    assert fired.max() <= 1 + 1e-6
    # No other node has a better kernel.
    for node in range(len(fired)):
        with contextlib.suppress(DesignError):
            other = design_kernel(problem, 3, node=node, given_up=0)
            assert max(other.off_target, other.spill) >= exact.off_target - 1e-6


@pytest.mark.parametrize("afferent", [Afferent.RA, Afferent.SAI])
def test_spill_is_the_least_that_three_percent_buy(three_by_three, changed, afferent):
    problem = Problem(changed(three_by_three, {SPACING: 0.25}), afferent)
    kernel = design_kernel(problem, 4)
    assert kernel.off_target == pytest.approx(1.03 * optimum(problem, 4), rel=1e-3)
    assert kernel.spill == pytest.approx(optimum(problem, 4, given_up=0.03), abs=1e-3)


@pytest.mark.long
def test_confined_kernels_do_not_spill(profile, changed):
    problem = Problem(
        changed(profile, {"limits.total_ma": None, "frames.share": False}), Afferent.RA
    )
    free, confined = (design_kernel(problem, 27, spill) for spill in (None, 0.2))
    assert free.spill > 0.5
    assert confined.spill <= 0.2 + 1e-6
    assert confined.spill < 0.1
    assert confined.off_target <= 1.05 * free.off_target
    assert np.abs(confined.weights).sum() < np.abs(free.weights).sum()


def test_total_current_is_limited(profile, changed):
    # Without the limit, the kernel of this corner would need 6.8 mA.
    few = {"limits.total_ma": 5.0, "array.rows": 5, "array.columns": 5, SPACING: 0.25}
    limited = Problem(changed(profile, few), Afferent.RA)
    kernel = design_kernel(limited, 0, given_up=0)
    source_ma = np.abs(kernel.weights).sum() / 2 / abs(kernel.weights[0]) * 2.4
    assert 4.9 < source_ma <= 5.0
    assert kernel.off_target == pytest.approx(optimum(limited, 0), rel=1e-6)


def test_currents_of_single_electrodes_are_limited(line, changed):
    free = design_kernel(Problem(line, Afferent.RA), 3).peak_normalized
    lowered = [1.0] * 7
    lowered[2] = 0.1
    threshold = [0.4, 0.4, 0.03, 0.4, 0.4, 0.4, 0.4]
    mine = changed(line, {"limits.electrode_ma": lowered, "perception.threshold_ma": threshold})
    kernel = design_kernel(Problem(mine, Afferent.RA), 3)
    carried = kernel.weights / abs(kernel.weights[3]) * 1.0
    assert abs(free[2]) > 0.1
    assert abs(carried[2]) <= 0.1
    assert kernel.off_target > 0.1072


def test_limits_that_no_kernel_keeps(line, changed):
    lowered = [0.004] * 3 + [1.0] + [0.004] * 3
    threshold = [0.001] * 3 + [0.4] + [0.001] * 3
    mine = changed(line, {"limits.electrode_ma": lowered, "perception.threshold_ma": threshold})
    with raises(DesignError, names="limits", electrode=3) as caught:
        design_kernel(Problem(mine, Afferent.RA), 3)
    assert "limits.electrode_ma" in str(caught.value)


@pytest.mark.parametrize("afferent", [Afferent.RA, Afferent.SAI])
def test_around_a_masked_electrode_it_is_the_best_of_what_is_left(line, changed, afferent):
    problem = Problem(changed(line, {"output.masked": [2]}), afferent)
    kernel = design_kernel(problem, 3, spill=None)
    assert kernel.weights[2] == 0
    assert abs(kernel.weights.sum()) < 1e-12
    assert kernel.off_target == pytest.approx(optimum(problem, 3, None), rel=1e-6)
    assert design_any_node(problem, 3).weights[2] == 0


def optimum(problem, site, spill=0.2, given_up=None):
    """Return the smallest off-target of a site, from a linear program with all rows of the problem.

    The linear program shares no code with the package. Its variables are the maximum t, weights w
    and, if the total is limited, magnitudes of w. If the spill bound cannot be kept, t is the
    larger of off-target and spill. If ``given_up`` is not None, return the smallest spill instead;
    off-target may then exceed its smallest value by the share ``given_up``."""
    total, _ = limits_ma(problem.profile)
    count = problem.electrodes
    magnitudes = count if np.isfinite(total) else 0
    target = problem.target[site]
    scale = np.abs(target).max()
    own = problem.own[problem.beyond_a_pitch(site)][: None if spill is not None else 0]
    sums = np.c_[np.stack([target / scale, np.ones(count)]), np.zeros((2, 1 + magnitudes))]
    free = [(None, None) if each in problem.profile.driven else (0, 0) for each in range(count)]

    def minimum(other_most=None, own_most=None):
        """Minimize the larger of off-target and spill, or only the one that has no bound."""
        upper, bound = [], []
        for rows, most in (
            (problem.other, other_most),
            (own, own_most),
            (problem.axon(site)[1:], 1),
        ):
            by_t = np.full(len(rows), -1.0 if most is None else 0.0)
            upper.append(np.c_[rows / scale, by_t, np.zeros((len(rows), magnitudes))])
            bound.append(np.full(len(rows), most or 0.0))
        if magnitudes:
            eye, zero = np.eye(count), np.zeros((count, 1))
            allowed = 2 * total / problem.full_ma(site) * np.sign(target)
            upper += [np.c_[eye, zero, -eye], np.c_[-eye, zero, -eye]]
            upper.append(np.r_[-allowed * eye[site], 0, np.ones(count)][None])
            bound.append(np.zeros(2 * count + 1))
        answer = linprog(
            np.r_[np.zeros(count), 1, np.zeros(magnitudes)],
            np.concatenate(upper), np.concatenate(bound), sums, [1, 0],
            bounds=[*free, (None, None), *[(0, None)] * magnitudes],
        )  # fmt: skip
        return answer.fun if answer.status == 0 else np.inf

    best = minimum(own_most=spill or 0.0)
    if given_up is not None:
        return minimum(other_most=best * (1 + given_up))
    return min(best, minimum()) if spill is not None and best > spill else best
