"""Kernels confined to neighbors are those of the whole array with all other electrodes masked."""

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.bank import design_bank, problem_hash, write_bank
from smarttouch.kernels.bank import find_bank as find
from smarttouch.kernels.design_problem import Problem
from smarttouch.kernels.kernel_tables import kernels_designed
from smarttouch.kernels.tiled_design import tiles_of
from smarttouch.kernels.weighted_design import design_kernel
from smarttouch.profile import load_profile


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
    assert find(profile) is not None
    assert find(changed(profile, {"kernels.neighbors": None})) is None


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


@pytest.mark.parametrize(
    "keys",
    [{"kernels.objective": "finger"}, {"output.kind": "three-state", "limits.total_ma": None}],
)
def test_kernels_that_cannot_be_confined(grid, keys):
    with pytest.raises(ValueError, match=r"kernels\.neighbors"):
        grid(**keys)
