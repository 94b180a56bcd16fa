"""How long kernels take to design, beside one linprog for each distinct site on the same rows."""

import time

import numpy as np
import pytest

from smarttouch.modes.batch import design_sites
from smarttouch.modes.design import design_kernel
from smarttouch.modes.problem import Problem
from smarttouch.primary import Primary
from smarttouch.profile import load_profile


@pytest.fixture
def square(changed):
    """Return a maker of electric mice of other sizes, without a limit on total current."""

    def make(side):
        keys = {"array.rows": side, "array.columns": side, "limits.total_ma": None}
        return changed(load_profile("electric-mouse"), keys)

    return make


def designed(profile, sites=None):
    """Build the rows of every mode and design its sites; return kernels and seconds."""
    start = time.perf_counter()
    kernels = {
        primary: [
            kernel for kernel, _ in design_sites(Problem(profile, primary), design_kernel, sites)
        ]
        for primary in Primary
    }
    return kernels, time.perf_counter() - start


def distinct(problem):
    return sorted({problem.representative(site)[0] for site in range(problem.electrodes)})


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("limited", [False, True], ids=["free", "within 10 mA"])
def test_whole_bank_against_linprog(benchmark, square, whole_programme, capsys, limited):
    profile = load_profile("electric-mouse") if limited else square(8)
    designed(square(2))
    (kernels, ours), theirs, sites, apart = designed(profile), 0.0, 0, 0.0
    for primary in Primary:
        start = time.perf_counter()
        problem = Problem(profile, primary)
        optima = {site: whole_programme(problem, site) for site in distinct(problem)}
        theirs += time.perf_counter() - start
        for site, optimum in optima.items():
            kernel = kernels[primary][site]
            mine = max(kernel.worst_other, kernel.own_spill if kernel.own_spill > 0.2001 else 0)
            apart = max(apart, abs(mine - optimum))
        sites += len(optima)
    again = min(designed(profile)[1] for _ in range(3))
    name = "electric-mouse within 10 mA" if limited else "electric-mouse"
    with capsys.disabled():
        print(
            f"\n{name}, {sites} distinct sites: ours {ours:.2f} s (again {again:.2f} s), linprog "
            f"{theirs:.1f} s, ratio {theirs / ours:.0f}; optima differ by {apart:.1e} at most"
        )
    assert apart < 1e-6
    benchmark.extra_info["linprog over ours"] = round(theirs / ours, 1)
    benchmark.pedantic(lambda: None, rounds=1)


@pytest.mark.timeout(1800)
def test_growth(benchmark, square, capsys):
    designed(square(2))
    for side in (4, 6, 8, 12, 16):
        profile = square(side)
        _, seconds = designed(profile)
        count = sum(len(distinct(Problem(profile, primary))) for primary in Primary)
        with capsys.disabled():
            print(f"\n{side} x {side}: {count} distinct sites in {seconds:.2f} s", end="")
    benchmark.pedantic(lambda: None, rounds=1)


@pytest.mark.timeout(1800)
def test_chosen_sites_of_a_large_array(benchmark, square, capsys):
    profile = square(32)
    chosen = {"corner": 0, "middle": 16 * 32 + 16, "edge": 16}
    for primary in (Primary.RA, Primary.SAI):
        start = time.perf_counter()
        problem = Problem(profile, primary)
        rows = time.perf_counter() - start
        for name, site in chosen.items():
            start = time.perf_counter()
            kernel = design_kernel(problem, site)
            with capsys.disabled():
                print(
                    f"\n32 x 32, {primary.name} at the {name}: "
                    f"{time.perf_counter() - start:.1f} s after {rows:.1f} s for "
                    f"{len(problem.rows[0].other)} rows; worst other {kernel.worst_other:.4f}, "
                    f"spill {kernel.own_spill:.3f}",
                    end="",
                )
            assert np.abs(kernel.weights.sum()) < 1e-9
    benchmark.pedantic(lambda: None, rounds=1)
