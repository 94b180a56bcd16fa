"""The paper's numbers to four digits, and kernels that do not depend on the solver."""

import numpy as np
import pytest

from smarttouch.errors import DesignError
from smarttouch.modes.design import Problem, design_all, design_kernel
from smarttouch.primary import Primary
from smarttouch.profile import load_profile


@pytest.fixture(scope="module")
def line():
    return load_profile("line-7")


def finer(profile, spacing):
    skin = profile.skin.model_copy(update={"node_spacing_mm": spacing})
    return profile.model_copy(update={"skin": skin})


@pytest.mark.parametrize(
    ("primary", "spacing", "worst", "weights"),
    [
        (Primary.SAI, 1.0, 0.3025, [-0.191, -0.164, -0.145, 1]),
        (Primary.SAI, 0.25, 0.3025, [-0.191, -0.164, -0.145, 1]),
        (Primary.RA, 1.0, 0.1072, [0.168, 0.123, 0.209, -1]),
        (Primary.RA, 0.25, 0.1173, [0.183, 0.139, 0.179, -1]),
    ],
)
def test_figure_8(line, primary, spacing, worst, weights):
    kernel = design_kernel(Problem(finer(line, spacing), primary), 3, spill=None)
    assert kernel.worst_other == pytest.approx(worst, abs=5e-5)
    assert kernel.weights == pytest.approx(weights + weights[-2::-1], abs=6e-4)
    assert abs(kernel.weights.sum()) < 1e-9


def test_pc_cannot_be_selected_and_is_symmetric(line):
    problem = Problem(line, Primary.PC)
    kernel = design_kernel(problem, 3, spill=None)
    assert kernel.worst_other == pytest.approx(3.04, abs=5e-3)
    assert kernel.weights == pytest.approx(kernel.weights[::-1], abs=1e-9)
    scaled = kernel.weights / (problem.target[3] @ kernel.weights)
    own = problem.own_beyond_a_pitch(3)
    assert (own @ scaled).max() <= 1 + 1e-6, "Eq. 11: the target's node is the one that fires"


def test_confined_kernels_do_not_spill(profile):
    problem = Problem(profile, Primary.RA)
    free, confined = (design_kernel(problem, 27, spill) for spill in (None, 0.2))
    assert free.own_spill > 0.5
    assert confined.own_spill <= 0.2 + 1e-6
    assert confined.worst_other <= 1.02 * free.worst_other
    assert np.abs(confined.weights).sum() < np.abs(free.weights).sum()


def test_no_row_is_broken_that_was_not_in_the_first_guess(profile):
    """Row generation must be checked on all rows: compare with one solve over all."""
    from scipy.optimize import linprog

    small = profile.model_copy(
        update={"array": profile.array.model_copy(update={"rows": 3, "columns": 3})}
    )
    small = type(profile).model_validate(small.model_dump())
    problem = Problem(small, Primary.SAI)
    target, far = problem.target[4], problem.own_beyond_a_pitch(4)
    scale = np.abs(target).max()
    rows = np.vstack([problem.other, far]) / scale
    is_other = np.r_[np.ones(len(problem.other)), np.zeros(len(far))]
    whole = linprog(
        np.r_[np.zeros(9), 1],
        np.column_stack([rows, -is_other]),
        np.where(is_other, 0, 0.2),
        np.column_stack([np.vstack([target / scale, np.ones(9)]), [0, 0]]),
        [1, 0],
        bounds=[(None, None)] * 10,
    )
    assert design_kernel(problem, 4).worst_other == pytest.approx(whole.x[-1], abs=1e-6)


def test_symmetry_gives_what_solving_each_site_gives():
    problem = Problem(load_profile("smarttouch-4x4"), Primary.RA)
    kernels = design_all(problem)
    assert problem.representative(15)[0] == 0
    direct = design_kernel(problem, 15)
    assert kernels[15].worst_other == pytest.approx(direct.worst_other, abs=1e-8)
    assert kernels[15].weights == pytest.approx(direct.weights, abs=1e-4)


def test_distinct_sites(profile):
    ra = Problem(profile, Primary.RA)
    assert len({ra.representative(site)[0] for site in range(64)}) == 10
    sai = Problem(profile, Primary.SAI)
    assert len({sai.representative(site)[0] for site in range(64)}) == 16


@pytest.mark.parametrize("site", [-1, 7, 1000])
def test_site_out_of_range(line, site):
    with pytest.raises(DesignError, match=f"site {site} is out of range.*0 to 6"):
        design_kernel(Problem(line, Primary.RA), site)
