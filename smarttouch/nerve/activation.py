"""The activating-function matrix: what every electrode does to every node."""

import numpy as np
from numpy.typing import NDArray

from smarttouch.nerve.afferents import Afferents
from smarttouch.nerve.potential import disc_on_half_space, line_in_plane
from smarttouch.profile import Profile


def af_matrix(profile: Profile, afferents: Afferents) -> NDArray[np.float64]:
    """Return the AF matrix of a set of nodes (Eq. 8 and 9).

    Parameters
    ----------
    profile : Profile
        Array and skin.
    afferents : Afferents
        The N nodes.

    Returns
    -------
    ndarray, (N, E) float64, V/mm² per mA
        Activating function at each node for unit cathodic current at each
        electrode; positive depolarizes.
    """
    electrodes = profile.electrodes
    away = afferents.position_mm[:, None, :] - electrodes.position_mm[None, :, :]
    x, y = away[..., 0], away[..., 1]
    factor = 1 / (2 * np.pi * profile.skin.conductivity_s_per_m)
    if profile.skin.medium == "plane":
        horizontal = line_in_plane(x, afferents.depth_mm) * (factor / electrodes.cell_mm[1])
        return -horizontal if afferents.angle_deg is None else horizontal
    radius = electrodes.diameter_mm / 2
    xx, yy, xy, zz = disc_on_half_space(x, y, afferents.depth_mm, radius)
    if afferents.angle_deg is None:
        return np.asarray(factor * zz)
    angle = np.radians(afferents.angle_deg)
    cos, sin = np.cos(angle), np.sin(angle)
    return np.asarray(factor * (cos * cos * xx + sin * sin * yy + 2 * cos * sin * xy))
