"""Potentials and AF matrices of all electrode shapes: closed forms, signs and superposition."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.physiology import activating_function
from smarttouch.physiology.activating_function import (
    Field,
    af_matrix,
    along_axon,
    annulus,
    disc,
    everywhere,
    field_at,
    point,
    potential_mv,
    rectangle,
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
    # Under the hole of a ring, signs are reversed to a depth of 0.7 radii: on the ring's axis, the
    # second derivative of 1/√(r² + z²) changes sign at z = r/√2.
    rings = [which for (shape, _), which in profile.electrodes.kinds.items() if shape == "annulus"]
    for which in rings:
        assert np.all(own[which] < 0)
        own[which] *= -1
    assert np.all(own > 0)


def test_the_paper_s_own_matrix():
    """The AF of seven lines at the middle SAI target follows Eq. 3, 5 and 9 of the paper."""
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
    """Beside a cathode, anodes reduce the ratio of deep to shallow AF, and cathodes increase it."""
    profile = load_profile("line-7")
    flat = targets(profile, Afferent.SAI)
    shallow, deep = (af_matrix(profile, replace(flat, depth_mm=each))[3] for each in (0.7, 2.0))
    alone, narrow, broad = (
        np.array([0, 0, beside, 1, beside, 0, 0]) for beside in (0.0, -0.5, 1.0)
    )
    lone, narrowed, broadened = (deep @ w / (shallow @ w) for w in (alone, narrow, broad))
    assert narrowed < 0.6 * lone
    assert broadened > 2 * lone


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
    """Nodes reach two pitches beyond the outer lines. A pitch has 1 RA, 10 SAI or 10 PC nodes."""
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
        # The axon descends two pitches below the ending, with nodes 0.1 mm apart.
        assert [each.depth_mm for each in sets] == pytest.approx(0.7 + 0.1 * np.arange(41))
    else:
        assert len(sets) == 1
        # The axon extends 9 mm to both sides, a pitch beyond the outer electrodes.
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


NODES, SHARES = np.polynomial.legendre.leggauss(400)
COARSE, PARTS = np.polynomial.legendre.leggauss(80)
STEP_MM = 0.02

PLACES = [(0.0, 0.0, 0.7), (0.7, 0.4, 0.7), (2.0, -1.0, 0.9), (0.5, 0.0, 2.0)]


def point_potential(x, y, z):
    return 1 / np.sqrt(x * x + y * y + z * z)


def disc_potential(radius):
    """Return the potential of an equipotential disc (Weber), a sum of complex point sources."""

    def potential(x, y, z):
        distance = np.sqrt(x * x + y * y + (z + 1j * radius * NODES) ** 2)
        return float((SHARES / distance).sum().real / 2)

    return potential


def rectangle_potential(width, height):
    """Return the potential of a uniform current over a rectangle, integrated by Gauss's rule."""

    def potential(x, y, z):
        u, v = COARSE[:, None] * width / 2, COARSE[None] * height / 2
        return float(PARTS @ (1 / np.sqrt((x - u) ** 2 + (y - v) ** 2 + z * z)) @ PARTS) / 4

    return potential


def annulus_potential_by_points(outer, inner):
    """Return the potential of a uniform current over a ring, by Gauss's rule along the radius."""
    radii = (outer + inner) / 2 + (outer - inner) / 2 * COARSE
    turns = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    u, v = radii[:, None] * np.cos(turns), radii[:, None] * np.sin(turns)
    weights = (PARTS * radii / (PARTS @ radii))[:, None] / len(turns)

    def potential(x, y, z):
        return float((weights / np.sqrt((x - u) ** 2 + (y - v) ** 2 + z * z)).sum())

    return potential


CLOSED = [
    (point, point_potential),
    (lambda x, y, z: disc(x, y, z, 0.25), disc_potential(0.25)),
    (lambda x, y, z: disc(x, y, z, 0.5), disc_potential(0.5)),
    (lambda x, y, z: disc(x, y, z, 0.8), disc_potential(0.8)),
    (lambda x, y, z: annulus(x, y, z, 0.8, 0.4), annulus_potential_by_points(0.8, 0.4)),
    (lambda x, y, z: annulus(x, y, z, 4.0, 3.0), annulus_potential_by_points(4.0, 3.0)),
    (lambda x, y, z: rectangle(x, y, z, 0.5, 10.0), rectangle_potential(0.5, 10.0)),
    (lambda x, y, z: rectangle(x, y, z, 1.5, 1.0), rectangle_potential(1.5, 1.0)),
]


def at(field, x, y, z):
    return Field(*(float(part) for part in field(np.array(x), np.array(y), z)))


DIRECTIONS = [*np.eye(3), [0.6, -0.8, 0], [0.6, 0, 0.8], [2 / 3, -1 / 3, 2 / 3]]
"""Six directions, because a field has six different second derivatives."""


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(("closed", "potential"), CLOSED)
def test_closed_forms_against_quadrature_and_differences(closed, potential, place):
    """Derivatives in closed form agree with differences of potentials at neighboring points."""
    field, expected = at(closed, *place), []
    for direction in DIRECTIONS:
        steps = STEP_MM * np.arange(-2, 3)[:, None] * np.array(direction)
        near = [-potential(*(np.array(place) + step)) for step in steps]
        expected.append(np.dot([-1, 16, -30, 16, -1], near) / (12 * STEP_MM**2))
    assert field.potential == pytest.approx(-potential(*place), rel=1e-4)
    found = [float(field.along(np.array(direction))) for direction in DIRECTIONS]
    assert found == pytest.approx(expected, rel=1e-4, abs=1e-5 * np.abs(expected).max())


@given(st.floats(-8, 8), st.floats(-8, 8), st.floats(0.2, 3))
@pytest.mark.parametrize("closed", [closed for closed, _ in CLOSED])
def test_laplace(closed, x, y, z):
    field = at(closed, x, y, z)
    scale = abs(field.xx) + abs(field.yy) + abs(field.zz)
    assert abs(field.xx + field.yy + field.zz) <= 1e-9 * scale + 1e-12
