"""Closed forms against quadrature, finite differences and Laplace's equation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.physiology.potential import (
    Field,
    annulus,
    disc,
    line_in_plane,
    point,
    rectangle,
)

NODES, SHARES = np.polynomial.legendre.leggauss(400)
COARSE, PARTS = np.polynomial.legendre.leggauss(80)
STEP_MM = 0.02

PLACES = [(0.0, 0.0, 0.7), (0.7, 0.4, 0.7), (2.0, -1.0, 0.9), (0.5, 0.0, 2.0)]


def point_potential(x, y, z):
    return 1 / np.sqrt(x * x + y * y + z * z)


def disc_potential(radius):
    """Weber's equipotential disc as evenly spread complex point sources."""

    def potential(x, y, z):
        distance = np.sqrt(x * x + y * y + (z + 1j * radius * NODES) ** 2)
        return float((SHARES / distance).sum().real / 2)

    return potential


def rectangle_potential(width, height):
    """Point sources spread evenly over a rectangle, by Gauss's rule."""

    def potential(x, y, z):
        u, v = COARSE[:, None] * width / 2, COARSE[None] * height / 2
        return float(PARTS @ (1 / np.sqrt((x - u) ** 2 + (y - v) ** 2 + z * z)) @ PARTS) / 4

    return potential


def annulus_potential_by_points(outer, inner):
    """Point sources spread evenly over a ring, by Gauss's rule along the radius."""
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


def by_differences(potential, place):
    """All seven parts of a field from 19 potentials around a place, fourth order in the step."""

    def shifted(*steps):
        return -potential(*(np.array(place) + STEP_MM * np.array(steps)))

    axes = np.eye(3)
    straight = [
        (
            16 * (shifted(*axis) + shifted(*-axis))
            - shifted(*(2 * axis))
            - shifted(*(-2 * axis))
            - 30 * shifted(0, 0, 0)
        )
        / (12 * (STEP_MM) ** 2)
        for axis in axes
    ]

    def mixed(first, second, reach):
        a, b = axes[first] * reach, axes[second] * reach
        return (shifted(*(a + b)) + shifted(*(-a - b)) - shifted(*(a - b)) - shifted(*(b - a))) / (
            4 * (STEP_MM * reach) ** 2
        )

    slanted = [
        (4 * mixed(first, second, 1) - mixed(first, second, 2)) / 3
        for first, second in ((0, 1), (0, 2), (1, 2))
    ]
    return Field(shifted(0, 0, 0), *straight, *slanted)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(("closed", "potential"), CLOSED)
def test_closed_forms_against_quadrature_and_differences(closed, potential, place):
    expected = by_differences(potential, place)
    strongest = max(abs(part) for part in expected[1:])
    for mine, theirs in zip(at(closed, *place), expected, strict=True):
        assert mine == pytest.approx(theirs, rel=1e-4, abs=1e-5 * strongest)


@given(st.floats(-8, 8), st.floats(-8, 8), st.floats(0.2, 3))
@pytest.mark.parametrize("closed", [closed for closed, _ in CLOSED])
def test_laplace(closed, x, y, z):
    field = at(closed, x, y, z)
    scale = abs(field.xx) + abs(field.yy) + abs(field.zz)
    assert abs(field.xx + field.yy + field.zz) <= 1e-9 * scale + 1e-12


def test_along_a_slant_is_the_second_difference_along_it():
    direction = np.array([2, -1, 2]) / 3
    potential = disc_potential(0.5)
    place = np.array([0.4, 0.3, 0.8])
    ahead, here, behind = (-potential(*(place + step * direction)) for step in (2e-3, 0, -2e-3))
    slanted = at(CLOSED[2][0], *place).along(direction)
    assert slanted == pytest.approx((ahead - 2 * here + behind) / 4e-6, rel=1e-4)


def test_equation_5():
    assert line_in_plane(np.array([0.0, 0.9, 2.0]), 0.9).xx == pytest.approx(
        [1 / 0.81, 0.0, (0.81 - 4) / (0.81 + 4) ** 2]
    )


def test_a_long_thin_rectangle_is_the_line_of_the_paper():
    length = 400.0
    field = at(lambda x, y, z: rectangle(x, y, z, 1e-3, length), 0.4, 0.0, 0.7)
    line = line_in_plane(np.array(0.4), 0.7)
    # On a half space, ρI/2π per point against ρI/2πL per line in a whole plane: twice.
    assert field.xx * length / 2 == pytest.approx(float(line.xx), rel=1e-3)
