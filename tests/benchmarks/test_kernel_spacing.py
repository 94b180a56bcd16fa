"""What lies between the places that a kernel on driving functions is designed on.

``pytest tests/benchmarks/test_kernel_spacing.py --benchmark-only -n0 -s`` prints the largest drive
of other classes, and of the own class beyond a pitch, at places .05 mm apart over that at those
designed on, in per cent.
"""

import pytest

from smarttouch.afferent import Afferent
from smarttouch.kernels import driving_problem
from smarttouch.kernels.design import design_kernel

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
