"""Time that kernels take to design, beside one linprog for each distinct site on the same rows."""

import time

import joblib
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.bank import design_bank, write_bank
from smarttouch.kernels.batch_design import design_sites
from smarttouch.kernels.design_problem import Problem
from smarttouch.kernels.weighted_design import GIVEN_UP, design_kernel
from smarttouch.profile import list_profiles, load_profile


@pytest.fixture
def square(changed):
    """Return a maker of electric mice of other sizes, without a limit on total current."""

    def make(side):
        keys = {"array.rows": side, "array.columns": side, "limits.total_ma": None}
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
def test_whole_bank_against_linprog(row, quick, square, whole_programme, changed, limited):
    profile = square(4 if quick else 8)
    if limited:
        profile = changed(profile, {"limits.total_ma": 10.0})
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
def test_shipped_profiles_by_spacing(row, quick, changed, tmp_path):
    for name in ["smarttouch-4x4"] if quick else list_profiles():
        for spacing_mm in (0.5, 0.2, 0.1):
            profile = changed(load_profile(name), {"skin.node_spacing_mm": spacing_mm})
            start, path = time.process_time(), tmp_path / f"{name}-{spacing_mm:g}.npz"
            with joblib.parallel_config("threading", n_jobs=1):
                bank = design_bank(profile)
            seconds = time.process_time() - start
            write_bank(path, profile, bank)
            row(
                "Banks by the distance of places that kernels are designed at",
                {
                    "profile": name,
                    "mm": f"{spacing_mm:g}",
                    "processor time, s": f"{seconds:.1f}",
                    "file, kB": f"{path.stat().st_size / 1000:.1f}",
                },
            )
            assert path.stat().st_size < 200_000
