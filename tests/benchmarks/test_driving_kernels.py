"""Kernels on driving functions and on the activating function, judged by the cable.

``pytest tests/benchmarks/test_driving_kernels.py --benchmark-only -n0 -s`` prints medians, lowest
and highest of ten sites that no fit has seen, for each mode.
"""

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.driving_problem import DrivingProblem
from smarttouch.kernels.weighted_design import design_kernel

from ..fit_fibers import fiber_cases
from ..kernels.by_cable import judge_by_cable

HEADINGS = ("AF, by cable", "by programme", "by cable", "difference, %", "target, %")


@pytest.mark.parametrize("mode", [Afferent.RA, Afferent.SAI])
def test_kernels_by_the_cable(benchmark, quick, profile, bank, mode):
    held_out = fiber_cases.cases(profile, bank, ending=False, held_out=True)
    kernels = np.asarray(bank.kernels(mode), np.float64)
    seen = held_out.current_ma[(held_out.group == mode.name) & held_out.cathodic]
    sites = [
        site for site, kernel in enumerate(kernels) if (np.abs(seen - kernel) < 1e-9).all(1).any()
    ]
    assert len(sites) == 10
    if quick and mode is not Afferent.RA:
        pytest.skip("one site of RA only")
    problem = DrivingProblem(profile, mode)

    def judge(site):
        kernel = design_kernel(problem, site)
        old, new = (judge_by_cable(problem, each, site) for each in (kernels[site], kernel.weights))
        differs = 100 * abs(new.off_target / kernel.off_target - 1)
        return (
            old.off_target, kernel.off_target, new.off_target, differs, 100 * abs(new.target - 1)
        )  # fmt: skip

    found = benchmark.pedantic(
        lambda: np.array([judge(site) for site in sites[: 1 if quick else None]]), rounds=1
    )
    low, middle, high = np.quantile(found, (0, 0.5, 1), axis=0)
    for name, *three in zip(HEADINGS, middle, low, high, strict=True):
        print("\n{} {}: {:.2f} ({:.2f}–{:.2f})".format(mode.name, name, *three), end="")
