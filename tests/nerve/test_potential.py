"""Closed forms against quadrature and Laplace's equation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.nerve.potential import disc_on_half_space, line_in_plane

NODES, SHARES = np.polynomial.legendre.leggauss(400)


def disc_potential(x, y, z, radius):
    """Weber's equipotential disc as evenly spread complex point sources."""
    distance = np.sqrt(x * x + y * y + (z + 1j * radius * NODES) ** 2)
    return float((SHARES / distance).sum().real / 2)


def second_difference(function, step=2e-3):
    return (function(step) - 2 * function(0.0) + function(-step)) / step**2


PLACES = [(0.0, 0.0, 0.7), (0.7, 0.4, 0.7), (2.0, -1.0, 0.9), (0.5, 0.0, 2.0)]


@pytest.mark.parametrize(("x", "y", "z"), PLACES)
@pytest.mark.parametrize("radius", [0.25, 0.5, 0.8])
def test_disc_against_quadrature(x, y, z, radius):
    xx, yy, _, zz = (float(v) for v in disc_on_half_space(np.array(x), np.array(y), z, radius))
    assert -xx == pytest.approx(
        second_difference(lambda d: disc_potential(x + d, y, z, radius)), rel=1e-4, abs=1e-4
    )
    assert -yy == pytest.approx(
        second_difference(lambda d: disc_potential(x, y + d, z, radius)), rel=1e-4, abs=1e-4
    )
    assert -zz == pytest.approx(
        second_difference(lambda d: disc_potential(x, y, z + d, radius)), rel=1e-4, abs=1e-4
    )


@given(st.floats(-8, 8), st.floats(-8, 8), st.floats(0.2, 3))
def test_laplace(x, y, z):
    xx, yy, _, zz = disc_on_half_space(np.array(x), np.array(y), z, 0.5)
    scale = abs(xx) + abs(yy) + abs(zz)
    assert abs(xx + yy + zz) <= 1e-9 * scale + 1e-12


def test_a_far_disc_is_a_point():
    xx, _, _, zz = disc_on_half_space(np.array(30.0), np.array(0.0), 40.0, 0.5)
    assert float(zz) == pytest.approx(-(3 * 40**2 - 50**2) / 50**5, rel=1e-3)
    assert float(xx) == pytest.approx(-(3 * 30**2 - 50**2) / 50**5, rel=5e-3)


def test_diagonal_is_the_turned_axis():
    xx, yy, xy, _ = disc_on_half_space(np.array(0.6), np.array(0.6), 0.7, 0.5)
    along = (xx + yy) / 2 + xy
    straight = disc_on_half_space(np.array(0.6 * np.sqrt(2)), np.array(0.0), 0.7, 0.5)[0]
    assert float(along) == pytest.approx(float(straight))


def test_equation_5():
    assert line_in_plane(np.array([0.0, 0.9, 2.0]), 0.9) == pytest.approx(
        [1 / 0.81, 0.0, (0.81 - 4) / (0.81 + 4) ** 2]
    )


def test_under_a_cathode_flat_axons_fire_and_upright_ones_do_not():
    xx, _, _, zz = disc_on_half_space(np.array(0.0), np.array(0.0), 0.7, 0.5)
    assert xx > 0 > zz
