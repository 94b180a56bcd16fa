"""Kernels designed on driving functions: right by the cable model at sites and fibers of others."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.design_problem import Problem
from smarttouch.kernels.driving_problem import DrivingProblem, fiber_points
from smarttouch.kernels.weighted_design import design_kernel
from smarttouch.physiology.activating_function import potential_mv, targets
from smarttouch.profile import load_profile

from .by_cable import judge_by_cable


@pytest.fixture(scope="module", params=[Afferent.RA, Afferent.SAI])
def problem(request):
    return DrivingProblem(load_profile("smarttouch-4x4"), request.param)


@pytest.fixture(scope="module")
def designed(problem):
    """A kernel of the problem, and what the cable model says of it."""
    kernel = design_kernel(problem, 5)
    return kernel, judge_by_cable(problem, kernel.weights, 5)


def test_rows_are_drives_of_straight_fibers(problem):
    """The target's row, made again from the potential along one fiber."""
    aim, site = targets(problem.profile, problem.afferent), 5
    driving = problem.driving(aim)
    first = -30 if aim.ending is None else 0
    along = np.arange(first, 40) * driving.internode_mm
    points = fiber_points(aim.position_mm[[site]], aim.depth_mm, aim.direction[0], along)
    every = driving.drive(potential_mv(problem.profile, points))[0]
    off = np.abs(every - problem.target[site]).max(axis=1)
    assert off.min() < 1e-9
    assert off.argmin() == (29 if aim.ending is None else off[:6].argmin())


def test_counts_of_rows_classes_and_places(problem):
    (rows,) = problem.rows
    assert len(rows.other) == len(problem.other_class)
    assert sum(high * wide * count for (high, wide), count in problem.grids) == len(rows.other)
    assert len(problem.beyond_a_pitch(0)) == len(rows.own)
    assert set(problem.other_class) == {*Afferent} - {problem.afferent}


def test_places_lie_closer_than_in_the_profile(problem):
    assert problem.profile.skin.node_spacing_mm == 0.1


def test_a_kernel_agrees_with_the_cable(problem, designed):
    kernel, found = designed
    assert problem.target[5] @ kernel.weights == pytest.approx(1)
    assert kernel.weights.sum() == pytest.approx(0, abs=1e-9)
    assert (problem.axon(5) @ kernel.weights).max() < 1 + 1e-6
    assert found.target == pytest.approx(1, abs=0.03)
    assert found.off_target == pytest.approx(kernel.off_target, rel=0.1)


def test_it_is_more_selective_than_one_designed_on_the_activating_function(problem, designed):
    old = design_kernel(Problem(load_profile("smarttouch-4x4"), problem.afferent), 5)
    assert designed[1].off_target < judge_by_cable(problem, old.weights, 5).off_target


def test_electrodes_anywhere_have_the_rows_of_a_grid_that_they_make_up(problem):
    """An array that is no grid shares no displacements: each row is computed by itself."""
    grid = problem.profile
    places = np.vstack([grid.electrodes.position_mm, [[0.123, 9.4567], [-0.123, -9.4567]]])
    free = {"layout": "free", "positions_mm": places.tolist(), "size_mm": (1.0, 0.0)}
    anywhere = type(grid).model_validate(grid.model_dump() | {"array": free})
    one = targets(grid, problem.afferent)
    aside = replace(one, position_mm=one.position_mm + np.array([0.3, -0.7]))
    other = copy(problem)
    other.profile = anywhere
    assert other._matrix(aside, grid.skin)[:, :-2] == pytest.approx(
        problem._matrix(aside, grid.skin), abs=1e-9
    )
