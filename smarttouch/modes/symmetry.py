"""Mirrors and turns that leave an array and its afferents as they are."""

import numpy as np
from numpy.typing import NDArray

from smarttouch.nerve.afferents import angles_deg
from smarttouch.primary import Primary
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
"""The symmetries of a square; those of a hexagon beyond them do not keep the node lattice."""


def symmetries(profile: Profile, primary: Primary) -> list[NDArray[np.intp]]:
    """Return the permutations of electrodes that leave the design problem unchanged.

    Returns
    -------
    list of ndarray, (E,)
        ``permutation[e]`` is where electrode e goes. The first is the identity.
    """
    position = profile.electrodes.position_mm
    kept = []
    for matrix in _SQUARE:
        moved = position @ matrix.T
        gaps = np.linalg.norm(moved[:, None, :] - position[None, :, :], axis=2)
        if gaps.min(axis=1).max() < 1e-6 and _keeps_directions(profile, primary, matrix):
            kept.append(np.asarray(gaps.argmin(axis=1), np.intp))
    return kept


def _keeps_directions(profile: Profile, primary: Primary, matrix: NDArray[np.int_]) -> bool:
    def turned(angle: float) -> float:
        radians = np.radians(angle)
        x, y = matrix @ [np.cos(radians), np.sin(radians)]
        return float(np.degrees(np.arctan2(y, x)).round(6) % 180)

    angles = [round(angle % 180, 6) for angle in profile.skin.sai_angles_deg]
    if {turned(angle) for angle in angles} != set(angles):
        return False
    target = angles_deg(profile, primary)[0]
    return target is None or turned(target) == round(target % 180, 6)
