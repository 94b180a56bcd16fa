"""Kernels confined to the electrodes around their sites: designed tile by tile, for large arrays.

A tile is a site, the electrodes nearest to it, which alone its kernel drives, and a ring of others,
which says how far nodes are looked at: farther out such a pattern excites less than within. Sites
of alike tiles, mirror images too, have one kernel, so that a grid of any size has some 40 to
design, where a whole bank's time grows with the third power of its electrodes.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.batch_design import Design, Progress, design_sites, part_of
from smarttouch.kernels.design_problem import Array, Kernel, Problem, mirrors, own_properties
from smarttouch.profile import Profile
from smarttouch.profile.electrodes import FreeLayout

_RING_PITCHES = 1.0
_DECIMALS = 6


@dataclass(frozen=True, eq=False)
class Tile:
    """Sites whose surroundings are alike, and these as an array of its own."""

    profile: Profile  # electrode 0 is the site
    # Sites, and of each the electrodes (N,) of the array that the tile's stand for
    members: dict[int, NDArray[np.intp]] = field(default_factory=dict)


def tiles_of(profile: Profile, sites: Iterable[int]) -> list[Tile]:
    """Return the tiles of sites with `Kernels.neighbors` driven electrodes each at most, whole
    rings of equal distance."""
    array, most = profile.electrodes, profile.kernels.neighbors or len(profile.electrodes)
    is_driven = np.isin(np.arange(len(array)), profile.driven)
    properties = np.column_stack(own_properties(profile))
    moves = mirrors(profile, tuple(Afferent))
    found: dict[bytes, Tile] = {}
    for site in sites:
        apart_mm = array.position_mm - array.position_mm[site]
        away_mm = np.hypot(*apart_mm.T).round(_DECIMALS)
        rings_mm, counts = np.unique(away_mm[is_driven], return_counts=True)
        radius_mm = rings_mm[max(1, int(counts.cumsum().searchsorted(most, "right")) - 1)]
        seen = np.flatnonzero(away_mm <= radius_mm + _RING_PITCHES * array.pitch_mm)
        drives = is_driven[seen] & (away_mm[seen] <= radius_mm)
        keys = []
        for move in moves:
            # Without negative zeros.
            moved = (apart_mm[seen] @ move.T).round(_DECIMALS) + 0.0
            rows = np.column_stack([away_mm[seen], moved, drives, properties[seen]])
            order = np.lexsort(rows.T[2::-1])
            keys.append((rows[order].tobytes(), order, moved[order]))
        key, order, places_mm = min(keys, key=lambda each: each[0])
        members = seen[order]
        if key not in found:
            found[key] = Tile(_cut(profile, members, places_mm, drives[order]))
        found[key].members[site] = members
    return list(found.values())


def _cut(
    profile: Profile, members: NDArray[np.intp], places_mm: Array, drives: NDArray[np.bool_]
) -> Profile:
    """Return the profile of a tile: electrodes (N,) at places (N, 2), of which some are driven."""
    array, felt, limits = profile.electrodes, profile.perception, profile.limits
    each = [array.own[index] for index in members] if array.own else None
    layout = FreeLayout(
        layout="free",
        positions_mm=tuple((x, y) for x, y in places_mm.tolist()),
        shape=array.shape,
        size_mm=array.size_mm,
        shapes=None if each is None else tuple(shape for shape, _ in each),
        sizes_mm=None if each is None else tuple(size for _, size in each),
    )

    def of(values: Any) -> Any:
        return tuple(values[index] for index in members) if isinstance(values, tuple) else values

    masked = tuple(np.flatnonzero(~drives).tolist())
    return profile.model_copy(
        update={
            "array": layout,
            "output": profile.output.model_copy(update={"masked": masked, "wiring": None}),
            "perception": felt.model_copy(
                update={"threshold_ma": of(felt.threshold_ma), "comfort_ma": of(felt.comfort_ma)}
            ),
            "limits": limits.model_copy(update={"electrode_ma": of(limits.electrode_ma)}),
        }
    )


def design_tiles(
    profile: Profile,
    modes: Sequence[Afferent],
    design: Design,
    sites: Sequence[int],
    progress: Progress | None = None,
    keep: Path | None = None,
) -> Iterable[tuple[Afferent, int, NDArray[np.intp], Kernel, float, Array]]:
    """Yield of each mode and site: electrodes (N,), the kernel of these, the seconds of its design,
    and the target's activating function by each of them, (N,) V/mm² per mA."""
    tiles = tiles_of(profile, sites)
    for index, tile in enumerate(tiles):
        made: dict[Afferent, Array] = {}
        folder = None if keep is None else keep / f"tile-{index}"
        for number, afferent in enumerate(modes):
            problem = Problem(tile.profile, afferent, made=made)
            advance = part_of(progress, index * len(modes) + number, len(tiles) * len(modes))
            ((kernel, seconds),) = design_sites(problem, design, [0], advance, folder)
            for site, members in tile.members.items():
                yield afferent, site, members, kernel, seconds, problem.target[0]
