"""Design of the kernels of many sites on all cores; an interrupted design resumes.

On large arrays a kernel drives only the electrodes near its site. A tile consists of the site,
these electrodes, and a ring around them. Only nodes within the tile are checked, because a kernel
excites farther nodes less. Sites with equal or mirrored tiles share a kernel, so a grid of any size
needs about 40 designs. Without tiles, the time grows with the third power of the electrode count.
"""

import contextlib
import json
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.base.files import read_bytes
from smarttouch.kernels.design_problem import (
    Array,
    Kernel,
    KernelKind,
    Problem,
    limits_ma,
    mirrors,
    own_properties,
)
from smarttouch.profile import Profile
from smarttouch.profile.electrodes import FreeLayout

Design = Callable[[Problem, int], Kernel]
Progress = Callable[[int, int], None]
Timed = tuple[Kernel, float]

_running: set[int] = set()  # threads that are designing


def part_of(progress: Progress | None, index: int, parts: int) -> Progress:
    """Return a callback that reports the progress of one of several equal parts."""

    def advance(done: int, total: int) -> None:
        if progress is not None:
            progress(index * total + done, parts * total)

    return advance


def design_sites(
    problem: Problem,
    design: Design,
    sites: Sequence[int] | None = None,
    progress: Progress | None = None,
    keep: Path | None = None,
) -> list[Timed]:
    """Design a kernel for each site, and return it with its design time.

    Of sites that mirror each other, only one is designed. Sites are designed in threads, as the
    solver releases the interpreter lock. ``joblib.parallel_config`` can choose another backend, for
    example a Dask cluster. Finished kernels are stored in ``keep``; a later call reuses them.
    """
    from joblib import Parallel, delayed
    from threadpoolctl import threadpool_limits

    if sites is None:
        sites = problem.driven.tolist()
    for site in sites:
        problem.check_site(site)
    ways = [problem.representative(site) for site in sites]
    distinct = sorted({first for first, _ in ways})
    done = {
        first: known_kernel
        for first in distinct
        if (known_kernel := kept_kernel(keep, problem, first))
    }
    missing = [first for first in distinct if first not in done]
    answers = Parallel(n_jobs=-1, prefer="threads", return_as="generator_unordered")(
        delayed(_timed)(design, problem, first) for first in missing
    )
    # Sites are designed in parallel on all cores, so limit BLAS to one thread.
    with threadpool_limits(limits=1, user_api="blas"):
        try:
            for first, kernel, seconds in answers:
                done[first] = kernel, seconds
                if keep is not None:
                    keep_kernel(keep, problem, first, kernel, seconds)
                if progress is not None:
                    progress(len(done), len(distinct))
        except BaseException:
            answers.close()
            # Wait for the solver's threads: the process would abort if it ended before them.
            while _running:
                time.sleep(0.02)
            raise
    return [
        (_moved(problem, site, done[first][0], move), done[first][1])
        for site, (first, move) in zip(sites, ways, strict=True)
    ]


def _timed(design: Design, problem: Problem, site: int) -> tuple[int, Kernel, float]:
    start = time.perf_counter()
    _running.add(threading.get_ident())
    try:
        kernel = design(problem, site)
    finally:
        _running.discard(threading.get_ident())
    return site, kernel, time.perf_counter() - start


def _moved(problem: Problem, site: int, kernel: Kernel, move: np.ndarray) -> Kernel:
    weights = np.empty_like(kernel.weights)
    weights[move] = kernel.weights
    # Mirroring can reorder the nodes of an axon: find the node with the largest AF (Eq. 11).
    node = kernel.node and int((problem.axon(site) @ weights).argmax())
    return replace(kernel, weights=weights, node=node)


def _path(keep: Path, problem: Problem, site: int) -> Path:
    return keep / f"{problem.afferent.name}-{site}.json"


def keep_kernel(keep: Path, problem: Problem, site: int, kernel: Kernel, seconds: float) -> None:
    fields: dict[str, Any] = {
        "weights": kernel.weights.tolist(),
        "worst_other": kernel.off_target,
        "worst_other_class": kernel.off_target_class.name,
        "own_spill": kernel.spill,
        "node": kernel.node,
        "kind": kernel.kind,
        "gap": kernel.gap,
        "seconds": seconds,
    }
    # Ignore errors: another process with the same design may remove the folder. A kernel that is
    # not stored is designed again.
    with contextlib.suppress(OSError):
        keep.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=keep, suffix=".part", delete=False) as half:
            half.write(json.dumps(fields))
        Path(half.name).replace(_path(keep, problem, site))


def kept_kernel(keep: Path | None, problem: Problem, site: int) -> Timed | None:
    if keep is None:
        return None
    try:
        fields = json.loads(read_bytes(_path(keep, problem, site), DesignError))
        seconds = float(fields["seconds"])
        kernel = Kernel(
            weights=np.array(fields["weights"], np.float64), off_target=fields["worst_other"],
            off_target_class=Afferent[fields["worst_other_class"]], spill=fields["own_spill"],
            node=fields["node"], kind=fields["kind"], gap=fields["gap"],
        )  # fmt: skip
        is_complete = kernel.weights.shape == (problem.electrodes,) and bool(
            np.isfinite([*kernel.weights, kernel.off_target, kernel.spill, kernel.gap]).all()
        )
    except (DesignError, ValueError, KeyError, TypeError, AttributeError, OverflowError):
        return None
    return (kernel, seconds) if is_complete else None


_NOTHING = 1e-9  # relative current below which a weight is numerical noise
_CLEAR = 1 - 1e-6


def design_unless_known(
    design: Design, before: Profile, known_kernel: Callable[[Afferent, int, KernelKind], Kernel]
) -> Design:
    """Return a design function that reuses the kernels of another profile if they stay optimal. A
    kernel that drives a masked electrode is not reused. Any other kernel stays optimal if the
    limits are unchanged, or if the kernel keeps both the old and the new limits with a margin."""

    def keep_or_design(problem: Problem, site: int) -> Kernel:
        known = known_kernel(problem.afferent, site, "weighted")
        weights, masked = known.weights.copy(), list(problem.profile.output.masked)
        peak = np.abs(weights).max()
        if (np.abs(weights[masked]) > _NOTHING * peak).any() or not (
            _same_limits(before, problem.profile, site)
            or (_within(weights, site, before) and _within(weights, site, problem.profile))
        ):
            return design(problem, site)
        weights[masked] = 0.0
        weights[problem.driven] -= weights[problem.driven].mean()
        return replace(known, weights=weights)

    return keep_or_design


def _same_limits(before: Profile, now: Profile, site: int) -> bool:
    (total, own_ma), (total_now, own_now) = limits_ma(before), limits_ma(now)
    alike = total == total_now and np.array_equal(own_ma, own_now)
    return alike and bool(before.full_ma[site] == now.full_ma[site])


def _within(weights: Array, site: int, profile: Profile) -> bool:
    """Scale a pattern, (E,), to the strongest comfortable current at the site. Return whether it
    then keeps the profile's limits."""
    total, electrode = limits_ma(profile)
    if weights[site] == 0:
        return bool(np.isinf(total) and np.isinf(electrode).all())
    carried = np.abs(weights) * float(profile.full_ma[site]) / abs(weights[site])
    in_all, carried[site] = carried.sum() / 2, 0.0
    return bool(in_all <= _CLEAR * total and (carried <= _CLEAR * electrode).all())


_RING_PITCHES = 1.0
_DECIMALS = 6


@dataclass(frozen=True, eq=False)
class Tile:
    """Small array of a site and its neighbors. Sites whose neighbors are arranged alike, perhaps
    mirrored or turned, share it."""

    profile: Profile  # profile with the electrodes of the tile; number 0 is the site of the kernel
    # indices of the tile's electrodes in the complete array, (N,), for each site
    members: dict[int, NDArray[np.intp]] = field(default_factory=dict)


def tiles_of(profile: Profile, sites: Iterable[int]) -> list[Tile]:
    """Return the distinct tiles of sites. A tile drives all electrodes within a circle around its
    site: the largest circle that contains at most `Kernels.neighbors` electrodes."""
    array, neighbors = profile.electrodes, profile.kernels.neighbors or len(profile.electrodes)
    is_driven = np.isin(np.arange(len(array)), profile.driven)
    properties = np.column_stack(own_properties(profile))
    moves = mirrors(profile, tuple(Afferent))
    tiles: dict[bytes, Tile] = {}
    for site in sites:
        apart_mm = array.position_mm - array.position_mm[site]
        away_mm = np.hypot(*apart_mm.T).round(_DECIMALS)
        rings_mm, counts = np.unique(away_mm[is_driven], return_counts=True)
        radius_mm = rings_mm[max(1, int(counts.cumsum().searchsorted(neighbors, "right")) - 1)]
        seen = np.flatnonzero(away_mm <= radius_mm + _RING_PITCHES * array.pitch_mm)
        drives = is_driven[seen] & (away_mm[seen] <= radius_mm)
        keys = []
        for move in moves:
            # Adding 0 turns negative zeros into positive ones: equal values need equal bytes.
            moved = (apart_mm[seen] @ move.T).round(_DECIMALS) + 0.0
            rows = np.column_stack([away_mm[seen], moved, drives, properties[seen]])
            order = np.lexsort(rows.T[2::-1])
            keys.append((rows[order].tobytes(), order, moved[order]))
        key, order, places_mm = min(keys, key=lambda candidate: candidate[0])
        members = seen[order]
        if key not in tiles:
            tiles[key] = Tile(_tile_profile(profile, members, places_mm, drives[order]))
        tiles[key].members[site] = members
    return list(tiles.values())


def _tile_profile(
    profile: Profile, members: NDArray[np.intp], places_mm: Array, drives: NDArray[np.bool_]
) -> Profile:
    """Return the profile of a tile. It has the electrodes ``members``, (N,), at ``places_mm``,
    (N, 2). Electrodes for which ``drives``, (N,), is false are masked."""
    array, felt, limits = profile.electrodes, profile.perception, profile.limits
    shapes = [array.own[index] for index in members] if array.own else None
    layout = FreeLayout(
        layout="free",
        positions_mm=tuple((x, y) for x, y in places_mm.tolist()),
        shape=array.shape,
        size_mm=array.size_mm,
        shapes=None if shapes is None else tuple(shape for shape, _ in shapes),
        sizes_mm=None if shapes is None else tuple(size for _, size in shapes),
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
    """Design the kernel of each class and site. Yield class; site; electrodes of the tile, (N,);
    kernel; design time, s; and the AF at the target for 1 mA through each electrode, (N,) V/mm²."""
    tiles = tiles_of(profile, sites)
    for index, tile in enumerate(tiles):
        node_rows: dict[Afferent, Array] = {}
        folder = None if keep is None else keep / f"tile-{index}"
        for number, afferent in enumerate(modes):
            problem = Problem(tile.profile, afferent, made=node_rows)
            advance = part_of(progress, index * len(modes) + number, len(tiles) * len(modes))
            ((kernel, seconds),) = design_sites(problem, design, [0], advance, folder)
            for site, members in tile.members.items():
                yield afferent, site, members, kernel, seconds, problem.target[0]
