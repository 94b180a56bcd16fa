"""Many sites at once: mirrored, shared out, kept and taken up again, or confined to neighbors."""

import json

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.bank import design_bank, find_bank, problem_hash, write_bank
from smarttouch.kernels.batch_design import design_sites, tiles_of
from smarttouch.kernels.design_problem import Problem
from smarttouch.kernels.kernel_tables import kernels_designed
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


@pytest.fixture
def grid(changed):
    def make(side=5, neighbors=9, **keys):
        square = {"array.rows": side, "array.columns": side, "skin.node_spacing_mm": 0.5}
        mouse = load_profile("electric-mouse")
        return changed(mouse, {**square, "kernels.neighbors": neighbors, **keys})

    return make


@pytest.fixture
def of_cache(tmp_path, monkeypatch):
    monkeypatch.setattr("platformdirs.user_cache_path", lambda _: tmp_path)
    return tmp_path


def test_a_confined_bank_is_that_of_masked_arrays(grid, changed, of_cache):
    profile = grid(4)
    bank = design_bank(profile)
    whole = Problem(profile, Afferent.SAI)
    for site in (1, 10):
        weights = bank.weights[Afferent.SAI][site]
        driven = np.flatnonzero(weights)
        assert 2 <= len(driven) <= 9
        judged = whole.judge(weights, site)
        assert judged.off_target == pytest.approx(bank.off_target[Afferent.SAI][site])
        assert judged.spill == pytest.approx(bank.spill[Afferent.SAI][site])
        away_mm = profile.electrodes.distance_mm[site]
        others = np.flatnonzero(away_mm > away_mm[driven].max() + 1e-6).tolist()
        masked = changed(profile, {"output.masked": others})
        best = design_kernel(Problem(masked, Afferent.SAI), site)
        assert judged.off_target == pytest.approx(best.off_target, rel=1e-6)
    for weights in bank.weights.values():
        assert np.abs(weights.sum(axis=1)).max() < 1e-12
    # Kept and found again, and not for kernels of all electrodes.
    write_bank(of_cache / f"{problem_hash(profile)}.npz", profile, bank)
    assert find_bank(profile) is not None
    assert find_bank(changed(profile, {"kernels.neighbors": None})) is None


def test_one_site_is_designed_alone(grid):
    profile = grid(7, 21)
    (found,) = kernels_designed(profile, [Afferent.RA], [24], False, None)
    kernel = found.kernel
    assert np.count_nonzero(kernel.weights) <= 21
    # Of all the symmetries of its site.
    square = kernel.weights.reshape(7, 7)
    for turned in (square.T, square[::-1], square[:, ::-1]):
        np.testing.assert_allclose(square, turned, atol=1e-9 * np.abs(square).max())


@pytest.mark.parametrize(
    "keys",
    [
        {},
        # Limits of its own, or a mask, make a site unlike others.
        {"limits.electrode_ma": (3.0,) * 100 + (2.9,) + (3.0,) * 155},
        {"output.masked": (100,)},
    ],
)
def test_large_grids_have_few_tiles(grid, keys):
    profile = grid(16, 30, **keys)
    tiles = tiles_of(profile, profile.driven.tolist())
    assert sum(len(tile.members) for tile in tiles) == len(profile.driven)
    largest = max(len(tile.members) for tile in tiles)
    assert largest == (16 - 8) ** 2 if not keys else largest < (16 - 8) ** 2
    assert keys or len(tiles) < 30
    for tile in tiles:
        own = tile.profile
        for site, members in tile.members.items():
            assert members[0] == site
            assert not set(profile.output.masked) & set(members[own.driven].tolist())
            assert 9 <= len(own.driven) <= 30


def test_kernels_that_cannot_be_confined(grid):
    with pytest.raises(ValueError, match=r"kernels\.neighbors"):
        grid(**{"output.kind": "three-state", "limits.total_ma": None})
