"""Courses of a profile's afferents, and the points at which they may fire."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.afferent import Afferent
from smarttouch.errors import DesignError
from smarttouch.profile import Profile, Skin

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
                "the skin: depths are measured below the surface, above 0",
                about="depth_mm",
            )


def depth_mm(skin: Skin, afferent: Afferent) -> float:
    """Return the depth at which a class is reached (Section II-D)."""
    return (skin.ra_depth_mm, skin.sai_depth_mm, skin.pc_depth_mm)[afferent]


def directions(skin: Skin, afferent: Afferent) -> NDArray[np.float64]:
    """Return the directions of a class, (D, 3): RA rises, SAI and PC lie flat (Fig. 7)."""
    if afferent is Afferent.RA:
        return np.array([[0.0, 0.0, 1.0]])
    return flat(skin.sai_angles_deg)


def flat(angles_deg: tuple[float, ...]) -> NDArray[np.float64]:
    """Return unit vectors in the plane of the skin, (D, 3); angles from x toward y."""
    radians = np.radians(angles_deg)
    return np.column_stack([np.cos(radians), np.sin(radians), np.zeros(len(radians))])


def tilted(tilt_deg: float) -> NDArray[np.float64]:
    """Return the vertical and four directions that lean from it, (5, 3)."""
    sin, cos = np.sin(np.radians(tilt_deg)), np.cos(np.radians(tilt_deg))
    return np.array([[0, 0, 1], [sin, 0, cos], [-sin, 0, cos], [0, sin, cos], [0, -sin, cos]])


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
        afferent,
        position,
        depth_mm(skin, afferent),
        directions(skin, afferent),
        _ending(skin, afferent),
        grid,
    )


def along_axon(profile: Profile, afferent: Afferent, site: int) -> tuple[Afferents, ...]:
    """Return the nodes of the axon under a site, one set for each depth, the one under the
    electrode first: a rising axon has its nodes below the ending, a flat one on both sides."""
    center = profile.electrodes.position_mm[site]
    skin, first = profile.skin, targets(profile, afferent)
    direction = first.direction[0]
    reach = 2 * profile.electrodes.pitch_mm
    steps = max(1, int(reach / skin.node_spacing_mm))
    along = np.arange(1, steps + 1) * skin.node_spacing_mm
    sets: list[tuple[NDArray[np.float64], float, str | None]]
    if direction[2] == 0:
        away = np.concatenate([[0.0], along, -along])
        position = center + away[:, None] * direction[:2]
        sets = [(position, first.depth_mm, None)]
    else:
        sets = [(center[None], first.depth_mm, first.ending)]
        sets += [(center[None], first.depth_mm + each, None) for each in along]
    return tuple(
        Afferents(afferent, position, depth, first.direction, ending, (len(position), 1))
        for position, depth, ending in sets
    )


def variants(skin: Skin) -> Iterator[Skin]:
    """Yield the skin with every conductivity of its spread, the nominal one first.

    Homogeneous conductivity scales all potentials and changes no kernel; that between layers does.
    """
    yield skin
    factor = skin.spread.conductivity_factor
    if factor == 1:
        return
    for index, layer in enumerate(skin.layers):
        for conductivity in (
            layer.conductivity_s_per_m / factor, layer.conductivity_s_per_m * factor,
        ):  # fmt: skip
            changed = layer.model_copy(update={"conductivity_s_per_m": conductivity})
            layers = (*skin.layers[:index], changed, *skin.layers[index + 1 :])
            yield skin.model_copy(update={"layers": layers})


def _ending(skin: Skin, afferent: Afferent) -> str | None:
    return skin.ra_ending if afferent is Afferent.RA else None


def _lattice(profile: Profile, spacing_mm: float) -> tuple[NDArray[np.float64], tuple[int, int]]:
    electrodes = profile.electrodes
    plane = profile.skin.medium == "plane"
    margin = _MARGIN_PITCHES.get(profile.skin.medium, 1.0) * electrodes.pitch_mm
    reach = np.abs(electrodes.position_mm).max(axis=0) + margin
    axes = []
    for half in reach:
        steps = int(np.floor(2 * half / spacing_mm + 1e-9))
        axes.append((np.arange(steps + 1) - steps / 2) * spacing_mm)
    x, y = np.meshgrid(axes[0], [0.0] if plane else axes[1])
    return np.column_stack([x.ravel(), y.ravel()]), x.shape
