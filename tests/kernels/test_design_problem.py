"""Symmetries of design problems, batch design of many sites, and kernels of switched boards."""

import json

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.kernels.bank import design_bank, find_bank, load_bank, problem_hash, write_bank
from smarttouch.kernels.batch_design import design_sites, tiles_of
from smarttouch.kernels.design_problem import Problem
from smarttouch.kernels.kernel_report import find_kernels
from smarttouch.kernels.minmax_design import design_kernel
from smarttouch.kernels.switched_design import (
    design_one_of_n,
    design_three_state,
    polarity,
    possible_modes,
)
from smarttouch.physiology.activating_function import af_matrix, everywhere
from smarttouch.profile import load_profile

from ..support.checks import assert_close, raises
from ..support.full import sample

# Coarse nodes save time. Symmetries, messages and sums do not depend on the spacing.
SPACING = "skin.node_spacing_mm"


@pytest.fixture(scope="module")
def coarse(profile, changed):
    return changed(profile, {SPACING: 0.5})


@pytest.mark.parametrize("name", ["electric-mouse", "kajimoto-61", "line-7"])
@pytest.mark.parametrize("afferent", sample(Afferent))
def test_symmetries_leave_the_targets_and_the_rows_alone(changed, name, afferent):
    problem = Problem(changed(load_profile(name), {SPACING: 0.25}), afferent)
    assert np.array_equal(problem.symmetries[0], np.arange(problem.electrodes))
    for move in problem.symmetries:
        moved = problem.target[np.ix_(move, move)]
        assert_close(moved, problem.target)
        rows = problem.other
        before, after = (np.sort(each.max(axis=1)) for each in (rows, rows[:, move]))
        assert_close(after, before)


@pytest.mark.parametrize("keys", [
    {"output.impedance_kohm": [2.0] + [1.0] * 15},
    {"limits.electrode_ma": [2.4] * 15 + [2.5]},
    {"limits.total_ma": 5.0, "perception.threshold_ma": [1.2] * 4 + [1.1] + [1.2] * 11},
], ids=lambda keys: next(iter(keys)))  # fmt: skip
def test_an_electrode_of_its_own_kind_has_no_mirror_image(changed, keys):
    profile = changed(load_profile("smarttouch-4x4"), {SPACING: 0.5})
    assert len(Problem(profile, Afferent.RA).symmetries) == 8
    mine = changed(profile, keys)
    for move in Problem(mine, Afferent.RA).symmetries:
        assert np.array_equal(mine.admittance[move], mine.admittance)
        assert np.array_equal(mine.threshold_ma[move], mine.threshold_ma)
    assert len(Problem(mine, Afferent.RA).symmetries) < 8


FREE = {"layout": "free", "positions_mm": [[0, 0], [2, 0], [1, 1.7], [3.1, 2.4]]}
SQUARE = {"layout": "free", "positions_mm": [[0, 0], [2, 0], [0, 2], [2, 2]], "shape": "rectangle"}


@pytest.mark.parametrize(("name", "keys", "count"), [
    ("electric-mouse", {"array": FREE}, 1),
    ("electric-mouse", {"array": SQUARE | {"size_mm": [0.5, 1.5]}}, 4),
    ("electric-mouse", {"array": SQUARE | {"size_mm": [1.0, 1.0]}}, 8),
    # The only remaining mirror axis is the diagonal through the masked electrode.
    ("electric-mouse", {"output.masked": [27]}, 2),
    # Thresholds change kernels only if their design limits the total or electrode currents.
    ("smarttouch-4x4", {"perception.threshold_ma": [1.2] * 15 + [1.1]}, 8),
], ids=["free", "upright", "square", "masked", "thresholds"])  # fmt: skip
def test_how_many_symmetries_there_are(changed, name, keys, count):
    mine = changed(load_profile(name), keys | {SPACING: 0.5})
    assert len(Problem(mine, Afferent.RA).symmetries) == count


def test_judging_gives_the_effects_of_weights(coarse):
    problem = Problem(coarse, Afferent.SAI)
    weights = np.zeros(64)
    weights[27], weights[0] = 1.0, -1.0
    kernel = problem.judge(weights, 27, kind="three-state")
    assert problem.target[27] @ kernel.weights == pytest.approx(1)
    af = {
        each: (af_matrix(coarse, everywhere(coarse, each)) @ kernel.weights).max()
        for each in Afferent
    }
    assert kernel.off_target == pytest.approx(max(af[Afferent.RA], af[Afferent.PC]))
    assert af[kernel.off_target_class] == pytest.approx(kernel.off_target)
    assert kernel.peak_normalized[27] == 1
    named = ("SAI", "27", "electric-mouse")
    with raises(DesignError, value=named, electrode=27):
        problem.judge(-weights, 27)


def test_no_last_bit_chooses_between_classes_pressed_alike(coarse):
    problem = Problem(coarse, Afferent.PC)
    weights = np.zeros(64)
    weights[27], weights[0] = 1.0, -1.0
    ra, sai = (
        np.flatnonzero(problem.other_class == each)[0] for each in (Afferent.RA, Afferent.SAI)
    )
    rows = problem.other
    rows[sai] = 10 * rows[(rows @ weights).argmax()]
    rows[ra] = rows[sai] * (1 - 1e-12)
    assert problem.judge(weights, 27).off_target_class is Afferent.RA
    rows[ra] = rows[sai] * (1 - 1e-3)
    assert problem.judge(weights, 27).off_target_class is Afferent.SAI


@pytest.fixture(scope="module")
def problem():
    return Problem(load_profile("smarttouch-4x4"), Afferent.SAI)


@pytest.mark.parametrize("afferent", sample(Afferent))
def test_symmetry_gives_what_solving_each_site_gives(changed, afferent):
    """A kernel copied by symmetry equals a kernel designed at its own site."""
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
    """At every site, the electrodes of a pole carry current in proportion to their admittance."""
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


def test_a_confined_bank_is_that_of_masked_arrays(grid, changed, tmp_path, monkeypatch):
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
    # The bank is found for its own profile. It is not found if kernels may drive all electrodes.
    monkeypatch.setattr("platformdirs.user_cache_path", lambda _: tmp_path)
    write_bank(tmp_path / f"{problem_hash(profile)}.npz", profile, bank)
    assert find_bank(profile) is not None
    assert find_bank(changed(profile, {"kernels.neighbors": None})) is None


def test_one_site_is_designed_alone(grid):
    profile = grid(7, 21)
    (found,) = find_kernels(profile, [Afferent.RA], 24, False, None)
    kernel = found.kernel
    assert np.count_nonzero(kernel.weights) <= 21
    # The kernel has all symmetries of its site.
    square = kernel.weights.reshape(7, 7)
    for turned in (square.T, square[::-1], square[:, ::-1]):
        np.testing.assert_allclose(square, turned, atol=1e-9 * np.abs(square).max())


@pytest.mark.parametrize(
    "keys",
    [
        {},
        # An electrode with another limit, or a masked one, makes the surroundings of sites differ.
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


@pytest.fixture(scope="module")
def small(changed):
    """Return a function that makes the profile of a three-state board with 2 x 3 electrodes."""

    def make(**more):
        keys = {"array.rows": 2, "array.columns": 3, "skin.node_spacing_mm": 0.25}
        return changed(load_profile("smarttouch-4x4"), keys | more)

    return make


def ring_of(profile, site):
    """Return the neighbors of a site on a square grid, including diagonal ones."""
    away_mm = np.abs(profile.electrodes.position_mm - profile.electrodes.position_mm[site])
    near = away_mm.max(axis=1) < 1.1 * profile.electrodes.pitch_mm
    return sorted({*np.flatnonzero(near).tolist()} - {site})


@pytest.mark.parametrize("afferent", list(Afferent))
@pytest.mark.parametrize("site", [0, 5])
def test_three_states_are_the_better_of_ring_and_all(afferent, site):
    problem = Problem(load_profile("smarttouch-4x4"), afferent)
    found = design_three_state(problem, site)
    pole = -1 if polarity(problem.profile, afferent) == "anodic" else 1
    kernels = []
    for others in (ring_of(problem.profile, site), [*{*range(16)} - {site}]):
        weights = np.zeros(16)
        weights[site], weights[others] = pole, -pole / len(others)
        kernels.append(problem.judge(weights, site, kind="three-state"))
    best = min(kernels, key=lambda kernel: max(kernel.off_target, kernel.spill))
    assert found.weights == pytest.approx(best.weights)
    assert found.kind == "three-state"
    weighted = design_kernel(problem, site, given_up=0)
    assert max(found.off_target, found.spill) >= weighted.off_target - 1e-9


def test_poles_share_by_admittance_and_masked_electrodes_carry_nothing(small):
    kohm = [1.0, 3.0, 0.5, 2.0, 1.0, 0.7]
    profile = small(**{"output.impedance_kohm": kohm, "output.masked": [2]})
    kernel = design_three_state(Problem(profile, Afferent.RA), 4)
    share = 1 / np.array(kohm)
    share[[2, 4]] = 0
    share /= share.sum()
    share[4] = -1
    assert kernel.peak_normalized == pytest.approx(share)


def test_a_ring_that_breaks_a_limit_is_not_chosen():
    profile = load_profile("smarttouch-4x4")
    free = design_three_state(Problem(profile, Afferent.RA), 5)
    ring = ring_of(profile, 5)
    limit_ma = 0.9 * profile.full_ma[5] / len(ring)
    limits = profile.limits.model_dump() | {
        "electrode_ma": [limit_ma if each in ring else 5.0 for each in range(16)]
    }
    felt = profile.perception.model_dump() | {
        "threshold_ma": [limit_ma / 4 if each in ring else 1.0 for each in range(16)]
    }
    limited = profile.model_copy(update={"limits": limits, "perception": felt})
    kept = design_three_state(Problem(limited, Afferent.RA), 5)
    carried_ma = limited.full_ma[5] * np.abs(kept.peak_normalized)
    assert (carried_ma[ring] <= limit_ma).all()
    assert np.count_nonzero(free.weights) <= np.count_nonzero(kept.weights) == 16


@pytest.mark.parametrize("afferent", list(Afferent))
def test_no_shipped_kernel_shares_a_source_between_all_poles(afferent):
    """One pole of each kernel is a single electrode, which carries the full current."""
    profile = load_profile("smarttouch-4x4")
    weights = load_bank(profile).kernels(afferent)
    assert np.abs(weights).sum(axis=1) / 2 == pytest.approx(np.abs(weights).max(axis=1))
    full_ma = profile.full_ma * np.abs(weights).max(axis=1)
    assert (full_ma <= profile.total_ma).all()


def test_one_of_n_is_one_against_all_others(small):
    problem = Problem(small(), Afferent.RA)
    kernel = design_one_of_n(problem, 4)
    assert kernel.peak_normalized == pytest.approx([0.2, 0.2, 0.2, 0.2, -1, 0.2])
    assert design_one_of_n(Problem(small(), Afferent.SAI), 4).peak_normalized[4] == 1
    masked = Problem(small(**{"output.masked": [0]}), Afferent.RA)
    left = [0, 0.25, 0.25, 0.25, -1, 0.25]
    assert design_one_of_n(masked, 4).peak_normalized == pytest.approx(left)


@pytest.mark.parametrize("design", [design_kernel, design_one_of_n, design_three_state])
def test_sites_that_have_no_kernel(small, design):
    problem = Problem(small(**{"output.masked": [2]}), Afferent.RA)
    with raises(DesignError, value=2, electrode=2):
        design(problem, 2)
    for site in (-1, 6):
        with raises(DesignError, value=site, allowed=(0, 5)):
            design(problem, site)


def test_polarity_follows_the_ending(changed):
    profile = load_profile("kajimoto-61")
    assert polarity(profile, Afferent.RA) == "anodic"
    assert possible_modes(profile) == [Afferent.RA]
    active = changed(profile, {"skin.ra_ending": "active"})
    assert polarity(active, Afferent.RA) == "cathodic"
    assert possible_modes(active) == []
