"""Time that kernels take to design, beside one linprog for each distinct site on the same rows."""

import time

import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.bank import design_bank
from smarttouch.kernels.batch_design import design_sites
from smarttouch.kernels.design_problem import Problem
from smarttouch.kernels.weighted_design import GIVEN_UP, design_kernel
from smarttouch.profile import load_profile


@pytest.fixture
def square(changed):
    """Return a maker of electric mice of other sizes."""

    def make(side, total_ma=None):
        keys = {"array.rows": side, "array.columns": side, "limits.total_ma": total_ma}
        # As many rows as linprog can take, and memory for a thousand electrodes.
        keys["skin.node_spacing_mm"] = 0.5
        return changed(load_profile("electric-mouse"), keys)

    return make


def designed(profile, sites=None):
    """Build the rows of every mode and design its sites; return kernels and seconds."""
    start = time.perf_counter()
    kernels = {
        afferent: [
            kernel for kernel, _ in design_sites(Problem(profile, afferent), design_kernel, sites)
        ]
        for afferent in Afferent
    }
    return kernels, time.perf_counter() - start


def distinct(problem):
    return sorted({problem.representative(site)[0] for site in range(problem.electrodes)})


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("limited", [False, True], ids=["free", "within 10 mA"])
def test_whole_bank_against_linprog(row, quick, square, whole_programme, limited):
    profile = square(4 if quick else 8, 10.0 if limited else None)
    designed(square(2))
    (kernels, ours), theirs, sites, apart = designed(profile), 0.0, 0, 0.0
    for afferent in Afferent:
        start = time.perf_counter()
        problem = Problem(profile, afferent)
        optima = {site: whole_programme(problem, site) for site in distinct(problem)}
        theirs += time.perf_counter() - start
        for site, optimum in optima.items():
            kernel = kernels[afferent][site]
            mine = max(kernel.off_target, kernel.spill if kernel.spill > 0.2001 else 0)
            apart = max(apart, abs(mine / (1 + GIVEN_UP) - optimum))
        sites += len(optima)
    again = min(designed(profile)[1] for _ in range(3))
    row(
        "All kernels of a bank, beside one linprog for each distinct site",
        {
            "array": f"{profile.array.rows} × {profile.array.columns}" + ", 10 mA" * limited,
            "distinct sites": sites,
            "ours (again), s": f"{ours:.2f} ({again:.2f})",
            "linprog, s": f"{theirs:.1f}",
            "ratio": f"{theirs / ours:.0f}",
            "optima differ by": f"{apart:.1e}",
        },
    )
    assert apart < 1e-6


@pytest.mark.timeout(0)
def test_arrays_by_size(row, quick, square):
    for side in (4,) if quick else (4, 8, 12, 16):
        start = time.perf_counter()
        bank = design_bank(square(side, 10.0))
        seconds = time.perf_counter() - start
        row("Design of a whole bank", {"array": f"{side} × {side}", "s": f"{seconds:.1f}"})
        assert 0 < bank.off_target[Afferent.RA].max() < 1
