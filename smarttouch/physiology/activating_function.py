"""The activating-function matrix: effect of every electrode on every node of a course."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.physiology import potential
from smarttouch.physiology.potential import Field
from smarttouch.profile import Profile, Skin
from smarttouch.profile.electrodes import ElectrodeArray

_MARGIN_PITCHES = {"plane": 2.0}
"""Margin of afferents beyond the outer electrodes, in pitches; 2 is the paper's −5..5 mm."""


@dataclass(frozen=True, eq=False)
class Afferents:
    """Nodes of Ranvier of one class at one depth, at N places in D directions each."""

    afferent: Afferent
    position_mm: NDArray[np.float64]  # (N, 2) along the skin
    depth_mm: float  # below the surface
    direction: NDArray[np.float64]  # (D, 3) unit vectors along the axons; z points into the skin
    ending: str | None  # whether axons that end here can fire there; None where they run on
    grid: tuple[int, int]  # rows and columns of a lattice of places, else (N, 1)

    def __post_init__(self) -> None:
        if not self.depth_mm > 0:
            raise DesignError(
                f"a {self.afferent.name} fiber at a depth of {self.depth_mm:g} mm lies outside "
                "the skin: depths are measured below the surface, above 0"
            )


def depth_mm(skin: Skin, afferent: Afferent) -> float:
    """Return the depth at which a class is reached (Section II-D)."""
    return (skin.ra_depth_mm, skin.sai_depth_mm, skin.pc_depth_mm)[afferent]


def directions(skin: Skin, afferent: Afferent) -> NDArray[np.float64]:
    """Return the directions of a class, (D, 3): RA rises, SAI and PC lie flat (Fig. 7)."""
    if afferent is Afferent.RA:
        return np.array([[0.0, 0.0, 1.0]])
    return flat_directions(skin.sai_angles_deg)


def flat_directions(angles_deg: tuple[float, ...]) -> NDArray[np.float64]:
    """Return unit vectors in the plane of the skin, (D, 3); angles from x toward y."""
    radians = np.radians(angles_deg)
    return np.column_stack([np.cos(radians), np.sin(radians), np.zeros(len(radians))])


def targets(profile: Profile, afferent: Afferent) -> Afferents:
    """Return the node under each electrode that its kernel is to fire."""
    position, skin = profile.electrodes.position_mm, profile.skin
    direction = directions(skin, afferent)[:1]
    depth = depth_mm(skin, afferent)
    return Afferents(
        afferent, position, depth, direction, _ending(skin, afferent), (len(position), 1)
    )


def everywhere(profile: Profile, afferent: Afferent) -> Afferents:
    """Return the nodes of a class all over the array, in all its directions."""
    spacing = profile.skin.node_spacing_mm
    if profile.skin.medium == "plane" and afferent is Afferent.RA:
        # The paper's RA axons stand one pitch apart, however finely nodes lie along SAI and PC.
        spacing = profile.electrodes.pitch_mm
    position, grid = _lattice(profile, spacing)
    skin = profile.skin
    return Afferents(
        afferent, position, depth_mm(skin, afferent), directions(skin, afferent),
        _ending(skin, afferent), grid,
    )  # fmt: skip


def along_axon(profile: Profile, afferent: Afferent, site: int) -> tuple[Afferents, ...]:
    """Return the nodes of the axon under a site, one set for each depth, the one under the
    electrode first: a rising axon has its nodes below the ending, a flat one on both sides."""
    center = profile.electrodes.position_mm[site]
    skin, first = profile.skin, targets(profile, afferent)
    direction = first.direction[0]
    spacing = skin.node_spacing_mm
    sets: list[tuple[NDArray[np.float64], float, str | None]]
    if direction[2] == 0:
        # As far as nodes of other axons are looked at.
        most = _reach_mm(profile) + 1e-9
        steps = np.arange(1, int(2 * most.max() / spacing) + 1) * spacing
        away = np.concatenate([[0.0], steps, -steps])
        position = center + away[:, None] * direction[:2]
        inside = (np.abs(position) <= most).all(axis=1)
        sets = [(position[inside], first.depth_mm, None)]
    else:
        below = np.arange(1, max(1, int(2 * profile.electrodes.pitch_mm / spacing)) + 1) * spacing
        sets = [(center[None], first.depth_mm, first.ending)]
        sets += [(center[None], first.depth_mm + each, None) for each in below]
    return tuple(
        Afferents(afferent, position, depth, first.direction, ending, (len(position), 1))
        for position, depth, ending in sets
    )


def _ending(skin: Skin, afferent: Afferent) -> str | None:
    return skin.ra_ending if afferent is Afferent.RA else None


def _reach_mm(profile: Profile) -> NDArray[np.float64]:
    """Return how far from the array's middle nodes are looked at, (2,) mm."""
    electrodes = profile.electrodes
    margin = _MARGIN_PITCHES.get(profile.skin.medium, 1.0) * electrodes.pitch_mm
    return np.asarray(np.abs(electrodes.position_mm).max(axis=0) + margin)


def _lattice(profile: Profile, spacing_mm: float) -> tuple[NDArray[np.float64], tuple[int, int]]:
    plane, reach = profile.skin.medium == "plane", _reach_mm(profile)
    axes = []
    for half in reach:
        steps = int(np.floor(2 * half / spacing_mm + 1e-9))
        axes.append((np.arange(steps + 1) - steps / 2) * spacing_mm)
    x, y = np.meshgrid(axes[0], [0.0] if plane else axes[1])
    return np.column_stack([x.ravel(), y.ravel()]), x.shape


def field_at(
    electrodes: ElectrodeArray,
    skin: Skin,
    position_mm: NDArray[np.float64],
    depth_mm: float | NDArray[np.float64],
) -> tuple[Field, float]:
    """Return the field (N, E) of each electrode per unit cathodic current, and its factor to V/mA.

    Points are (N, 2) mm along the skin, of one depth or (N, 1) of their own; derivatives get V/mm²
    by the factor.
    """
    if len(electrodes.kinds) > 1:
        return _field_of_kinds(electrodes, skin, position_mm, depth_mm)
    away = position_mm[:, None, :] - electrodes.position_mm[None, :, :]
    x, y = away[..., 0], away[..., 1]
    ((shape, (outer, inner)),) = electrodes.kinds
    if skin.medium == "plane":
        return potential.line_in_plane(x, depth_mm), 1 / (
            2 * np.pi * skin.conductivity_s_per_m * electrodes.cell_mm[1]
        )
    if shape == "rectangle":
        found = potential.rectangle(x, y, depth_mm, outer, inner)
    elif shape == "annulus":
        found = potential.annulus(x, y, depth_mm, outer / 2, inner / 2)
    elif shape == "point":
        found = potential.point(x, y, depth_mm)
    else:
        found = potential.disc(x, y, depth_mm, outer / 2)
    return found, _volts(skin)


def _field_of_kinds(
    electrodes: ElectrodeArray,
    skin: Skin,
    position_mm: NDArray[np.float64],
    depth_mm: float | NDArray[np.float64],
) -> tuple[Field, float]:
    """Return `field_at` of an array that mixes shapes, from that of each shape alone."""
    whole = Field(*np.zeros((len(Field._fields), len(position_mm), len(electrodes))))
    scale = 1.0
    for (shape, size_mm), which in electrodes.kinds.items():
        # One electrode is no array: the second one's column is not used.
        places = electrodes.position_mm[which]
        if len(which) == 1:
            places = np.vstack([places, places + electrodes.pitch_mm])
        alone = replace(electrodes, position_mm=places, shape=shape, size_mm=size_mm, own=None)
        part, scale = field_at(alone, skin, position_mm, depth_mm)
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
    here, scale = field_at(profile.electrodes, skin, afferents.position_mm, afferents.depth_mm)
    rows = []
    for direction in afferents.direction:
        if afferents.ending == "active":
            step = skin.internode_mm
            beside = replace(
                afferents,
                position_mm=afferents.position_mm + step * direction[:2],
                depth_mm=float(afferents.depth_mm + step * direction[2]),
            )
            next_one, _ = field_at(profile.electrodes, skin, beside.position_mm, beside.depth_mm)
            rows.append((next_one.potential - here.potential) / step**2)
        else:
            rows.append(here.along(direction))
    return np.asarray(scale * np.concatenate(rows))


def potential_mv(profile: Profile, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the potential (..., E), mV per mA of cathodic current, at points (..., 3) mm.

    It is negative under a cathode.
    """
    electrodes, skin = profile.electrodes, profile.skin
    flat, depth = points_mm.reshape(-1, 3)[:, :2], points_mm.reshape(-1, 3)[:, 2:]
    closed = {shape for shape, _ in electrodes.kinds} <= {"disc", "annulus"}
    if skin.medium != "plane" and closed:
        r2, across = (flat[:, k, None] - electrodes.position_mm[:, k] for k in (0, 1))
        r2 *= r2
        across *= across
        r2 += across
        found, scale = np.sqrt(r2, out=r2), _volts(skin)
        alone = len(electrodes.kinds) == 1
        for (shape, (outer, inner)), those in electrodes.kinds.items():
            # All of them without a copy.
            which = slice(None) if alone else those
            if shape == "disc":
                found[:, which] = potential.disc_potential(found[:, which], depth, outer / 2)
            else:
                found[:, which] = potential.annulus_potential(
                    found[:, which], depth, outer / 2, inner / 2
                )
        found *= -1000 * scale
    else:
        fields, scale = field_at(electrodes, skin, flat, depth)
        found = 1000 * scale * fields.potential
    return np.asarray(found.reshape(*points_mm.shape[:-1], len(electrodes)))


def _volts(skin: Skin) -> float:
    """Return the factor from fields per I/2π to V/mA."""
    return 1 / (2 * np.pi * skin.conductivity_s_per_m * (2 if skin.medium == "infinite" else 1))
