"""Simulated finger under an array: random afferents drawn from an anatomy, and how strongly each
electrode drives them."""

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ProfileError, require_within
from smarttouch.physiology import activating_function as nominal
from smarttouch.physiology.activating_function import potential_mv
from smarttouch.physiology.afferent_anatomy import Anatomy, ClassAnatomy, load_anatomy
from smarttouch.physiology.membrane import DrivingFunction
from smarttouch.profile import Profile, load_profile

if TYPE_CHECKING:
    from smarttouch.physiology.spikes import Feeling

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Population:
    """Afferents of one class, each with one or more branches."""

    afferent: Afferent
    receptor_mm: Array  # (A, 2) mean place of each afferent's endings
    axon_path_mm: Array  # (B, P, 3) corners of each branch, from its nerve ending on; z is depth
    owner: NDArray[np.intp]  # (B,) afferent of each branch
    factor: Array  # (A,) thresholds of afferents, relative to the fiber model
    anatomy: ClassAnatomy


def axon_path_points(
    one: Population, branches: NDArray[np.intp], nodes: int, spacing_mm: float
) -> Array:
    """Return the places of nodes along branches, (B, N, 3) mm. Node 0 is the ending."""
    points = _along(one.axon_path_mm[branches], np.arange(nodes, dtype=np.float64) * spacing_mm)
    return _rounded(points, int(one.anatomy.bend_mm / spacing_mm / 2))


def axon_path_length_mm(axon_path_mm: Array, corners: int) -> Array:
    """Return each path's length, (B,) mm, from its ending, corner 0, to corner ``corners``."""
    steps = np.linalg.norm(np.diff(axon_path_mm[:, : corners + 1], axis=1), axis=2)
    return np.asarray(steps.sum(axis=1))


def _along(axon_path_mm: Array, along_mm: Array) -> Array:
    """Return points on paths, (B, N, 3), at the distances ``along_mm``, (N,), from the endings."""
    steps = np.diff(axon_path_mm, axis=1)
    lengths = np.linalg.norm(steps, axis=2)
    begins = np.cumsum(lengths, axis=1) - lengths
    points = np.repeat(axon_path_mm[:, :1], len(along_mm), axis=1)
    for index in range(steps.shape[1]):
        last = index == steps.shape[1] - 1
        done = along_mm - begins[:, index, None]
        # A path continues straight beyond its last corner.
        done = np.maximum(done, 0) if last else np.clip(done, 0, lengths[:, index, None])
        length = np.maximum(lengths[:, index], 1e-12)
        points += done[..., None] * (steps[:, index] / length[:, None])[:, None]
    return np.asarray(points)


def _rounded(points_mm: Array, reach: int) -> Array:
    """Return paths with bends rounded by a moving average over `reach` nodes to each side."""
    reach = min(reach, points_mm.shape[1] - 1)
    if reach < 1:
        return points_mm
    pad = ((0, 0), (reach + 1, reach), (0, 0))
    sums = np.cumsum(np.pad(points_mm, pad, mode="reflect", reflect_type="odd"), axis=1)
    return np.asarray((sums[:, 2 * reach + 1 :] - sums[:, : -2 * reach - 1]) / (2 * reach + 1))


Floats = NDArray[np.float32]

_AT_ONCE = 64  # branches computed together; more do not fit into the processor's cache
_SHALLOWEST_MM = 0.2


class Finger:
    """Afferents of one finger under the array of a profile.

    Parameters
    ----------
    profile : Profile or str
        Array and skin, or the name or file of the profile. x points right, y from the fingertip
        toward the palm, z into the skin.
    seed : int
        Seed of the random properties of the finger: places, depths, paths and thresholds.
    anatomy : str, Path or Anatomy
        "branched", "paper", a TOML file, or the anatomy itself.

    Raises
    ------
    ProfileError
        If there is no such anatomy, or the seed is negative.
    DesignError
        If the profile's pulse width is outside the fitted range.

    Examples
    --------
    >>> import smarttouch as st
    >>> profile = st.load_profile("electric-mouse")
    >>> finger = st.Finger(profile, seed=1, anatomy="paper")
    >>> step = next(st.steps(st.open_source("text:a", profile), profile, intensity=1))
    >>> feeling = finger.feel(step)
    >>> feeling.counts.shape == finger.classes.shape
    True
    """

    def __init__(
        self, profile: Profile | str, seed: int = 1, anatomy: str | Path | Anatomy = "branched"
    ) -> None:
        require_within(ProfileError, "seed", seed, 0, math.inf)
        self.profile: Profile = load_profile(profile)
        self.seed: int = seed
        self.anatomy: Anatomy = anatomy if isinstance(anatomy, Anatomy) else load_anatomy(anatomy)
        self.populations: dict[Any, Population] = {
            afferent: self._populate(afferent, self.anatomy.of(afferent)) for afferent in Afferent
        }

    def feel(self, given: Any, seed: int = 1) -> "Feeling":
        """Return the finger's response to a step, a scan sequence, or several of these in order.

        Parameters
        ----------
        given : Step, StepResult, ScanSequence, or iterable of these
        seed : int
            Seed of the random changes of thresholds from pulse to pulse.
        """
        from smarttouch.physiology.spikes import feel

        return feel(self, given, seed)

    @property
    def reach_mm(self) -> Array:
        """Half the width and half the length of the modeled skin, (2,) mm."""
        outer = np.abs(self.profile.electrodes.position_mm).max(axis=0)
        return np.asarray(outer + self.anatomy.margin_mm)

    @cached_property
    def classes(self) -> NDArray[np.int8]:
        """Class of each afferent, (A,)."""
        count = [len(one.factor) for one in self.populations.values()]
        return np.repeat(np.arange(len(count), dtype=np.int8), count)

    @cached_property
    def receptor_mm(self) -> Floats:
        """Mean place of each afferent's endings, (A, 2) mm; spikes are perceived there."""
        places = [one.receptor_mm for one in self.populations.values()]
        return np.concatenate(places).astype(np.float32)

    @cached_property
    def receptor_away_mm(self) -> Array:
        """Distance of each receptor from each electrode along the skin, (A, E) mm."""
        places = self.profile.electrodes.position_mm
        return np.asarray(np.linalg.norm(self.receptor_mm[:, None] - places, axis=2))

    @cached_property
    def rows(self) -> tuple[Floats, NDArray[np.intp]]:
        """Drives, (N, E), of all nodes that can fire with allowed currents, and ``starts``, (A,).

        ``starts[i]`` is the first row of afferent i in the drives. A drive, 1/mA, is the effect of
        1 mA of cathodic current with the profile's pulse. A node fires if its drives times the
        currents in mA add up to 1 or more. An afferent that cannot fire has one row of zeros.
        """
        row_parts, starts, count = [], [], 0
        for one in self.populations.values():
            rows, owner = self._drives(one)
            every = np.arange(len(one.factor))
            silent = np.setdiff1d(every, owner)
            rows = np.vstack([rows, np.zeros((len(silent), rows.shape[1]), np.float32)])
            owner = np.concatenate([owner, silent])
            order = np.argsort(owner, kind="stable")
            row_parts.append(rows[order])
            starts.append(count + np.searchsorted(owner[order], every))
            count += len(rows)
        return np.concatenate(row_parts), np.concatenate(starts)

    def _populate(self, afferent: Afferent, anatomy: ClassAnatomy) -> Population:
        random = np.random.default_rng([self.seed, int(afferent)])
        receptor = self._places(anatomy, random)
        count, endings = len(receptor), anatomy.endings
        owner = np.repeat(np.arange(count), endings)
        spread = random.normal(0, anatomy.branch_spread_mm, (count, endings, 2))
        spread[:, 0] = 0
        ending = (receptor[:, None] + spread).reshape(-1, 2)
        if anatomy.on_ridges:
            ending[:, 1] = np.round(ending[:, 1] / self.anatomy.ridge_mm) * self.anatomy.ridge_mm
        depth = anatomy.depth_mm or nominal.depth_mm(self.profile.skin, afferent)
        depths = np.repeat(random.normal(depth, anatomy.depth_spread_mm, count), endings)
        depths = np.maximum(depths, _SHALLOWEST_MM)
        turn = np.radians(random.normal(anatomy.flat_deg, anatomy.flat_spread_deg, count))[owner]
        lean = np.tan(np.radians(random.normal(0, anatomy.lean_deg, (count * endings, 2))))
        joint = receptor[owner]
        course = self._corners(anatomy, ending, joint, depths, turn, lean)
        factor = np.exp(random.normal(0, anatomy.threshold_spread, count))
        factor *= anatomy.threshold_factor
        middle = ending.reshape(count, endings, 2).mean(axis=1)
        return Population(afferent, middle, course, owner, factor, anatomy)

    def _places(self, anatomy: ClassAnatomy, random: np.random.Generator) -> Array:
        """Return random places of receptors, (A, 2) mm, with the anatomy's density."""
        reach = self.reach_mm
        area_cm2 = 4 * reach.prod() / 100
        count = random.poisson(anatomy.density_per_cm2 * area_cm2)
        position_mm = random.uniform(-reach, reach, (count, 2))
        beyond = position_mm[:, 1] + reach[1] > self.anatomy.tip_mm
        there = ~beyond | (random.random(count) < self.anatomy.beyond_tip)
        return np.asarray(position_mm[there])

    def _corners(
        self, anatomy: ClassAnatomy, ending: Array, joint: Array, depth: Array, turn: Array,
        lean: Array,
    ) -> Array:  # fmt: skip
        """Return the corners of each branch, (B, P, 3): ending, end of the upright part, joint of
        the branches, end of the horizontal part, and end of the descending part, if any."""
        top = np.maximum(depth - anatomy.receptor_above_mm, _SHALLOWEST_MM)
        plexus = np.maximum(anatomy.plexus_mm or 0.0, depth)
        upright = (plexus - top)[:, None]
        foot = ending + lean * upright
        away = np.column_stack([np.cos(turn), np.sin(turn)])
        start = joint if anatomy.endings > 1 else foot
        flat = start + anatomy.flat_mm * away
        corners = [(ending, top), (foot, plexus), (start, plexus), (flat, plexus)]
        if anatomy.descent_mm:
            corners.append((flat, plexus + anatomy.descent_mm))
        return np.stack([np.column_stack(corner) for corner in corners], axis=1)

    def _drives(self, population: Population) -> tuple[Floats, NDArray[np.intp]]:
        """Return the drives of the nodes that can fire, and the afferent of each node."""
        driving = population.anatomy.driving(self.profile.pulse.width_us)
        owner = population.owner
        first = np.r_[True, np.diff(owner) > 0] if len(owner) else np.zeros(0, np.bool_)
        drives = [np.zeros((0, len(self.profile.electrodes)), np.float32)]
        branches = [np.zeros(0, np.intp)]
        # The first branch of an axon includes the common part. The others end at the joint.
        for which, corners in ((first, population.axon_path_mm.shape[1] - 1), (~first, 2)):
            # Sort by length: each batch is padded to its longest branch.
            order = np.argsort(axon_path_length_mm(population.axon_path_mm, corners), kind="stable")
            indices = order[which[order]]
            for part in np.array_split(indices, max(1, len(indices) // _AT_ONCE)):
                if len(part):
                    rows, branch = self._drives_of_branches(population, driving, part, corners)
                    drives.append(rows)
                    branches.append(branch)
        branch = np.concatenate(branches)
        order = np.argsort(branch, kind="stable")
        return np.concatenate(drives)[order], owner[branch[order]]

    def _drives_of_branches(
        self, population: Population, driving: DrivingFunction, part: NDArray[np.intp], corners: int
    ) -> tuple[Floats, NDArray[np.intp]]:
        """Return the drives of nodes that can fire, and the branch of each node. Search only the
        branches in ``part``, each from its ending, corner 0, to corner ``corners``."""
        spacing = driving.internode_mm
        length_mm = axon_path_length_mm(population.axon_path_mm[part], corners)
        nodes = int(np.ceil(length_mm.max() / spacing)) + len(driving.along) + 1
        points = axon_path_points(
            population, part, max(nodes, len(driving.near_end.T) + 4), spacing
        )
        drive = driving.drive(potential_mv(self.profile, points))
        drive /= population.factor[population.owner[part]][:, None, None]
        longest = strength(self.profile.limits.pulse_us, population.anatomy.chronaxie_us)
        longest /= strength(self.profile.pulse.width_us, population.anatomy.chronaxie_us)
        # Nodes beyond the end of a branch only serve as neighbors of its last nodes.
        node = np.arange(drive.shape[1]) + (driving.end != "active")
        there = node * spacing <= length_mm[:, None] + spacing
        rows, branch = drive[there], np.repeat(part, there.sum(axis=1))
        can = self._largest_drive(rows) * max(longest, 1.0) >= 1 - 5 * population.anatomy.noise
        return rows[can].astype(np.float32), branch[can]

    def _largest_drive(self, rows: Array) -> Array:
        """Return the largest drive of each node, (N,), that the profile's limits allow.

        Currents sum to zero; each current and the sum of anodic currents are limited.
        """
        limits = self.profile.limits
        ranked = np.sort(rows, axis=1)
        limit_ma = float(limits.current_ma)
        total = float(limits.total_ma or np.inf)
        share = np.clip(total - limit_ma * np.arange(rows.shape[1]), 0, limit_ma)
        # Pair the electrode with the largest effect on a node and the one with the smallest, and so
        # on. A pair gets no current if it would lower the node's drive.
        return np.asarray(np.maximum(ranked[:, ::-1] - ranked, 0) @ share)


def strength(width_us: Any, chronaxie_us: Any) -> Any:
    """Return the effect of a pulse of this width, relative to an endless pulse (Weiss 1901)."""
    return 1 / (1 + chronaxie_us / np.maximum(width_us, 1.0))
