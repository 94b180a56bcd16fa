"""Potential and curvature of one electrode in homogeneous skin, in closed form.

The activating function of an axon is the second derivative of the potential
along it (Eq. 2); the cable equation wants the potential itself. Both come from
here, for a unit **cathodic** current: the potential is negative, and under the
electrode a horizontal axon is depolarized (its curvature is positive), a
vertical one hyperpolarized.

Lengths are in mm. Fields are per factor ρI/2π of a half space with the
electrode on its insulated surface; in an infinite medium they are half of that.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Field(NamedTuple):
    """Potential (1/mm) and second derivatives (1/mm³); x and y run along the skin, z into it."""

    potential: Array
    xx: Array
    yy: Array
    zz: Array
    xy: Array
    xz: Array
    yz: Array

    def along(self, direction: Array) -> Array:
        """Return the second derivative along a unit vector (3,): an axon's Eq. 2."""
        a, b, c = (float(part) for part in direction)
        terms = (
            (a * a, self.xx), (b * b, self.yy), (c * c, self.zz),
            (2 * a * b, self.xy), (2 * a * c, self.xz), (2 * b * c, self.yz),
        )  # fmt: skip
        total = np.zeros_like(self.potential)
        for factor, values in terms:
            if abs(factor) > 1e-15:
                total += factor * values
        return total


def around_axis(
    x: Array, y: Array, potential: Array, zz: Array, around: Array, slanted: Array
) -> Field:
    """Return the cathodic field of an anodic potential that is symmetric about the z axis, from Φ,
    ∂²Φ/∂z², (∂Φ/∂r)/r and (∂²Φ/∂r∂z)/r, the latter two finite on the axis."""
    r2 = x * x + y * y
    # ∂²Φ/∂r² follows from Laplace's equation; on the axis it equals (∂Φ/∂r)/r.
    stretch = np.divide(-zz - 2 * around, r2, out=np.zeros_like(r2), where=r2 > 1e-12)
    return Field(
        -potential, -(around + x * x * stretch), -(around + y * y * stretch), -zz,
        -(x * y * stretch), -(x * slanted), -(y * slanted),
    )  # fmt: skip


def line_in_plane(x: Array, depth: float | Array) -> Field:
    """Return the field, per ρI/2πL, of a line source in the paper's two-dimensional medium.

    Eq. 3 to 5: Φ = −log R, ∂²Φ/∂x² ∝ (y² − x²) / (x² + y²)² with y the depth; Φ without unit up to
    a constant, derivatives in 1/mm². L is the line's length.
    """
    r2 = x * x + depth * depth
    xx = (depth * depth - x * x) / r2**2
    zero = np.zeros_like(x)
    return Field(np.log(r2) / 2, xx, zero, -xx, zero, -2 * x * depth / r2**2, zero)


def point(x: Array, y: Array, depth: float | Array) -> Field:
    """Return the field of a point electrode, Φ = 1/R."""
    r2 = x * x + y * y + depth * depth
    cube = r2**-1.5
    fifth = cube / r2
    return around_axis(
        x, y, r2**-0.5, (3 * depth * depth - r2) * fifth, -cube, 3 * depth * fifth
    )  # fmt: skip


def disc(x: Array, y: Array, depth: float | Array, radius: float) -> Field:
    """Return the field of a disc at one potential (Weber's disc), of radius a.

    Its potential is that of point sources spread evenly along an imaginary line, Φ = 1/(2a) ∫ ds /
    √(r² + (z + is)²) over −a..a, in closed form Φ = arcsin(2a / (√((r−a)²+z²) + √((r+a)²+z²))) / a
    (Wiley and Webster 1982). With ζ = z + ia and S = √(r² + ζ²) its derivatives close as well:
    ∂²Φ/∂z² = −Im(ζ/S³)/a, (∂Φ/∂r)/r = Im(1/(S(ζ + S)))/a and (∂²Φ/∂r∂z)/r = −Im(1/S³)/a.
    """
    r2 = x * x + y * y
    zeta = depth + 1j * radius
    s = np.sqrt(r2 + zeta * zeta)
    cube = 1 / s**3
    return around_axis(
        x, y, disc_potential(np.sqrt(r2), depth, radius), -(zeta * cube).imag / radius,
        (1 / (s * (zeta + s))).imag / radius, -cube.imag / radius,
    )  # fmt: skip


def disc_potential(r: Array, depth: float | Array, radius: float) -> Array:
    """Return the (anodic) potential alone of `disc`, at distances r from its axis."""
    below = np.asarray(depth * depth)
    size = np.broadcast_shapes(np.shape(r), below.shape)
    # In place: new memory for each of millions of values takes longer than the sums.
    span, outer = np.empty(size), np.empty(size)
    for found, away in ((span, -radius), (outer, radius)):
        np.add(r, away, out=found)
        np.square(found, out=found)
        found += below
        np.sqrt(found, out=found)
    span += outer
    np.divide(2 * radius, span, out=span)
    np.arcsin(span, out=span)
    span /= radius
    return span


def annulus(x: Array, y: Array, depth: float | Array, outer: float, inner: float) -> Field:
    """Return the field of an annulus between two radii that passes current evenly."""
    total = np.zeros((len(Field._fields), *np.broadcast_shapes(x.shape, np.shape(depth))))
    for share, radius in _discs_of_annulus(depth, outer, inner):
        total += share * np.array(disc(x, y, depth, radius))
    return Field(*total)


def annulus_potential(r: Array, depth: float | Array, outer: float, inner: float) -> Array:
    """Return the (anodic) potential alone of `annulus`, at distances r from its axis."""
    total = np.zeros(np.broadcast_shapes(np.shape(r), np.shape(depth)))
    for share, radius in _discs_of_annulus(depth, outer, inner):
        total += share * disc_potential(r, depth, radius)
    return total


def _discs_of_annulus(
    depth: float | Array, outer: float, inner: float
) -> list[tuple[float, float]]:
    """Return shares and radii of discs, each at one potential, that add up to an annulus.

    A disc of radius b that passes current evenly is the mean, over angles φ up to π/2, of
    2 sin²φ times Weber's disc of radius b sin φ: the integral of t dt / √((b² − t²)(t² − s²)) over
    s..b is π/2 for every s. The midpoint rule with n angles errs by some exp(−4n arsinh(z/b)).
    """
    discs: list[tuple[float, float]] = []
    for radius, sign in ((outer, 1.0), (inner, -1.0)):
        count = math.ceil(6 / np.arcsinh(np.min(depth) / radius))
        sines = np.sin((np.arange(count) + 0.5) * np.pi / (2 * count))
        shares = sign * radius**2 / (outer**2 - inner**2) * 2 * sines**2 / count
        discs += zip(shares.tolist(), (radius * sines).tolist(), strict=True)
    return discs


def rectangle(x: Array, y: Array, depth: float | Array, width: float, height: float) -> Field:
    """Return the field of a rectangle that passes current evenly, with sides along x and y.

    The integral of 1/R over a rectangle is a sum over its corners of u ln(v + R) + v ln(u + R) − z
    arctan(uv/zR); its second derivatives are algebraic (Durand 1964; in gravimetry the potential of
    a rectangular lamina).
    """
    total = [np.zeros(np.broadcast(x, y).shape) for _ in range(6)]
    z2 = depth * depth
    for sign_u in (1.0, -1.0):
        u = x + sign_u * width / 2
        for sign_v in (1.0, -1.0):
            v = y + sign_v * height / 2
            sign = sign_u * sign_v / (width * height)
            uz, vz = u * u + z2, v * v + z2
            r = np.sqrt(uz + v * v)
            # ln(v + R) as arsinh, which keeps its digits where v is far negative.
            total[0] += sign * (
                u * np.arcsinh(v / np.sqrt(uz))
                + v * np.arcsinh(u / np.sqrt(vz))
                - depth * np.arctan2(u * v, depth * r)
            )
            total[1] -= sign * u * v / (r * uz)
            total[2] -= sign * u * v / (r * vz)
            total[3] += sign / r
            total[4] -= sign * v * depth / (r * uz)
            total[5] -= sign * u * depth / (r * vz)
    potential, xx, yy, xy, xz, yz = total
    return Field(-potential, -xx, -yy, xx + yy, -xy, -xz, -yz)
