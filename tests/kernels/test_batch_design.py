"""Many sites at once: mirrored, shared out, kept and taken up again."""

import json

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.batch_design import design_sites
from smarttouch.kernels.design_problem import Problem
from smarttouch.kernels.switched_design import design_three_state
from smarttouch.kernels.weighted_design import design_kernel
from smarttouch.profile import load_profile


@pytest.fixture(scope="module")
def problem():
    return Problem(load_profile("smarttouch-4x4"), Afferent.SAI)


@pytest.mark.parametrize("afferent", list(Afferent))
def test_symmetry_gives_what_solving_each_site_gives(changed, afferent):
    """RA alone may also be turned by a quarter, where there and back are not the same."""
    coarse = changed(load_profile("smarttouch-4x4"), {"skin.node_spacing_mm": 0.25})
    problem = Problem(coarse, afferent)
    assert problem.representative(15)[0] == 0
    for site, (kernel, _) in enumerate(design_sites(problem, design_kernel)):
        direct = design_kernel(problem, site)
        assert kernel.off_target == pytest.approx(direct.off_target, abs=1e-8)
        strongest = np.abs(direct.weights).max()
        assert kernel.weights == pytest.approx(direct.weights, abs=1e-4 * strongest)
        assert problem.target[site] @ kernel.weights == pytest.approx(1)


def test_measured_impedances_hold_at_every_site(changed):
    """A kernel mirrored onto electrodes of other impedance would not be what flows."""
    impedance = [1.0, 3.0, 0.5, 2.0, 1.0, 0.7]
    keys = {"array.rows": 2, "array.columns": 3, "output.impedance_kohm": impedance}
    keys["skin.node_spacing_mm"] = 0.5
    profile = changed(load_profile("smarttouch-4x4"), keys)
    for kernel, _ in design_sites(Problem(profile, Afferent.RA), design_three_state):
        for pole in (kernel.weights > 0, kernel.weights < 0):
            share = kernel.weights[pole] / profile.admittance[pole]
            assert share == pytest.approx(share[0])


def test_chosen_sites_only(problem):
    designed = []

    def design(problem, site):
        designed.append(site)
        return design_kernel(problem, site)

    chosen = design_sites(problem, design, [5, 10, 6])
    assert len(chosen) == 3
    assert set(designed) == {problem.representative(site)[0] for site in (5, 10, 6)}


@pytest.mark.parametrize("junk", ["{", "[]", json.dumps({"weights": [1.0]})])
def test_a_broken_part_is_designed_again(problem, tmp_path, junk):
    (tmp_path / "SAI-0.json").write_text(junk)
    ((kernel, _),) = design_sites(problem, design_kernel, [0], keep=tmp_path)
    assert kernel.weights == pytest.approx(design_kernel(problem, 0).weights)
    assert json.loads((tmp_path / "SAI-0.json").read_text())["worst_other_class"] == "RA"
