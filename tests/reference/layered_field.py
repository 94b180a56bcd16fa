"""The field of a round electrode on layers, by one linear system of boundary values a frequency.

Falling waves are 1 at the top of their layer and rising ones at its bottom, so that none grows.
"""

from collections.abc import Callable

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from scipy.special import j0, j1

Array = NDArray[np.float64]


def transfer(k: Array, depth: float, layers: list[tuple[float, float]]) -> tuple[Array, Array]:
    """Return T and −(∂T/∂z)/k for k (K,) 1/mm; layers are (mm, S/m), the last one endless."""
    count = len(layers)
    system, right = np.zeros((len(k), 2 * count - 1, 2 * count - 1)), np.zeros(2 * count - 1)
    tops = np.cumsum([0.0, *(thickness for thickness, _ in layers[:-1])])
    right[0] = 1.0
    # Unknown 2i falls and 2i+1 rises in layer i. First the current through the surface.
    system[:, 0, 0] = layers[0][1]
    for i, (thickness, conductivity) in enumerate(layers[:-1]):
        fade, below = np.exp(-k * thickness), layers[i + 1][1]
        if i == 0:
            system[:, 0, 1] = -conductivity * fade
        for row, own, other in ((2 * i + 1, 1.0, 1.0), (2 * i + 2, conductivity, below)):
            sign = 1.0 if row % 2 else -1.0
            system[:, row, 2 * i], system[:, row, 2 * i + 1] = own * fade, sign * own
            system[:, row, 2 * i + 2] = -other
            if i + 2 < count:
                next_fade = np.exp(-k * layers[i + 1][0])
                system[:, row, 2 * i + 3] = -sign * other * next_fade
    waves = np.linalg.solve(system, np.broadcast_to(right[:, None], (len(k), len(right), 1)))
    i = int(np.searchsorted(tops, depth, side="left").clip(min=1)) - 1
    down = waves[:, 2 * i, 0] * np.exp(-k * (depth - tops[i]))
    if i == count - 1:
        return down, down
    up = waves[:, 2 * i + 1, 0] * np.exp(-k * (tops[i + 1] - depth))
    return down + up, down - up


def integral(
    weight: Callable[[Array, Array, Array], Array],
    farthest: float,
    depth: float,
    layers: list[tuple[float, float]],
    outer: float,
    inner: float = 0.0,
) -> Array:
    """Integrate a weight (…, K) of k, T and −(∂T/∂z)/k times the current's spectrum: of a point
    (outer radius 0), a disc (inner radius 0, current as on a half space) or an evenly fed annulus;
    out to some distance from the axis."""
    nodes, shares = leggauss(24)
    period = 2 * np.pi / (farthest + depth + outer)
    edges = np.r_[0, period / 2.0 ** np.arange(14, 0, -1)]
    edges = np.r_[edges, np.arange(1, np.ceil(24 / depth / period) + 1) * period]
    half = np.diff(edges)[:, None] / 2
    k = (edges[:-1, None] + half * (nodes + 1)).ravel()
    if outer == 0:
        current = np.ones_like(k)
    elif inner == 0:
        current = np.sin(k * outer) / (k * outer)
    else:
        area = k * (outer**2 - inner**2) / 2
        current = (outer * j1(k * outer) - inner * j1(k * inner)) / area
    level, slope = transfer(k, depth, layers)
    return np.asarray(weight(k, level, slope) @ (current * (half * shares).ravel()))


def potential(
    r: Array, depth: float, layers: list[tuple[float, float]], outer: float, inner: float = 0.0
) -> Array:
    """Return the anodic potential per I/2π at distances (R,) from the axis."""
    return integral(
        lambda k, level, _: j0(np.outer(r, k)) * level,
        float(np.max(r)),
        depth,
        layers,
        outer,
        inner,
    )
