"""Curvature of the potential that one electrode makes in the skin.

The activating function of an axon is the second derivative of the potential
along it (Eq. 2), so that is what is given here, in closed form. All functions
are for a unit **cathodic** current: under a cathode a horizontal axon is
depolarized (positive), a vertical one hyperpolarized.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def line_in_plane(x: Array, depth: float) -> Array:
    """Return the horizontal curvature under a line source, per 2π of the factor ρI/L.

    Eq. 5 of the paper: (y² − x²) / (x² + y²)². By Laplace's equation the
    vertical curvature is its negative.

    Parameters
    ----------
    x : ndarray, mm
        Distance along the surface.
    depth : float, mm
        Depth y below the surface.

    Returns
    -------
    ndarray, 1/mm²
    """
    x2, y2 = x * x, depth * depth
    return np.asarray((y2 - x2) / (x2 + y2) ** 2)


def disc_on_half_space(x: Array, y: Array, depth: float, radius: float) -> tuple[Array, ...]:
    """Return the curvatures under an equipotential disc on a half space.

    The disc's potential is that of point sources spread evenly along an
    imaginary line, Φ = 1/(2a) ∫ ds / √(r² + (z + is)²) over −a..a (Weber's
    disc). With ζ = z + ia and S = √(r² + ζ²) the integral of its derivatives
    closes: ∂²Φ/∂z² = −Im(ζ/S³)/a and (∂Φ/∂r)/r = Im(1/(S(ζ + S)))/a, both
    finite on the axis.

    Parameters
    ----------
    x, y : ndarray, mm
        Distances from the disc's center along the surface.
    depth : float, mm
        Depth below the surface.
    radius : float, mm
        Radius a of the disc.

    Returns
    -------
    xx, yy, xy, zz : ndarray, 1/mm³
        Second derivatives per 2π of the factor ρI, for cathodic current.
    """
    r2 = x * x + y * y
    zeta = depth + 1j * radius
    s = np.sqrt(r2 + zeta * zeta)
    zz = -(zeta / s**3).imag / radius
    around = (1 / (s * (zeta + s))).imag / radius
    # ∂²Φ/∂r² follows from Laplace's equation; on the axis the two are equal.
    outward = -zz - around
    stretch = np.divide(outward - around, r2, out=np.zeros_like(r2), where=r2 > 0)
    xx = around + x * x * stretch
    yy = around + y * y * stretch
    xy = x * y * stretch
    return -xx, -yy, -xy, -zz
