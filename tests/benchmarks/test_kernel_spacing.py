"""Activation between the places that a kernel is designed on.

``pytest tests/benchmarks/test_kernel_spacing.py --benchmark-only -n0 -s`` prints the largest effect
on other classes, and on the own class beyond a pitch, of the shipped kernels' activating function
at places .1 mm apart, over that at those designed on.
"""

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.design_problem import Problem


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
