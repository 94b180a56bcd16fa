"""Where the afferents of a profile run, and at which points they may fire."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.primary import Primary
from smarttouch.profile import Profile

_MARGIN_PITCHES = {"plane": 2.0, "half-space": 1.0}
"""How far beyond the outer electrodes afferents are considered; 2 is the paper's −5..5 mm."""


@dataclass(frozen=True, eq=False)
class Afferents:
    """Nodes of Ranvier of one class and one direction.

    Attributes
    ----------
    primary : Primary
        Whose they are.
    position_mm : ndarray, (N, 2) float64, mm
        Places along the skin.
    depth_mm : float, mm
        Depth below the surface.
    angle_deg : float or None, degrees
        Direction of horizontal axons in the plane, from x toward y; None for
        axons that rise vertically.
    """

    primary: Primary
    position_mm: NDArray[np.float64]
    depth_mm: float
    angle_deg: float | None


def depth_mm(profile: Profile, primary: Primary) -> float:
    """Return the depth at which a class is reached (Section II-D)."""
    skin = profile.skin
    return (skin.ra_depth_mm, skin.sai_depth_mm, skin.pc_depth_mm)[primary]


def angles_deg(profile: Profile, primary: Primary) -> tuple[float | None, ...]:
    """Return the directions of a class: RA rises vertically, SAI and PC lie flat (Fig. 7)."""
    return (None,) if primary is Primary.RA else profile.skin.sai_angles_deg


def targets(profile: Profile, primary: Primary) -> Afferents:
    """Return the node under each electrode that its kernel is to fire."""
    return Afferents(
        primary,
        profile.electrodes.position_mm,
        depth_mm(profile, primary),
        angles_deg(profile, primary)[0],
    )


def everywhere(profile: Profile, primary: Primary) -> list[Afferents]:
    """Return the nodes of a class all over the array, one set for each direction."""
    spacing = profile.skin.node_spacing_mm
    if profile.skin.medium == "plane" and primary is Primary.RA:
        # The paper's RA axons stand one pitch apart, however finely nodes lie along SAI and PC.
        spacing = profile.electrodes.pitch_mm
    position = _lattice(profile, spacing)
    depth = depth_mm(profile, primary)
    return [Afferents(primary, position, depth, angle) for angle in angles_deg(profile, primary)]


def _lattice(profile: Profile, spacing_mm: float) -> NDArray[np.float64]:
    electrodes = profile.electrodes
    plane = profile.skin.medium == "plane"
    margin = _MARGIN_PITCHES[profile.skin.medium] * electrodes.pitch_mm
    reach = np.abs(electrodes.position_mm).max(axis=0) + margin
    axes = []
    for half in reach:
        steps = int(np.floor(2 * half / spacing_mm + 1e-9))
        axes.append((np.arange(steps + 1) - steps / 2) * spacing_mm)
    x, y = np.meshgrid(axes[0], [0.0] if plane else axes[1])
    return np.column_stack([x.ravel(), y.ravel()])
