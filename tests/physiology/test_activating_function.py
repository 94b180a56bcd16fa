"""The AF matrix: signs, superposition, every shape of electrode, and the axon's ending."""

from dataclasses import replace

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.physiology import activating_function
from smarttouch.physiology.activating_function import (
    af_matrix,
    along_axon,
    everywhere,
    field_at,
    potential_mv,
    targets,
)
from smarttouch.profile import list_profiles, load_profile

from ..support.checks import assert_close, raises
from ..support.full import sample


@pytest.mark.parametrize("name", list_profiles())
@pytest.mark.parametrize("afferent", list(Afferent))
def test_shape_and_sign_at_the_target(name, afferent):
    profile = load_profile(name)
    matrix = af_matrix(profile, targets(profile, afferent))
    count = len(profile.electrodes)
    assert matrix.shape == (count, count)
    own = np.diag(matrix) * (-1 if afferent is Afferent.RA else 1)
    # In the hole of a ring it is the other way around, down to .7 of the ring's radius: on its axis
    # the second derivative of 1/√(r² + z²) changes sign at z = r/√2.
    rings = [which for (shape, _), which in profile.electrodes.kinds.items() if shape == "annulus"]
    for which in rings:
        assert np.all(own[which] < 0)
        own[which] *= -1
    assert np.all(own > 0)


def test_superposition_is_linear_in_conductivity(profile, changed):
    half = changed(profile, {"skin.conductivity_s_per_m": 0.215})
    nodes = targets(profile, Afferent.SAI)
    assert af_matrix(half, nodes) == pytest.approx(2 * af_matrix(profile, nodes))


def test_the_paper_s_own_matrix():
    """Eq. 3, 5 and 9 by hand: the SAI target under the middle of seven lines."""
    profile = load_profile("line-7")
    row = af_matrix(profile, targets(profile, Afferent.SAI))[3]
    x = np.arange(-3, 4)
    expected = (0.81 - x**2) / (0.81 + x**2) ** 2 / (2 * np.pi * 0.43 * 10)
    assert row == pytest.approx(expected)


def test_an_infinite_medium_has_half_the_field(profile, changed):
    few = {"array.rows": 3, "array.columns": 4}
    profile = changed(profile, few)
    infinite = changed(profile, {"skin.medium": "infinite"})
    nodes = everywhere(profile, Afferent.PC)
    half = af_matrix(profile, nodes) / 2
    assert_close(af_matrix(infinite, nodes), half)


def test_every_shape_on_every_medium_it_goes_with(profile, changed):
    free = {"layout": "free", "positions_mm": [[0, 0], [2, 0], [1, 1.7]]}
    media = [profile, changed(profile, {"skin.medium": "infinite"})]
    shapes = {"point": [0, 0], "disc": [1, 0], "annulus": [1, 0.5], "rectangle": [0.5, 10]}
    for shape, size in shapes.items():
        for medium in media:
            mine = changed(medium, {"array": free | {"shape": shape, "size_mm": size}})
            nodes = targets(mine, Afferent.SAI)
            assert np.all(np.diag(af_matrix(mine, nodes)) > 0)


def test_an_active_ending_is_mcneal_s_end_node(profile, changed):
    active = changed(profile, {"skin.ra_ending": "active"})
    nodes, step = targets(active, Afferent.RA), active.skin.internode_mm
    potentials = [
        field_at(active.electrodes, active.skin, nodes.position_mm, 0.7 + down)
        for down in (0, step)
    ]
    (end, scale), (next_one, _) = potentials
    expected = scale * (next_one.potential - end.potential) / step**2
    assert af_matrix(active, nodes) == pytest.approx(expected)


def test_depth_selection_of_figure_9():
    """Anodes around a cathode: the AF is gone in the deep. Cathodes around it: it reaches there."""
    profile = load_profile("line-7")
    flat = targets(profile, Afferent.SAI)
    shallow, deep = (af_matrix(profile, replace(flat, depth_mm=each))[3] for each in (0.7, 2.0))
    alone, narrow, broad = (
        np.array([0, 0, beside, 1, beside, 0, 0]) for beside in (0.0, -0.5, 1.0)
    )
    lone, narrowed, broadened = (deep @ w / (shallow @ w) for w in (alone, narrow, broad))
    assert narrowed < 0.6 * lone
    assert broadened > 2 * lone


def test_orientation_selection_of_figure_10():
    """The same place, the other polarity: flat axons against rising ones (Laplace's equation)."""
    profile = load_profile("line-7")
    depth = replace(targets(profile, Afferent.SAI), depth_mm=0.8)
    flat = af_matrix(profile, depth)
    rising = af_matrix(profile, replace(depth, direction=np.array([[0.0, 0.0, 1.0]])))
    assert rising == pytest.approx(-flat)
    assert flat[3, 3] > 0


MIXED = {
    "layout": "free",
    "positions_mm": [[0, 0], [0, 0], [6, 1], [9, 1]],
    "shapes": ["disc", "annulus", "rectangle", "disc"],
    "sizes_mm": [[1.0, 0], [8.0, 6.0], [0.5, 2.0], [1.0, 0]],
}


def test_an_array_of_several_shapes_has_the_fields_of_each(profile, changed):
    mixed = changed(profile, {"array": MIXED, "skin.node_spacing_mm": 0.5})
    nodes = everywhere(mixed, Afferent.SAI)
    whole = af_matrix(mixed, nodes)
    for index, (shape, size) in enumerate(zip(MIXED["shapes"], MIXED["sizes_mm"], strict=True)):
        places = mixed.electrodes.position_mm[[index, (index + 2) % 4]]
        alone = replace(
            mixed.electrodes, position_mm=places, shape=shape, size_mm=tuple(size), own=None
        )
        found, scale = field_at(alone, mixed.skin, nodes.position_mm, nodes.depth_mm)
        expected = np.concatenate([found.along(each)[:, 0] for each in nodes.direction])
        assert whole[:, index] == pytest.approx(scale * expected)


@pytest.mark.parametrize("depth_mm", sample([0.9, 0.3, 2.0], 3))
def test_a_ring_s_potential_is_that_of_its_field(profile, changed, depth_mm):
    array = {"layout": "free", "positions_mm": [[0, 0], [20, 0]], "shape": "annulus"}
    rings = changed(profile, {"array": array | {"size_mm": [8.0, 6.0]}})
    place = (
        np.column_stack([np.linspace(0, 12, 25), np.zeros(25)]) + rings.electrodes.position_mm[0]
    )
    found, scale = field_at(rings.electrodes, rings.skin, place, depth_mm)
    points = np.column_stack([place, np.full(25, depth_mm)])
    assert potential_mv(rings, points) == pytest.approx(1000 * scale * found.potential)


def test_paper_nodes_run_from_minus_five_to_five():
    """Two pitches beyond the outer lines; RA a pitch apart, the others as in the file."""
    profile = load_profile("line-7")
    for afferent, apart_mm in zip(Afferent, (1.0, 0.1, 0.1), strict=True):
        nodes = everywhere(profile, afferent)
        expected = apart_mm * np.arange(-round(5 / apart_mm), round(5 / apart_mm) + 1)
        assert nodes.position_mm[:, 0] == pytest.approx(expected)
        assert not nodes.position_mm[:, 1].any()
        assert nodes.grid == (1, len(expected))


def test_nodes_lie_in_every_direction_and_beyond_the_edge(profile):
    sai = everywhere(profile, Afferent.SAI)
    assert np.degrees(np.arctan2(sai.direction[:, 1], sai.direction[:, 0])) == pytest.approx(
        [0, 45, 90, 135]
    )
    assert np.abs(sai.position_mm).max() == pytest.approx(9.0)
    assert sai.grid[0] * sai.grid[1] == len(sai.position_mm)


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
