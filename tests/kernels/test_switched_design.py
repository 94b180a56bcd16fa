"""Switched kernels: one electrode against its ring or against all."""

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.kernels.bank import load_bank
from smarttouch.kernels.design_problem import Problem
from smarttouch.kernels.switched_design import (
    design_one_of_n,
    design_three_state,
    polarity,
    possible_modes,
)
from smarttouch.kernels.weighted_design import design_kernel
from smarttouch.profile import load_profile

from ..support.checks import raises


@pytest.fixture(scope="module")
def small(changed):
    """A 2 x 3 array of three states."""

    def make(**more):
        keys = {"array.rows": 2, "array.columns": 3, "skin.node_spacing_mm": 0.25}
        return changed(load_profile("smarttouch-4x4"), keys | more)

    return make


def ring_of(profile, site):
    """Return the neighbors of a site on a square grid, diagonals included."""
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
    """What several electrodes share flows through one of them where the others come off."""
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
