"""Symmetries that leave an array and its afferents unchanged."""

import numpy as np
from numpy.typing import NDArray

from smarttouch.afferent import Afferent
from smarttouch.physiology.afferents import directions, targets
from smarttouch.profile import Profile

_SQUARE = [
    np.array(matrix)
    for matrix in (
        [[1, 0], [0, 1]],
        [[-1, 0], [0, 1]],
        [[1, 0], [0, -1]],
        [[-1, 0], [0, -1]],
        [[0, 1], [1, 0]],
        [[0, -1], [1, 0]],
        [[0, 1], [-1, 0]],
        [[0, -1], [-1, 0]],
    )
]
"""Symmetries of a square; the further ones of a hexagon do not keep the node lattice."""


def symmetries(profile: Profile, afferent: Afferent) -> list[NDArray[np.intp]]:
    """Return permutations that keep the problem, identity first: e goes to ``permutation[e]``."""
    array = profile.electrodes
    kept = []
    upright = any(shape == "rectangle" and size[0] != size[1] for shape, size in array.kinds)
    kind = np.zeros(len(array))
    for number, which in enumerate(array.kinds.values()):
        kind[which] = number
    for matrix in _SQUARE:
        if upright and matrix[0, 0] == 0:
            continue
        moved = array.position_mm @ matrix.T
        gaps = np.linalg.norm(moved[:, None, :] - array.position_mm[None, :, :], axis=2)
        gaps[kind[:, None] != kind] = np.inf
        if gaps.min(axis=1).max() > 1e-6:
            continue
        aims = targets(profile, afferent).direction
        if _keeps(aims, matrix) and all(
            _keeps(directions(profile.skin, each), matrix) for each in Afferent
        ):
            kept.append(np.asarray(gaps.argmin(axis=1), np.intp))
    return [
        move for move in kept if all(np.array_equal(each[move], each) for each in _own(profile))
    ]


def _own(profile: Profile) -> list[NDArray[np.float64]]:
    """Return properties by which an electrode may differ from its mirror image, (E,) each."""
    limits, own = profile.limits, [profile.admittance]
    if profile.output.masked:
        own.append(np.isin(np.arange(len(profile.electrodes)), profile.driven).astype(np.float64))
    if limits.electrode_ma is not None:
        own.append(np.array(limits.electrode_ma))
    if limits.electrode_ma is not None or profile.design_total_ma is not None:
        # Limits are multiples of a site's full current.
        own.append(np.asarray(profile.threshold_ma, np.float64))
    return own


def _keeps(axons: NDArray[np.float64], matrix: NDArray[np.int_]) -> bool:
    """Return whether a set of directions is unchanged by a symmetry; an axon has no sense."""
    moved = axons.copy()
    moved[:, :2] = axons[:, :2] @ matrix.T
    alike = np.abs(moved @ axons.T)
    return bool(np.all(alike.max(axis=1) > 1 - 1e-9))
