"""Kernels of discs on a half space, written apart: potential, activating function, both optima.

Weber's disc of radius a in skin of conductivity σ has the potential I/(2πσa) arcsin(2a / (√((r−a)²
+ z²) + √((r+a)² + z²))); its activating function is the second difference along the
axon. The optimum is first the least t = max A w of other classes with own rows at most `SPILL`,
then the least spill with t at most 3 % above. Only numpy and scipy's linprog, nothing of the
package.
"""

import numpy as np
from scipy.optimize import linprog

SPILL, GIVEN_UP = 0.2, 0.03
_STEP_MM = 1e-3
_SIGMA = 0.43


def potential(away_mm, depth_mm, radius_mm):
    """Return the potential of 1 mA, V, at distances (N, E) from the axes of cathodic discs."""
    near = np.hypot(away_mm - radius_mm, depth_mm)
    far = np.hypot(away_mm + radius_mm, depth_mm)
    return -np.arcsin(2 * radius_mm / (near + far)) / (2 * np.pi * _SIGMA * radius_mm)


def activating(places_mm, depth_mm, direction, electrodes_mm, radius_mm):
    """Return the AF of places (N, 2) and one direction (3,), (N, E) V/mm² per mA."""

    def at(step):
        there = places_mm + step * np.asarray(direction[:2])
        away = np.linalg.norm(there[:, None] - electrodes_mm, axis=2)
        return potential(away, depth_mm + step * direction[2], radius_mm)

    return (at(_STEP_MM) - 2 * at(0.0) + at(-_STEP_MM)) / _STEP_MM**2


def lattice(electrodes_mm, pitch_mm, spacing_mm):
    """Return places up to a pitch beyond the outer electrodes, (N, 2) mm."""
    reach = np.abs(electrodes_mm).max(axis=0) + pitch_mm
    steps = [int(np.floor(2 * each / spacing_mm + 1e-9)) for each in reach]
    axes = [(np.arange(n + 1) - n / 2) * spacing_mm for n in steps]
    x, y = np.meshgrid(*axes)
    return np.column_stack([x.ravel(), y.ravel()])


def optima(target, others, own, axon):
    """Return the least worst other, and the least spill within 3 % of it, over the target's.

    Rows (…, E) are of the target's node, all other classes, the own one far away, and the target's
    axon.
    """
    count, scale = len(target), np.abs(target).max()
    others, own, axon, aim = (each / scale for each in (others, own, axon, target))

    def least(of_t, of_bound, bounds):
        rows = np.vstack([np.c_[of_t, -np.ones(len(of_t))]] + [
            np.c_[each, np.zeros(len(each))] for each in of_bound
        ])  # fmt: skip
        upper = np.concatenate([np.zeros(len(of_t)), *bounds])
        # Rows that alone decide are few: begin with some, add what is broken.
        kept = np.zeros(len(rows), bool)
        kept[np.unique(np.r_[rows.argmax(axis=0), rows.argmin(axis=0)])] = True
        while True:
            answer = linprog(
                np.r_[np.zeros(count), 1], rows[kept], upper[kept],
                np.vstack([np.r_[aim, 0], np.r_[np.ones(count), 0]]), [1, 0],
                bounds=[(-1e3, 1e3)] * count + [(0, None)],
            )  # fmt: skip
            excess = rows @ answer.x - upper
            if excess.max() < 1e-8:
                return answer.fun
            kept[np.argsort(excess)[-100:][np.sort(excess)[-100:] > 1e-8]] = True

    best = least(others, [own, axon], [np.full(len(own), SPILL), np.ones(len(axon))])
    most = best * (1 + GIVEN_UP)
    return best, least(own, [others, axon], [np.full(len(others), most), np.ones(len(axon))])
