"""Weighted kernels against an independent optimum and the figures of the paper."""

import contextlib

import numpy as np
import pytest
from scipy.optimize import linprog

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.kernels import linear_program
from smarttouch.kernels.design_problem import Problem
from smarttouch.kernels.weighted_design import design_any_node, design_kernel
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
    assert (problem.axon(3) @ kernel.weights).max() == pytest.approx(1, abs=1e-6), "Eq. 11"


def test_pc_cannot_be_selected_and_is_symmetric(line):
    problem = Problem(line, Afferent.PC)
    kernel = design_kernel(problem, 3, given_up=0)
    assert kernel.off_target == pytest.approx(3.04, abs=5e-4)
    assert kernel.weights == pytest.approx(kernel.weights[::-1], abs=1e-9)
    assert kernel.off_target_class is Afferent.RA, "SAI is pressed alike: the first is named"
    assert (problem.axon(3) @ kernel.weights).max() == pytest.approx(1, abs=1e-6), "Eq. 11"


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
    """PC within 10 mA has equal kernels on either side of its site: the inner one is taken."""
    problem = Problem(changed(profile, {SPACING: 0.5}), Afferent.PC)
    usual = design_kernel(problem, 27).weights
    for options in sample(METHODS):
        other = design_kernel(problem, 27, options=options).weights
        assert other == pytest.approx(usual, abs=1e-6 * np.abs(usual).max()), options


@pytest.mark.parametrize("afferent", list(Afferent))
def test_row_generation_misses_no_row(three_by_three, changed, whole_programme, afferent):
    problem = Problem(changed(three_by_three, {SPACING: 0.25}), afferent)
    for site in sample((0, 1, 4), 3):
        kernel = design_kernel(problem, site, given_up=0)
        best = max(kernel.off_target, kernel.spill if kernel.spill > 0.2001 else 0)
        assert best == pytest.approx(whole_programme(problem, site), rel=1e-6)


def test_two_nerves_are_easier_than_three(line):
    """Eq. 10 against Eq. 16."""
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
    """Each node of the axon under the array is tried; RA alone is best under the electrode."""
    problem = Problem(changed(line, {SPACING: 1.0}), afferent)
    found = design_any_node(problem, 3)
    assert abs(problem.axon_mm(3)[found.node, 0]) == pytest.approx(aside_mm)
    exact = design_kernel(problem, 3, node=found.node, given_up=0)
    assert exact.off_target == pytest.approx(least, abs=5e-5)
    fired = problem.axon(3) @ found.weights
    assert fired[found.node] == pytest.approx(1)
    assert fired.max() <= 1 + 1e-6
    # No other node would do better.
    for node in range(len(fired)):
        with contextlib.suppress(DesignError):
            other = design_kernel(problem, 3, node=node, given_up=0)
            assert max(other.off_target, other.spill) >= exact.off_target - 1e-6


@pytest.mark.parametrize("afferent", [Afferent.RA, Afferent.SAI])
def test_both_optima_at_a_tenth_of_a_millimeter_by_code_of_their_own(three_by_three, afferent):
    array, skin = three_by_three.electrodes, three_by_three.skin
    place, radius = array.position_mm, array.size_mm[0] / 2
    angles = np.radians(skin.sai_angles_deg)
    flat = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))])
    of = {
        Afferent.RA: (skin.ra_depth_mm, np.array([[0.0, 0.0, 1.0]])),
        Afferent.SAI: (skin.sai_depth_mm, flat),
        Afferent.PC: (skin.pc_depth_mm, flat),
    }
    everywhere = lattice(place, array.pitch_mm, 0.1)

    def rows(where, depth, directions):
        return np.concatenate([activating(where, depth, d, place, radius) for d in directions])

    depth, directions = of[afferent]
    far = np.linalg.norm(everywhere - place[4], axis=1) > array.pitch_mm + 1e-9
    target = activating(place[4:5], depth, directions[0], place, radius)[0]
    others = np.concatenate(
        [rows(everywhere, *each) for k, each in of.items() if k is not afferent]
    )
    own = rows(everywhere[far], depth, directions)
    if afferent is Afferent.RA:
        along = [
            activating(place[4:5], depth + 0.1 * k, directions[0], place, radius) for k in range(41)
        ]
        axon = np.concatenate(along)
    else:
        on_it = np.abs(everywhere[:, 1] - place[4, 1]) < 1e-9
        axon = activating(everywhere[on_it], depth, directions[0], place, radius)
    best, spill = optima(target, others, own, axon)
    problem = Problem(three_by_three, afferent)
    assert design_kernel(problem, 4, given_up=0).off_target == pytest.approx(best, rel=1e-3)
    kernel = design_kernel(problem, 4)
    assert kernel.off_target == pytest.approx(1.03 * best, rel=1e-3)
    assert kernel.spill == pytest.approx(spill, abs=1e-3)


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


def test_total_current_is_limited(profile, changed, whole_programme):
    # With no limit this corner would take 6.8 mA.
    few = {"limits.total_ma": 5.0, "array.rows": 5, "array.columns": 5, SPACING: 0.25}
    limited = Problem(changed(profile, few), Afferent.RA)
    kernel = design_kernel(limited, 0, given_up=0)
    source_ma = np.abs(kernel.weights).sum() / 2 / abs(kernel.weights[0]) * 2.4
    assert 4.9 < source_ma <= 5.0
    assert kernel.off_target == pytest.approx(whole_programme(limited, 0), rel=1e-6)


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
    """Written apart: the same programme with that electrode's column taken out of the rows."""
    from scipy.optimize import linprog

    problem = Problem(changed(line, {"output.masked": [2]}), afferent)
    kernel = design_kernel(problem, 3, spill=None)
    left = [0, 1, 3, 4, 5, 6]
    scale = np.abs(problem.target[3]).max()
    others, target = problem.other[:, left] / scale, problem.target[3, left] / scale
    axon = problem.axon(3)[1:, left] / scale
    answer = linprog(
        np.r_[np.zeros(6), 1],
        np.r_[np.c_[others, -np.ones(len(others))], np.c_[axon, np.zeros(len(axon))]],
        np.r_[np.zeros(len(others)), np.ones(len(axon))],
        np.c_[[target, np.ones(6)], [0, 0]],
        [1, 0],
        bounds=(None, None),
    )
    assert kernel.weights[2] == 0
    assert abs(kernel.weights.sum()) < 1e-12
    assert kernel.off_target == pytest.approx(answer.fun, rel=1e-6)
    assert design_any_node(problem, 3).weights[2] == 0


SPILL, GIVEN_UP = 0.2, 0.03
_STEP_MM = 1e-3
_SIGMA = 0.43


def potential(away_mm, depth_mm, radius_mm):
    """Return the potential of 1 mA, V, at distances (N, E) from the axes of cathodic discs."""
    near = np.hypot(away_mm - radius_mm, depth_mm)
    far = np.hypot(away_mm + radius_mm, depth_mm)
    return -np.arcsin(2 * radius_mm / (near + far)) / (2 * np.pi * _SIGMA * radius_mm)


def activating(places_mm, depth_mm, direction, electrodes_mm, radius_mm):
    """Return the AF of places (N, 2) and one direction (3,), (N, E) V/mm² per mA."""

    def at(step):
        there = places_mm + step * np.asarray(direction[:2])
        away = np.linalg.norm(there[:, None] - electrodes_mm, axis=2)
        return potential(away, depth_mm + step * direction[2], radius_mm)

    return (at(_STEP_MM) - 2 * at(0.0) + at(-_STEP_MM)) / _STEP_MM**2


def lattice(electrodes_mm, pitch_mm, spacing_mm):
    """Return places up to a pitch beyond the outer electrodes, (N, 2) mm."""
    reach = np.abs(electrodes_mm).max(axis=0) + pitch_mm
    steps = [int(np.floor(2 * each / spacing_mm + 1e-9)) for each in reach]
    axes = [(np.arange(n + 1) - n / 2) * spacing_mm for n in steps]
    x, y = np.meshgrid(*axes)
    return np.column_stack([x.ravel(), y.ravel()])


def optima(target, others, own, axon):
    """Return the least worst other, and the least spill within 3 % of it, over the target's.

    Rows (…, E) are of the target's node, all other classes, the own one far away, and the target's
    axon.
    """
    count, scale = len(target), np.abs(target).max()
    others, own, axon, aim = (each / scale for each in (others, own, axon, target))

    def least(of_t, of_bound, bounds):
        rows = np.vstack([np.c_[of_t, -np.ones(len(of_t))]] + [
            np.c_[each, np.zeros(len(each))] for each in of_bound
        ])  # fmt: skip
        upper = np.concatenate([np.zeros(len(of_t)), *bounds])
        # Rows that alone decide are few: begin with some, add what is broken.
        kept = np.zeros(len(rows), bool)
        kept[np.unique(np.r_[rows.argmax(axis=0), rows.argmin(axis=0)])] = True
        while True:
            answer = linprog(
                np.r_[np.zeros(count), 1], rows[kept], upper[kept],
                np.vstack([np.r_[aim, 0], np.r_[np.ones(count), 0]]), [1, 0],
                bounds=[(-1e3, 1e3)] * count + [(0, None)],
            )  # fmt: skip
            excess = rows @ answer.x - upper
            if excess.max() < 1e-8:
                return answer.fun
            kept[np.argsort(excess)[-100:][np.sort(excess)[-100:] > 1e-8]] = True

    best = least(others, [own, axon], [np.full(len(own), SPILL), np.ones(len(axon))])
    most = best * (1 + GIVEN_UP)
    return best, least(own, [others, axon], [np.full(len(others), most), np.ones(len(axon))])
