"""Fields of round electrodes on layered skin, by the Hankel transform.

In a stack of layers the potential under an electrode that is round about the
z axis is Φ(r, z) = ∫ S(k) T(k, z) J₀(kr) dk, S the spectrum of the current that
the electrode passes and T what the layers make of it; in a half space of
conductivity σ, T = e^(−kz)/σ. T follows from the transmission-line recursion of
geoelectrics (Koefoed 1979), which holds only falling exponentials and so keeps
its digits for thick layers and thin ones alike.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import j0, j1

from smarttouch.physiology.potential import Array, Field, around_axis

Layer = tuple[float, float]
"""Thickness, mm, and conductivity, S/m, of a layer; the last one's thickness is infinite."""

_DECAYED = 40.0
"""Value of kz at which e^−kz ends the integral: 4e-18."""
_POINTS = 16
_GRID = 0.02
"""Spacing of the radii, relative to their distance from the electrode's center."""


def spectrum(k: Array, outer_radius: float, inner_radius: float = 0.0) -> Array:
    """Return the current spectrum of a round electrode, 1 at k = 0.

    A disc is taken at one potential as on a homogeneous medium (Weber),
    sin(ka)/ka; an annulus passes current evenly, 2(bJ₁(kb) − aJ₁(ka))/k(b² − a²).
    An outer radius of 0 is a point.
    """
    if outer_radius == 0:
        return np.ones_like(k)
    if inner_radius == 0:
        return np.asarray(np.sinc(k * outer_radius / np.pi))
    b, a = outer_radius, inner_radius
    return np.asarray(2 * (b * j1(k * b) - a * j1(k * a)) / (k * (b * b - a * a)))


def transfer(k: Array, depth: float, layers: Sequence[Layer]) -> tuple[Array, Array]:
    """Return T and −(∂T/∂z)/k at a depth, mm·m/S per unit of current spectrum, for k 1/mm."""
    # Resistance seen downward from the top of each layer, as on a transmission line.
    seen = [np.full_like(k, 1 / layers[-1][1])]
    for thickness, conductivity in reversed(layers[:-1]):
        own, below = 1 / conductivity, seen[0]
        turn = np.tanh(k * thickness)
        seen.insert(0, own * (below + own * turn) / (own + below * turn))
    potential, top = seen[0], 0.0
    for index, (thickness, conductivity) in enumerate(layers[:-1]):
        own, below = 1 / conductivity, seen[index + 1]
        echo = (below - own) / (below + own)
        falling = potential / (1 + echo * np.exp(-2 * k * thickness))
        if depth <= top + thickness:
            down = np.exp(-k * (depth - top))
            up = echo * np.exp(-k * (2 * thickness - (depth - top)))
            return falling * (down + up), falling * (down - up)
        potential = falling * (1 + echo) * np.exp(-k * thickness)
        top += thickness
    value = potential * np.exp(-k * (depth - top))
    return value, value


def round_electrode(
    x: Array,
    y: Array,
    depth: float,
    outer_radius: float,
    inner_radius: float,
    layers: Sequence[Layer],
) -> Field:
    """Return the field of a point, disc or annulus (inner radius above 0) on layered skin.

    It is as in `potential`, but per I/2π, with the factor ρ included. Layers run from the surface.
    """
    r = np.hypot(x, y)
    farthest = float(r.max()) + depth
    # Even steps of arsinh(r/z): dense under the electrode, sparse where the field is smooth.
    steps = int(np.arcsinh(farthest / depth) / _GRID) + 8
    radii = depth * np.sinh(np.linspace(0.0, np.arcsinh(farthest / depth), steps))
    k, share = _abscissas(_DECAYED / depth, farthest)
    level, slope = transfer(k, depth, layers)
    current = spectrum(k, outer_radius, inner_radius) * share
    kr = radii[:, None] * k
    zeroth = j0(kr)
    # J₁(kr)/kr, which is 1/2 on the axis.
    first = np.divide(j1(kr), kr, out=np.full_like(kr, 0.5), where=kr > 0)
    k2 = k * k
    profiles = np.column_stack(
        [
            zeroth @ (current * level),
            zeroth @ (current * level * k2),
            -first @ (current * level * k2),
            first @ (current * slope * k2 * k),
        ]
    )
    potential, zz, around, slanted = np.moveaxis(CubicSpline(radii, profiles)(r), -1, 0)
    return around_axis(x, y, potential, zz, around, slanted)


def _abscissas(highest: float, farthest: float) -> tuple[NDArray[np.float64], Array]:
    """Return Gauss points and weights that resolve J₀ out to a radius."""
    period = 2 * np.pi / farthest
    even = np.arange(1, int(np.ceil(highest / period)) + 2) * period
    # Thin resistive layers shape the lowest frequencies: halve the first panel a few times.
    edges = np.concatenate([[0.0], period / 2.0 ** np.arange(8, 0, -1), even])
    nodes, weights = np.polynomial.legendre.leggauss(_POINTS)
    half = np.diff(edges)[:, None] / 2
    return (edges[:-1, None] + half * (nodes + 1)).ravel(), (half * weights).ravel()
