"""Layered skin against images, a boundary-value solution and finite differences of itself."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import j0, j1

from smarttouch.base.errors import DesignError
from smarttouch.physiology.layered_skin import (
    layered_potential,
    round_electrode,
    transfer,
)
from smarttouch.physiology.potential import disc, disc_potential, point

from ..raising import raises
from ..reference import layered_field as reference
from ..whole import WHOLE, sample

HOMOGENEOUS = [(np.inf, 1.0)]
SKIN = [(0.3, 0.02), (1.2, 0.43), (np.inf, 0.025)]
"""Stratum corneum, epidermis and dermis, fat."""


def axis(*radii):
    x = np.array(radii, float)
    return x, np.zeros_like(x)


def by_images(x, depth, thickness, upper, lower, count=400):
    """Potential of a point on two layers: mirror images (Maxwell), seen from the upper layer."""
    echo = (upper - lower) / (upper + lower)
    potential = 1 / np.hypot(x, depth)
    for n in range(1, count):
        for away in (2 * n * thickness + depth, 2 * n * thickness - depth):
            potential = potential + echo**n / np.hypot(x, away)
    return potential / upper


@pytest.mark.parametrize("depth", [0.1, 0.7, 0.9, 2.0])
@pytest.mark.parametrize("k", sample([0.01, 0.3, 1.0, 4.0, 9.0], 4))
def test_transfer_solves_the_boundary_values(depth, k):
    level, slope = transfer(np.array([k]), depth, SKIN)
    expected = reference.transfer(np.array([k]), depth, SKIN)
    assert (level, slope) == (pytest.approx(expected[0]), pytest.approx(expected[1]))


@pytest.mark.parametrize("depth", [0.5, 0.9, 2.0])
def test_one_layer_is_the_closed_form(depth):
    x, y = np.meshgrid([0.0, 0.3, 0.5, 1.7, 6.0], [0.0, 0.4, -2.0])
    for radius, closed in ((0.0, point(x, y, depth)), (0.5, disc(x, y, depth, 0.5))):
        found = round_electrode(x, y, depth, radius, 0.0, HOMOGENEOUS)
        strongest = max(np.abs(part).max() for part in closed[1:])
        for mine, theirs in zip(found, closed, strict=True):
            np.testing.assert_allclose(mine, theirs, rtol=1e-4, atol=1e-6 * strongest)


@pytest.mark.parametrize(("upper", "lower"), [(1.0, 0.05), (0.05, 1.0), (0.43, 0.3)])
def test_two_layers_are_a_row_of_images(upper, lower):
    x, y = axis(0.0, 0.4, 1.0, 3.0)
    found = round_electrode(x, y, 0.7, 0.0, 0.0, [(1.0, upper), (np.inf, lower)])
    expected = by_images(x, 0.7, 1.0, upper, lower)
    np.testing.assert_allclose(-found.potential, expected, rtol=1e-4)
    step = 0.01
    beside = [by_images(x + dx, 0.7, 1.0, upper, lower) for dx in (-step, step)]
    np.testing.assert_allclose(
        -found.xx, (sum(beside) - 2 * expected) / step**2, rtol=1e-3, atol=1e-3
    )


@pytest.mark.parametrize(("outer", "inner", "depth"), sample([
    (0.0, 0.0, 0.7), (0.5, 0.0, 0.2), (0.5, 0.0, 2.0), (0.8, 0.4, 0.2), (0.8, 0.4, 0.7),
]))  # fmt: skip
def test_three_layers_against_an_integral_of_its_own(outer, inner, depth):
    x, y = axis(0.0, 0.5, 1.3, 4.0)
    found = round_electrode(x, y, depth, outer, inner, SKIN)
    kinds = (
        (found.potential, lambda k, level, _: level * j0(np.outer(x, k))),
        (found.zz, lambda k, level, _: level * k * k * j0(np.outer(x, k))),
        (found.xz, lambda k, _, slope: slope * k * k * j1(np.outer(x, k))),
    )
    for mine, weight in kinds:
        expected = reference.integral(weight, 4.0, depth, SKIN, outer, inner)
        assert -mine == pytest.approx(expected, rel=1e-4, abs=1e-6 * np.abs(expected).max())


def test_laplace_in_every_layer():
    x, y = np.meshgrid([0.0, 0.4, 2.0], [0.0, 0.7])
    for depth in (0.2, 0.7, 2.0):
        field = round_electrode(x, y, depth, 0.5, 0.0, SKIN)
        strongest = np.abs(field.zz).max()
        np.testing.assert_allclose(field.xx + field.yy + field.zz, 0, atol=1e-9 * strongest)


def test_an_annulus_is_rings_of_points():
    """Against Gauss's rule over the ring itself, in homogeneous skin."""
    x, y = np.array([0.0, 0.6, 1.5]), np.array([0.0, 0.2, 0.0])
    field = round_electrode(x, y, 0.7, 0.8, 0.4, HOMOGENEOUS)
    nodes, shares = np.polynomial.legendre.leggauss(60)
    radii = 0.6 + 0.2 * nodes
    turns = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    u, v = radii[:, None] * np.cos(turns), radii[:, None] * np.sin(turns)
    weight = (shares * radii / (shares * radii).sum())[:, None] / len(turns)
    for index in range(3):
        ring = point(x[index] - u, y[index] - v, 0.7)
        for mine, theirs in zip(field, ring, strict=True):
            expected = float((weight * theirs).sum())
            assert mine[index] == pytest.approx(expected, rel=1e-4, abs=1e-6)


def second_differences(potential, places, depth, step=0.079):
    """Return what drives a fiber with nodes 79 µm apart: across and along the depth, (2, R)."""
    here = potential(places, depth)
    across = potential(np.abs(places - step), depth) + potential(places + step, depth) - 2 * here
    down = potential(places, depth - step) + potential(places, depth + step) - 2 * here
    return np.array([across, down])


LAYER = st.tuples(st.floats(0.02, 4.0), st.floats(0.002, 2.0))


@settings(max_examples=3 if WHOLE else 1)
@given(
    stack=st.lists(LAYER, max_size=3),
    bottom=st.floats(0.002, 2.0),
    radii=st.sampled_from([(0.0, 0.0), (0.25, 0.0), (0.5, 0.0), (1.5, 0.0), (0.8, 0.4)]),
    depth=st.floats(0.4, 4.0),
    away=st.floats(0.0, 20.0),
)
def test_a_table_is_the_integral(stack, bottom, radii, depth, away):
    """Within 1e-3 of the peak, as are the second differences that drive fibers."""
    layers = [*stack, (np.inf, bottom)]
    places = np.array([0.0, 0.3, 0.5, away])

    def table(r, z):
        return layered_potential(r[None], np.array([z]), radii, layers)[0]

    def integral(r, z):
        return reference.potential(r, z, layers, *radii)

    mine, theirs = table(places, depth), integral(places, depth)
    assert np.abs(mine - theirs).max() <= 1e-5 * theirs.max()
    found, expected = (second_differences(each, places, depth) for each in (table, integral))
    assert np.abs(found - expected).max() <= 1e-3 * np.abs(expected).max()


def test_a_table_of_one_layer_is_the_closed_form_to_the_far_side_of_a_large_array():
    r, depth = np.meshgrid([0.0, 0.5, 7.0, 63.0, 120.0], [0.2, 0.9, 15.0, 30.0])
    found = layered_potential(r, depth[:, 0], (0.5, 0.0), HOMOGENEOUS)
    np.testing.assert_allclose(found, disc_potential(r, depth, 0.5), rtol=1e-5)


def test_a_table_has_a_shallowest_depth():
    with raises(DesignError, value=0.1):
        layered_potential(np.zeros((1, 1)), np.array([0.1]), (0.5, 0.0), HOMOGENEOUS)
