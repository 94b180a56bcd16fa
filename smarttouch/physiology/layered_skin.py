"""Fields of round electrodes on layered skin, by the Hankel transform.

In a stack of layers the potential under an electrode that is round about the
z axis is Φ(r, z) = ∫ S(k) T(k, z) J₀(kr) dk, S the spectrum of the current that
the electrode passes and T what the layers make of it; in a half space of
conductivity σ, T = e^(−kz)/σ. T follows from the transmission-line recursion of
geoelectrics (Koefoed 1979), which holds only falling exponentials and so keeps
its digits for thick layers and thin ones alike.

A finger needs the potential at millions of places of its own depth each: `PotentialTable` holds it
over depth and distance from the axis, by cubic splines of each layer.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import spline_filter
from scipy.special import j0, j1
from threadpoolctl import threadpool_limits

from smarttouch.base.errors import DesignError
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


def _waves(k: Array, layers: Sequence[Layer]) -> list[tuple[float, float, Array, Array]]:
    """Return top and thickness of each layer, mm, and in it the falling wave at its top, mm·m/S
    per unit of current spectrum, and the echo of its bottom; for k 1/mm."""
    # Resistance seen downward from the top of each layer, as on a transmission line.
    seen = [np.full_like(k, 1 / layers[-1][1])]
    for thickness, conductivity in reversed(layers[:-1]):
        own, below = 1 / conductivity, seen[0]
        turn = np.tanh(k * thickness)
        seen.insert(0, own * (below + own * turn) / (own + below * turn))
    potential, top, found = seen[0], 0.0, []
    for index, (thickness, conductivity) in enumerate(layers[:-1]):
        own, below = 1 / conductivity, seen[index + 1]
        echo = (below - own) / (below + own)
        falling = potential / (1 + echo * np.exp(-2 * k * thickness))
        found.append((top, thickness, falling, echo))
        potential = falling * (1 + echo) * np.exp(-k * thickness)
        top += thickness
    return [*found, (top, np.inf, potential, np.zeros_like(k))]


def transfer(k: Array, depth: float, layers: Sequence[Layer]) -> tuple[Array, Array]:
    """Return T and −(∂T/∂z)/k at a depth, mm·m/S per unit of current spectrum, for k 1/mm."""
    waves = _waves(k, layers)
    top, thickness, falling, echo = next(each for each in waves if depth <= each[0] + each[1])
    down = np.exp(-k * (depth - top))
    up = echo * np.exp(-k * (2 * thickness - (depth - top)))
    return falling * (down + up), falling * (down - up)


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


def _abscissas(
    highest: float, farthest: float, points: int = _POINTS
) -> tuple[NDArray[np.float64], Array]:
    """Return Gauss points and weights that resolve J₀ out to a radius."""
    period = 2 * np.pi / farthest
    even = np.arange(1, int(np.ceil(highest / period)) + 2) * period
    # Thin resistive layers shape the lowest frequencies: halve the first panel a few times.
    edges = np.concatenate([[0.0], period / 2.0 ** np.arange(8, 0, -1), even])
    nodes, weights = np.polynomial.legendre.leggauss(points)
    half = np.diff(edges)[:, None] / 2
    return (edges[:-1, None] + half * (nodes + 1)).ravel(), (half * weights).ravel()


_SHALLOWEST_MM = 0.15
"""Least depth of a table: below the surface the field of a disc's edge has no end."""
_FARTHEST_MM, _DEEPEST_MM = 64.0, 16.0
"""Least reach of a table; larger ones are made for arrays that need them."""
_STEP = 0.02
"""Spacing of a table's depths, relative to the depth, and of its distances, far away."""
_NEAR_MM = 0.008
"""Spacing of a table's distances under the electrode."""
_PAD = 12
"""Places beyond the ends of a table: what its splines do at their ends has faded within."""
_FADED = 17.0
"""Value of kz at which e^−kz ends a table's integral: 4e-8."""
_AT_ONCE = 256


class PotentialTable:
    """Potential of a round electrode over depth and distance from its axis, in layered skin.

    Splines are uniform in the logarithm of depth and in arsinh(r/s), with s the radius of the
    electrode; each layer has its own, as the potential bends sharply between layers.
    """

    def __init__(
        self,
        radii_mm: tuple[float, float],  # outer and inner, see `spectrum`
        layers: tuple[Layer, ...],
        farthest_mm: float,
        deepest_mm: float,
    ) -> None:
        self._wide_mm = max(radii_mm[0], 0.2)
        self._step = min(_STEP, _NEAR_MM / self._wide_mm)
        across = int(np.arcsinh(farthest_mm / self._wide_mm) / self._step) + 2 + _PAD
        self._r_mm = self._wide_mm * np.sinh(np.arange(across) * self._step)
        bottoms = np.minimum(np.cumsum([thickness for thickness, _ in layers]), deepest_mm)
        tops = np.r_[0.0, bottoms[:-1]]
        # Layers that end above the shallowest depth or begin below the deepest are not looked at.
        self._seen = np.flatnonzero((bottoms > _SHALLOWEST_MM) & (tops < bottoms))
        self._bottom_mm = bottoms[self._seen]
        first = np.log(np.maximum(tops[self._seen], _SHALLOWEST_MM)) - _PAD * _STEP
        down = np.ceil((np.log(self._bottom_mm) - first) / _STEP).astype(int) + 1 + _PAD
        self._first, self._rows = first, np.r_[0, np.cumsum(down)]
        depths = [
            np.exp(begin + np.arange(count) * _STEP)
            for begin, count in zip(first, down, strict=True)
        ]
        table = self._integrals(radii_mm, layers, depths)
        parts = np.split(table, self._rows[1:-1])
        self._splines = np.concatenate([_coefficients(each) for each in parts])

    def _integrals(
        self, radii_mm: tuple[float, float], layers: tuple[Layer, ...], depths: list[Array]
    ) -> Array:
        """Return the potential at all depths and distances, (D, R), per I/2π; layers go on beyond
        their ends, so that their splines do."""
        found = np.zeros((self._rows[-1], len(self._r_mm)))
        # The wave from the bottom of a layer grows below it.
        fades = [np.minimum(z, 2 * end - z) for z, end in zip(depths, self._bottom_mm, strict=True)]
        fades[-1] = depths[-1]
        reach = np.concatenate(fades)
        k, share = _abscissas(_FADED / reach.min(), float(self._r_mm[-1]), points=8)
        for begin in range(0, len(k), 1024):
            part = k[begin : begin + 1024]
            waves = _waves(part, layers)
            rows, active = [], np.flatnonzero(reach * part[0] < _FADED)
            for number, z in enumerate(depths):
                top, thickness, falling, echo = waves[self._seen[number]]
                inside = reach[self._rows[number] : self._rows[number + 1]] * part[0] < _FADED
                below = (z[inside] - top)[:, None]
                wave = np.exp(-part * below)
                if np.isfinite(thickness):
                    wave += echo * np.exp(-part * (2 * thickness - below))
                rows.append(falling * wave)
            current = spectrum(part, *radii_mm) * share[begin : begin + 1024]
            found[active] += (np.concatenate(rows) * current) @ j0(np.outer(part, self._r_mm))
        return found

    def at(self, r_mm: Array, depth_mm: Array) -> Array:
        """Return the (anodic) potential per I/2π, (N, E), at distances (N, E) and depths (N,)."""
        found = np.empty(r_mm.shape)
        layer = np.searchsorted(self._bottom_mm, depth_mm).clip(max=len(self._bottom_mm) - 1)
        down = (np.log(depth_mm) - self._first[layer]) / _STEP
        row = down.astype(np.intp)
        weights = _cubic(down - row)
        row += self._rows[layer] - 1
        count = self._splines.shape[1]
        for begin in range(0, len(r_mm), _AT_ONCE):
            part = slice(begin, begin + _AT_ONCE)
            # First a spline along the distance for each depth, then its value for each electrode.
            lines = np.zeros((len(row[part]), count))
            for index, weight in enumerate(weights):
                lines += weight[part, None] * self._splines[row[part] + index]
            along = np.arcsinh(r_mm[part] / self._wide_mm)
            along /= self._step
            left = along.astype(np.intp)
            along -= left
            left += np.arange(len(left))[:, None] * count
            value = found[part]
            value[:] = 0
            for index, weight in enumerate(_cubic(along)):
                weight *= lines.ravel()[left + index]
                value += weight
        return found


def _coefficients(values: Array) -> Array:
    """Return the coefficients of cubic splines through values at whole numbers, (D, R + 1): one
    more comes before the first distance, from its mirror image."""
    found = spline_filter(values, order=3, mode="mirror")
    return np.column_stack([found[:, 1], found])


def _cubic(part: Array) -> tuple[Array, Array, Array, Array]:
    """Return the weights of four coefficients at a part of the way from the second to the third."""
    square = part * part
    last = square * part
    last /= 6
    third = square + part
    third /= 2
    third += 1 / 6
    third -= 3 * last
    first = 1 - part
    first *= first * first / 6
    return first, 1 - first - third - last, third, last


@lru_cache(maxsize=8)
def potential_table(
    radii_mm: tuple[float, float], layers: tuple[Layer, ...], farthest_mm: float, deepest_mm: float
) -> PotentialTable:
    """Return the table of an electrode on layers that reaches as far as asked; eight are kept."""
    # Threads would take three times the time, and might not give the same last digits.
    with threadpool_limits(limits=1, user_api="blas"):
        return PotentialTable(radii_mm, layers, farthest_mm, deepest_mm)


def layered_potential(
    r_mm: Array, depth_mm: Array, radii_mm: tuple[float, float], layers: Sequence[Layer]
) -> Array:
    """Return the (anodic) potential per I/2π, (N, E), at distances (N, E) from the axis of a round
    electrode and depths (N,); DesignError above the shallowest depth of tables."""
    if (shallowest := float(depth_mm.min(initial=np.inf))) < _SHALLOWEST_MM:
        raise DesignError(
            f"a depth of {shallowest:g} mm is too shallow for the potential in layered skin: give "
            f"{_SHALLOWEST_MM:g} mm at least"
        )
    farthest, deepest = (
        least * 2.0 ** np.ceil(np.log2(max(1.0, float(found.max(initial=0)) / least)))
        for least, found in ((_FARTHEST_MM, r_mm), (_DEEPEST_MM, depth_mm))
    )
    return potential_table(radii_mm, tuple(layers), farthest, deepest).at(r_mm, depth_mm)
