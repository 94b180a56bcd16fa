"""Layered skin against images, a boundary-value solution and finite differences of itself."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import j0, j1

from smarttouch.physiology.layered_skin import round_electrode, spectrum, transfer
from smarttouch.physiology.potential import disc, point

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


def by_boundary_values(k, depth, layers):
    """Solve continuity of potential and current at every interface, frequency by frequency."""
    tops = np.concatenate([[0.0], np.cumsum([thickness for thickness, _ in layers[:-1]])])
    count = len(layers)
    system, right = np.zeros((2 * count - 1, 2 * count - 1)), np.zeros(2 * count - 1)
    # Unknown 2i falls and 2i+1 rises in layer i, both 1 at its top; the last one only falls.
    system[0, 0] = layers[0][1]
    system[0, 1:2] = -layers[0][1]
    right[0] = 1.0
    for i in range(count - 1):
        drop = np.exp(-k * layers[i][0])
        own, below = layers[i][1], layers[i + 1][1]
        system[2 * i + 1, 2 * i : 2 * i + 2] = [drop, 1 / drop]
        system[2 * i + 2, 2 * i : 2 * i + 2] = [own * drop, -own / drop]
        system[2 * i + 1, 2 * i + 2 : 2 * i + 4] = [-1, -1][: 2 * count - 3 - 2 * i]
        system[2 * i + 2, 2 * i + 2 : 2 * i + 4] = [-below, below][: 2 * count - 3 - 2 * i]
    answer = np.append(np.linalg.solve(system, right), 0.0)
    layer = int(np.searchsorted(tops, depth, side="right")) - 1
    falling, rising = answer[2 * layer : 2 * layer + 2]
    into = k * (depth - tops[layer])
    return falling * np.exp(-into) + rising * np.exp(into), (
        falling * np.exp(-into) - rising * np.exp(into)
    )


@pytest.mark.parametrize("depth", [0.1, 0.7, 0.9, 2.0])
@pytest.mark.parametrize("k", [0.01, 0.3, 1.0, 4.0, 9.0])
def test_transfer_solves_the_boundary_values(depth, k):
    level, slope = transfer(np.array([k]), depth, SKIN)
    expected = by_boundary_values(k, depth, SKIN)
    assert (level[0], slope[0]) == pytest.approx(expected, rel=1e-8)


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


@pytest.mark.parametrize(("outer", "inner", "depth"), [
    (0.0, 0.0, 0.7), (0.5, 0.0, 0.2), (0.5, 0.0, 2.0), (0.8, 0.4, 0.2), (0.8, 0.4, 0.7),
])  # fmt: skip
def test_three_layers_against_adaptive_quadrature(outer, inner, depth):
    x, y = axis(0.0, 0.5, 1.3, 4.0)
    found = round_electrode(x, y, depth, outer, inner, SKIN)
    for index, r in enumerate(x):

        def integral(weight, r=r):
            def integrand(k):
                level, slope = by_boundary_values(k, depth, SKIN)
                current = float(spectrum(np.array([k]), outer, inner)[0])
                return current * weight(k, level, slope, r)

            # Growing exponentials spoil the naive solution beyond; nothing is left there.
            return quad(integrand, 1e-9, 30 / depth, limit=400, epsabs=1e-8, epsrel=1e-8)[0]

        potential = integral(lambda k, level, slope, r: level * j0(k * r))
        zz = integral(lambda k, level, slope, r: level * k * k * j0(k * r))
        assert -found.potential[index] == pytest.approx(potential, rel=1e-4)
        assert -found.zz[index] == pytest.approx(zz, rel=1e-4, abs=1e-6 * abs(found.zz[0]))
        if r:
            slant = integral(lambda k, level, slope, r: slope * k * k * j1(k * r))
            assert -found.xz[index] == pytest.approx(slant, rel=1e-4)


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


def test_insulating_fat_holds_the_current_in_the_skin():
    x, y = axis(0.0, 2.0, 4.0)
    open_, held = (
        round_electrode(x, y, 0.7, 0.5, 0.0, [(1.5, 0.43), (np.inf, below)])
        for below in (0.43, 0.025)
    )
    assert np.all(np.abs(held.potential) > np.abs(open_.potential))
