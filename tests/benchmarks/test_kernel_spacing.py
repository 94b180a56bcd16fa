"""Activation between the places that a kernel is designed on.

``pytest tests/benchmarks/test_kernel_spacing.py --benchmark-only -n0 -s`` prints the largest effect
on other classes, and on the own class beyond a pitch, at places that lie closer over that at those
designed on: drives every .05 mm, and the activating function of the shipped kernels every .1 mm.
"""

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.kernels import driving_problem
from smarttouch.kernels.design_problem import Problem
from smarttouch.kernels.weighted_design import design_kernel

SITES = (6, 27, 55)
FINEST_MM = 0.05


@pytest.mark.parametrize("spacing_mm", [0.2, 0.1])
@pytest.mark.parametrize("mode", Afferent)
def test_what_lies_between(benchmark, quick, profile, monkeypatch, mode, spacing_mm):
    if quick and (mode, spacing_mm) != (Afferent.SAI, 0.2):
        pytest.skip("SAI at .2 mm only")

    def problem(apart_mm):
        monkeypatch.setattr(driving_problem, "_SPACING_MM", apart_mm)
        return driving_problem.DrivingProblem(profile, mode)

    coarse = problem(spacing_mm)
    kernels = {site: design_kernel(coarse, site) for site in SITES[: 1 if quick else None]}
    del coarse
    fine = benchmark.pedantic(problem, args=(0.1 if quick else FINEST_MM,), rounds=1)
    for site, kernel in kernels.items():
        found = fine.judge(kernel.weights, site)
        off, spill = (
            100 * (getattr(found, name) / getattr(kernel, name) - 1)
            for name in ("off_target", "spill")
        )
        print(
            f"\n{mode.name} {spacing_mm} mm, site {site}: off-target {off:+.1f}, spill {spill:+.1f}"
        )


@pytest.mark.parametrize("mode", Afferent)
def test_what_lies_between_for_kernels_that_ship(benchmark, quick, profile, bank, mode):
    if quick and mode is not Afferent.PC:
        pytest.skip("PC only")
    skin = profile.skin.model_copy(update={"node_spacing_mm": 0.25 if quick else 0.1})
    closer = profile.model_copy(update={"skin": skin})
    coarse = Problem(profile, mode)
    fine = benchmark.pedantic(Problem, args=(closer, mode), rounds=1)
    found, designed = (
        np.array(
            [
                (judged.off_target, judged.spill)
                for site, kernel in enumerate(np.asarray(bank.kernels(mode), np.float64))
                for judged in (problem.judge(kernel, site),)
            ]
        )
        for problem in (fine, coarse)
    )
    off, spill = np.median(100 * (found / designed - 1), axis=0)
    worst = found.max(axis=0)
    print(
        f"\n{mode.name}: off-target {off:+.1f} (worst {worst[0]:.3f}), "
        f"spill {spill:+.1f} (worst {worst[1]:.3f})"
    )
