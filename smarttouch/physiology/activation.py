"""The activating-function matrix: effect of every electrode on every node."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from smarttouch.electrodes import ElectrodeArray
from smarttouch.errors import DesignError
from smarttouch.physiology import potential
from smarttouch.physiology.afferents import Afferents
from smarttouch.physiology.potential import Field
from smarttouch.profile import Profile, Skin


def field(
    electrodes: ElectrodeArray,
    skin: Skin,
    position_mm: NDArray[np.float64],
    depth_mm: float | NDArray[np.float64],
) -> tuple[Field, float]:
    """Return the field (N, E) of each electrode per unit cathodic current, and its factor to V/mA.

    Points are (N, 2) mm along the skin, of one depth or, not in layered skin, (N, 1) of their own;
    derivatives get V/mm² by the factor.
    """
    if len(electrodes.kinds) > 1:
        return _field_of_kinds(electrodes, skin, position_mm, depth_mm)
    away = position_mm[:, None, :] - electrodes.position_mm[None, :, :]
    x, y = away[..., 0], away[..., 1]
    ((shape, (outer, inner)),) = electrodes.kinds
    if skin.medium == "plane":
        return potential.line_in_plane(x, depth_mm), 1 / (
            2 * np.pi * skin.conductivity * electrodes.cell_mm[1]
        )
    if shape == "rectangle":
        if skin.layers:
            raise DesignError(
                "layered skin is offered for point, disc and annulus electrodes, not for "
                "rectangles: use medium 'half-space'",
                about="skin.medium",
            )
        found = potential.rectangle(x, y, depth_mm, outer, inner)
    elif skin.layers or shape == "annulus":
        # scipy's interpolation is slow to import, and only these media need it.
        from smarttouch.physiology.layered import round_electrode

        layers = [(layer.thickness_mm, layer.conductivity_s_per_m) for layer in skin.layers]
        radii = (0.0, 0.0) if shape == "point" else (outer / 2, inner / 2)
        depth = np.asarray(depth_mm).item()
        found = round_electrode(x, y, depth, *radii, layers or [(np.inf, 1.0)])
    elif shape == "point":
        found = potential.point(x, y, depth_mm)
    else:
        found = potential.disc(x, y, depth_mm, outer / 2)
    conductivity = 1.0 if skin.layers else skin.conductivity
    half_spaces = 2 if skin.medium == "infinite" else 1
    return found, 1 / (2 * np.pi * conductivity * half_spaces)


def _field_of_kinds(
    electrodes: ElectrodeArray,
    skin: Skin,
    position_mm: NDArray[np.float64],
    depth_mm: float | NDArray[np.float64],
) -> tuple[Field, float]:
    """Return `field` of an array that mixes shapes, from that of each shape alone."""
    whole = Field(*np.zeros((len(Field._fields), len(position_mm), len(electrodes))))
    scale = 1.0
    for (shape, size_mm), which in electrodes.kinds.items():
        # One electrode is no array: the second one's column is not used.
        places = electrodes.position_mm[which]
        if len(which) == 1:
            places = np.vstack([places, places + electrodes.pitch_mm])
        alone = replace(electrodes, position_mm=places, shape=shape, size_mm=size_mm, own=None)
        part, scale = field(alone, skin, position_mm, depth_mm)
        for into, values in zip(whole, part, strict=True):
            into[:, which] = values[:, : len(which)]
    return whole, scale


def af_matrix(
    profile: Profile, afferents: Afferents, skin: Skin | None = None
) -> NDArray[np.float64]:
    """Return the AF (D·N, E), V/mm² per mA of cathodic current, at nodes, direction by direction.

    Positive depolarizes (Eq. 8 and 9). An active ending has no curvature: it is driven by the
    current from its only neighbor, one internode away (McNeal's end node).
    """
    skin = skin or profile.skin
    here, scale = field(profile.electrodes, skin, afferents.position_mm, afferents.depth_mm)
    rows = []
    for direction in afferents.direction:
        if afferents.ending == "active":
            step = skin.internode_mm
            beside = replace(
                afferents,
                position_mm=afferents.position_mm + step * direction[:2],
                depth_mm=float(afferents.depth_mm + step * direction[2]),
            )
            next_one, _ = field(profile.electrodes, skin, beside.position_mm, beside.depth_mm)
            rows.append((next_one.potential - here.potential) / step**2)
        else:
            rows.append(here.along(direction))
    return np.asarray(scale * np.concatenate(rows))


def potential_mv(
    profile: Profile, points_mm: NDArray[np.float64], electrodes: ElectrodeArray | None = None
) -> NDArray[np.float64]:
    """Return the potential (..., E), mV per mA of cathodic current, at points (..., 3) mm.

    It is negative under a cathode. Skin must be homogeneous: layered fields have one depth each.
    """
    electrodes, skin = electrodes or profile.electrodes, profile.skin
    if skin.layers:
        raise DesignError(
            "a finger of layered skin is not offered: give the profile a homogeneous medium, "
            "'half-space' or 'infinite'",
            about="skin.medium",
        )
    flat, depth = points_mm.reshape(-1, 3)[:, :2], points_mm.reshape(-1, 3)[:, 2:]
    if skin.medium != "plane" and {shape for shape, _ in electrodes.kinds} <= {"disc", "annulus"}:
        r2, across = (flat[:, k, None] - electrodes.position_mm[:, k] for k in (0, 1))
        r2 *= r2
        across *= across
        r2 += across
        half_spaces = 2 if skin.medium == "infinite" else 1
        scale = 1 / (2 * np.pi * skin.conductivity * half_spaces)
        found = np.sqrt(r2, out=r2)
        alone = len(electrodes.kinds) == 1
        for (shape, (outer, inner)), those in electrodes.kinds.items():
            # All of them without a copy.
            which = slice(None) if alone else those
            if shape == "disc":
                found[:, which] = potential.disc_potential(found[:, which], depth, outer / 2)
            else:
                r = found[:, which]
                found[:, which] = potential.annulus_potential(r, depth, outer / 2, inner / 2)
        found *= -1000 * scale
    else:
        fields, scale = field(electrodes, skin, flat, depth)
        found = 1000 * scale * fields.potential
    return np.asarray(found.reshape(*points_mm.shape[:-1], len(electrodes)))
