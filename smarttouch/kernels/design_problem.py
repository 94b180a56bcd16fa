"""Design problem of a kernel: rows for the target and for all other nodes, and symmetries. A row
holds the activating function (AF) at one node: a value for each electrode, for 1 mA through it."""

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.base.tactile_image import one_line
from smarttouch.physiology.activating_function import (
    af_matrix,
    along_axon,
    directions,
    everywhere,
    targets,
)
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
"""Symmetries of a square. Hexagonal arrays use them too, as the lattice of nodes is square."""


def symmetries(profile: Profile, afferent: Afferent) -> list[NDArray[np.intp]]:
    """Return the permutations of electrodes that leave a design problem unchanged, identity first.
    Each maps electrode e to ``permutation[e]``."""
    array = profile.electrodes
    moves = []
    kind = _kinds(profile)
    for matrix in mirrors(profile, (afferent,)):
        moved = array.position_mm @ matrix.T
        gaps = np.linalg.norm(moved[:, None, :] - array.position_mm[None, :, :], axis=2)
        gaps[kind[:, None] != kind] = np.inf
        if gaps.min(axis=1).max() <= 1e-6:
            moves.append(np.asarray(gaps.argmin(axis=1), np.intp))
    properties = own_properties(profile)
    return [
        move for move in moves if all(np.array_equal(values[move], values) for values in properties)
    ]


def mirrors(profile: Profile, targets_of: Collection[Afferent]) -> list[NDArray[np.int_]]:
    """Return symmetries of a square as (2, 2) matrices; the identity is first.

    They preserve electrode shapes, and the set of axon directions of each class. For classes in
    ``targets_of``, they also preserve the first direction: that of the target's own axon."""
    skin = profile.skin
    kinds = profile.electrodes.kinds
    upright = any(shape == "rectangle" and size[0] != size[1] for shape, size in kinds)
    sets = [directions(skin, afferent) for afferent in Afferent]
    sets += [directions(skin, afferent)[:1] for afferent in targets_of]
    return [
        matrix
        for matrix in _SQUARE
        if not (upright and matrix[0, 0] == 0)
        and all(_preserves(direction_set, matrix) for direction_set in sets)
    ]


def _kinds(profile: Profile) -> NDArray[np.float64]:
    """Return a number that identifies shape and size of each electrode, (E,)."""
    kind = np.zeros(len(profile.electrodes))
    for number, which in enumerate(profile.electrodes.kinds.values()):
        kind[which] = number
    return kind


def own_properties(profile: Profile) -> list[NDArray[np.float64]]:
    """Return the properties in which electrodes can differ, (E,) each."""
    limits, properties = profile.limits, [profile.admittance, _kinds(profile)]
    if profile.output.masked:
        properties.append(
            np.isin(np.arange(len(profile.electrodes)), profile.driven).astype(np.float64)
        )
    if limits.electrode_ma is not None:
        properties.append(np.array(limits.electrode_ma))
    if limits.electrode_ma is not None or profile.design_total_ma is not None:
        # In a design, limits are relative to the comfort level of the site.
        properties.append(np.asarray(profile.full_ma, np.float64))
    return properties


def _preserves(axons: NDArray[np.float64], matrix: NDArray[np.int_]) -> bool:
    """Return whether a symmetry preserves a set of axon directions; opposite directions count as
    equal."""
    moved = axons.copy()
    moved[:, :2] = axons[:, :2] @ matrix.T
    alike = np.abs(moved @ axons.T)
    return bool(np.all(alike.max(axis=1) > 1 - 1e-9))


Array = NDArray[np.float64]
KernelKind = Literal["weighted", "three-state", "one-against-all"]

_ALIKE = 1e-6


@dataclass(frozen=True, eq=False)
class Kernel:
    """Current pattern that stimulates one class of afferents at one site."""

    __repr__ = one_line

    weights: Array  # (E,) mA for an AF of 1 V/mm² at the target, positive cathodic
    off_target: float  # largest activation of another class, relative to the target
    off_target_class: Afferent  # the other class that is activated most
    # largest activation of the same class at nodes over a pitch away, relative to the target
    spill: float
    node: int = 0  # index of the target node on its axon; 0 is under the electrode
    kind: KernelKind = "weighted"
    gap: float = 0.0  # largest possible relative distance from the optimum; 0 if proven optimal

    @property
    def peak_normalized(self) -> Array:
        """Weights scaled to a peak of 1, as in the paper (Fig. 8)."""
        return np.asarray(self.weights / np.abs(self.weights).max())


_FIRST_MM = 0.5  # spacing of the nodes that a design checks first


def _sublattice(grids: list[tuple[tuple[int, int], int]], apart: int) -> NDArray[np.intp]:
    """Return the indices, (K,), of nodes in every ``apart``-th row and column of each lattice."""
    starts, start = [], 0
    for (high, wide), count in grids:
        index = np.arange(start, start + count * high * wide).reshape(count, high, wide)
        starts.append(index[:, ::apart, ::apart].ravel())
        start += index.size
    return np.concatenate(starts)


def limits_ma(profile: Profile) -> tuple[float, Array]:
    """Return the limits of total current and of each electrode, (E,), mA; infinite if unlimited."""
    limits, count = profile.limits, len(profile.electrodes)
    # Currents are rounded to whole µA, so leave a margin of 1 µA for each electrode.
    margin = count / 1000
    electrode = np.array(limits.electrode_ma or np.full(count, np.inf)) - margin
    return (profile.design_total_ma or np.inf) - margin, electrode


def masked_site(site: int) -> DesignError:
    return DesignError(
        f"site {site} is masked: its electrode is not driven; choose another, or remove it from "
        "output.masked of the profile",
        electrode=site,
    )


class Problem:
    """Design problem of one class: AF rows of its targets, of all its nodes, and of the nodes of
    other classes. The rows are the same for all sites of a profile.

    ``others`` are the classes to avoid: one as in Eq. 10, or two as in Eq. 16 (the default).
    ``made`` is a cache of rows by class, which several problems of a profile can share.
    """

    def __init__(
        self,
        profile: Profile,
        afferent: Afferent,
        others: Collection[Afferent] | None = None,
        made: dict[Afferent, Array] | None = None,
    ) -> None:
        self.profile: Profile = profile
        self.afferent: Afferent = afferent
        if others is None:
            others = [other for other in Afferent if other is not afferent]
        if afferent in others or not others:
            raise DesignError(
                f"a kernel of {afferent.name} needs one or two other classes to avoid, not "
                f"{', '.join(other.name for other in others) or 'none'}"
            )
        nodes = {other: everywhere(profile, other) for other in (afferent, *others)}
        made = {} if made is None else made
        for other in nodes.keys() - made.keys():
            made[other] = af_matrix(profile, nodes[other])
        self.target: Array = af_matrix(profile, targets(profile, afferent))
        """AF rows of the targets of all sites, (E, E) V/mm² per mA."""
        self.other: Array = np.concatenate([made[other] for other in others])
        """AF rows of all nodes of the other classes, (N, E)."""
        self.own: Array = made[afferent]
        """AF rows of all nodes of the target's class, (M, E)."""
        self.other_class: NDArray[np.int8] = np.concatenate(
            [np.full(len(made[other]), other, np.int8) for other in others]
        )
        self.grids: list[tuple[tuple[int, int], int]] = [
            (nodes[other].grid, len(nodes[other].direction)) for other in others
        ]
        own_nodes = nodes[afferent]
        apart = max(1, round(_FIRST_MM / profile.skin.node_spacing_mm))
        self.coarse_other: NDArray[np.intp] = _sublattice(self.grids, apart)
        """Indices of rows of `other` whose nodes lie about `_FIRST_MM` apart."""
        self.coarse_own: NDArray[np.intp] = _sublattice(
            [(own_nodes.grid, len(own_nodes.direction))], apart
        )
        self._own_position_mm = np.tile(own_nodes.position_mm, (len(own_nodes.direction), 1))

    @property
    def electrodes(self) -> int:
        return len(self.profile.electrodes)

    @cached_property
    def symmetries(self) -> list[NDArray[np.intp]]:
        return symmetries(self.profile, self.afferent)

    @property
    def driven(self) -> NDArray[np.intp]:
        """Electrodes that are not masked; only these sites have kernels."""
        return self.profile.driven

    def describe(self, site: int) -> str:
        return f"{self.afferent.name} at site {site} of {self.profile.name or 'this profile'}"

    def check_site(self, site: int) -> None:
        """Raise DesignError if the site does not exist or is masked."""
        if not 0 <= site < self.electrodes:
            last = self.electrodes - 1
            message = f"site {site} is out of range: the array has sites 0 to {last}"
            raise DesignError(message, electrode=site)
        if site in self.profile.output.masked:
            raise masked_site(site)

    def beyond_a_pitch(self, site: int, node: int = 0) -> NDArray[np.bool_]:
        """Return for each row of `own` whether its node is more than a pitch from the target, (M,).
        The target is the node with index ``node`` on the site's axon."""
        electrodes = self.profile.electrodes
        target_mm = self.axon_mm(site)[node, :2] if node else electrodes.position_mm[site]
        away = np.linalg.norm(self._own_position_mm - target_mm, axis=1)
        return np.asarray(away > electrodes.pitch_mm + 1e-9)

    def full_ma(self, site: int) -> float:
        """Return the strongest comfortable current at a site, mA."""
        return float(self.profile.full_ma[site])

    def axon(self, site: int) -> Array:
        """Return the AF rows of the target's axon, (K, E); row 0 is under the electrode."""
        sets = along_axon(self.profile, self.afferent, site)
        return np.concatenate([af_matrix(self.profile, one, self.profile.skin) for one in sets])

    def axon_mm(self, site: int) -> Array:
        """Return the places of the nodes of `axon`, (K, 3) mm: x, y and depth."""
        sets = along_axon(self.profile, self.afferent, site)
        return np.concatenate(
            [np.c_[one.position_mm, np.full(len(one.position_mm), one.depth_mm)] for one in sets]
        )

    def representative(self, site: int) -> tuple[int, NDArray[np.intp]]:
        """Return the lowest site that a symmetry maps to ``site``, and the symmetry as a
        permutation of the electrodes."""
        moves = [(int(np.flatnonzero(move == site)[0]), move) for move in self.symmetries]
        return min(moves, key=lambda pair: pair[0])

    def orbits(self, site: int) -> Array:
        """Return the orbits, (E, O): a column is 1 at the electrodes of its orbit, else 0.
        Symmetries that keep the site in place map the electrodes of an orbit to each other. Masked
        electrodes have no orbit."""
        mirrors = np.array([move for move in self.symmetries if move[site] == site])
        _, orbit = np.unique(mirrors.min(axis=0)[self.driven], return_inverse=True)
        patterns = np.zeros((self.electrodes, orbit.max() + 1))
        patterns[self.driven, orbit] = 1.0
        return patterns

    def judge(
        self,
        weights: Array,
        site: int,
        node: int = 0,
        kind: KernelKind = "weighted",
        gap: float = 0.0,
    ) -> Kernel:
        """Return the kernel for a pattern, with off-target and spill. Its weights are scaled to an
        AF of 1 V/mm² at the target. Raises DesignError if the pattern does not activate the
        target."""
        far = self.beyond_a_pitch(site, node)
        aim = self.target[site] if node == 0 else self.axon(site)[node]
        own_af = float(aim @ weights)
        if own_af <= 0:
            raise DesignError(
                f"the pattern for {self.describe(site)} does not activate its target: change the "
                "array, or the afferent depths in its profile",
                electrode=site,
            )
        others = self.other @ weights
        highest = float(others.max())
        # Often two classes are activated equally. Rounding errors must not decide which is named.
        alike = others >= highest - _ALIKE * abs(highest)
        whose = int(self.other_class[alike].min())
        spill = max(float((self.own @ weights)[far].max(initial=-np.inf)) / own_af, 0.0)
        scaled = weights / own_af
        # Remove rounding errors of the solver: currents must sum to zero.
        if kind == "weighted":
            scaled[self.driven] -= scaled[self.driven].mean()
        return Kernel(scaled, highest / own_af, Afferent(whose), spill, node, kind, gap)
