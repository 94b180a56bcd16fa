"""Places of nodes, and their variants."""

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.physiology import activating_function
from smarttouch.physiology.activating_function import along_axon, everywhere, skin_variants, targets
from smarttouch.profile import load_profile

from ..raising import raises


def test_paper_nodes_run_from_minus_five_to_five():
    """Two pitches beyond the outer lines; RA a pitch apart, the others as in the file."""
    profile = load_profile("line-7")
    for afferent, apart_mm in zip(Afferent, (1.0, 0.1, 0.1), strict=True):
        nodes = everywhere(profile, afferent)
        expected = apart_mm * np.arange(-round(5 / apart_mm), round(5 / apart_mm) + 1)
        assert nodes.position_mm[:, 0] == pytest.approx(expected)
        assert not nodes.position_mm[:, 1].any()
        assert nodes.grid == (1, len(expected))


def test_paper_ra_axons_stand_a_pitch_apart_however_fine_the_nodes(changed):
    fine = changed(load_profile("line-7"), {"skin.node_spacing_mm": 0.25})
    assert len(everywhere(fine, Afferent.SAI).position_mm) == 41
    assert len(everywhere(fine, Afferent.RA).position_mm) == 11


def test_nodes_lie_in_every_direction_and_beyond_the_edge(profile):
    sai = everywhere(profile, Afferent.SAI)
    assert np.degrees(np.arctan2(sai.direction[:, 1], sai.direction[:, 0])) == pytest.approx(
        [0, 45, 90, 135]
    )
    assert np.abs(sai.position_mm).max() == pytest.approx(9.0)
    assert sai.grid[0] * sai.grid[1] == len(sai.position_mm)


def test_only_rising_axons_end_here(profile):
    assert everywhere(profile, Afferent.RA).ending == "passive"
    assert everywhere(profile, Afferent.SAI).ending is None


@pytest.mark.parametrize("afferent", list(Afferent))
def test_an_axon_starts_under_its_electrode(profile, afferent):
    sets = along_axon(profile, afferent, 27)
    assert sets[0].position_mm[0] == pytest.approx(profile.electrodes.position_mm[27])
    assert sets[0].depth_mm == activating_function.depth_mm(profile.skin, afferent)
    if afferent is Afferent.RA:
        assert [each.ending for each in sets] == ["passive"] + [None] * (len(sets) - 1)
        # Down to two pitches below the ending, .1 mm apart.
        assert [each.depth_mm for each in sets] == pytest.approx(0.7 + 0.1 * np.arange(41))
    else:
        assert len(sets) == 1
        # As far as nodes are looked at: 9 mm either way, a pitch beyond the outer electrodes.
        expected = np.linspace(-9, 9, 181)
        assert np.sort(sets[0].position_mm[:, 0]) == pytest.approx(expected)
        assert set(sets[0].position_mm[:, 1]) == {profile.electrodes.position_mm[27, 1]}


def test_a_fiber_outside_the_skin_is_refused(profile):
    inside = targets(profile, Afferent.RA)
    for depth_mm in (0.0, -0.7, float("nan")):
        with raises(DesignError, value=depth_mm):
            activating_function.Afferents(
                Afferent.RA, inside.position_mm, depth_mm, inside.direction, None, inside.grid
            )


def test_homogeneous_skin_has_no_variants(profile, layered):
    assert list(skin_variants(profile.skin)) == [profile.skin]
    found = [
        tuple(layer.conductivity_s_per_m for layer in skin.layers)
        for skin in skin_variants(layered(profile).skin)
    ]
    expected = [(0.02, 0.4), (0.02 / 1.5, 0.4), (0.03, 0.4), (0.02, 0.4 / 1.5), (0.02, 0.6)]
    assert found == [pytest.approx(each) for each in expected]
