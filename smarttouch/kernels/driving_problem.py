"""The design problem on driving functions: rows are drives, and 1 is a fiber's threshold.

Classes differ in their fibers, as in an anatomy, and so in how little current fires them; the
activating function takes them as alike. Fibers are straight, as in the paper's anatomy.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.design_problem import Array, Problem
from smarttouch.kernels.switched_design import polarity
from smarttouch.physiology.activating_function import Afferents, potential_mv, targets
from smarttouch.physiology.anatomy import ClassAnatomy, load_anatomy
from smarttouch.physiology.driving_function import DrivingFunction, End, load_driving
from smarttouch.profile import Profile, Skin

_BELOW = (0, 1, 2, 3, 5, 8, 12, 18)
"""Nodes of a rising fiber that are looked at, from its ending on: densest where it is shallow."""
_SPACING_MM = 0.1
"""Largest distance of places that are looked at."""
_ROUND_MM = 9
_AT_ONCE = 2048


class DrivingProblem(Problem):
    """Drives of one class's targets, of the other classes, and of its own, in homogeneous skin."""

    def __init__(self, profile: Profile, afferent: Afferent, spread: bool = False) -> None:
        anatomy = load_anatomy("paper")
        self.anatomy: dict[Afferent, ClassAnatomy] = {each: anatomy.of(each) for each in Afferent}
        spacing_mm = min(profile.skin.node_spacing_mm, _SPACING_MM)
        skin = profile.skin.model_copy(update={"node_spacing_mm": spacing_mm})
        finer = profile.model_copy(update={"skin": skin})
        super().__init__(finer, afferent, spread=spread)

    def driving(self, nodes: Afferents) -> DrivingFunction:
        """Return the driving function of a set of nodes."""
        end: End = "through"
        if nodes.ending is not None:
            end = "active" if nodes.ending == "active" else "passive"
        fiber = self.anatomy[nodes.afferent].fiber
        return load_driving(fiber, end, self.profile.pulse.width_us)

    def axon(self, site: int) -> Array:
        """Return the rows of the target's own axon, the one to fire first."""
        one = targets(self.profile, self.afferent)
        if one.ending is None:
            return super().axon(site)
        count = self.electrodes
        rows = self._matrix(one, self.profile.skin).reshape(-1, count, count)[:, site]
        return np.concatenate([self.target[site][None], rows])

    def _by_direction(self, aim: Afferents, skin: Skin) -> Array:
        """Return the rows of the node that a lone electrode fires, (D, E, E)."""
        count, layers = self.electrodes, self._layers(aim) // len(aim.direction)
        rows = self._matrix(aim, skin).reshape(-1, layers, count, count)
        sign = 1 if polarity(self.profile, self.afferent) == "cathodic" else -1
        alone = sign * np.trace(rows, axis1=2, axis2=3)
        return np.asarray(rows[np.arange(len(rows)), alone.argmax(axis=1)])

    def _layers(self, nodes: Afferents) -> int:
        return len(nodes.direction) * (1 if nodes.ending is None else len(_BELOW))

    def _matrix(self, nodes: Afferents, skin: Skin) -> Array:
        driving = self.driving(nodes)
        reach = len(driving.along)
        if nodes.ending is None:
            steps, below = np.arange(-reach, reach + 1), [reach - 1]
        else:
            steps, below = np.arange(max(_BELOW) + reach + 2), list(_BELOW)
        operator = driving.operator(len(steps))[below]
        operator = operator / self.anatomy[nodes.afferent].threshold_factor
        along_mm = np.asarray(steps * driving.internode_mm, np.float64)
        places, electrodes, which = nodes.position_mm, self.profile.electrodes, None
        shared = _displacements(places, electrodes.position_mm)
        if shared is not None and len(electrodes.kinds) == 1:
            places, which = shared
            # One electrode is no array: the second one's column is not used.
            one = np.array([[0.0, 0.0], [electrodes.pitch_mm, 0.0]])
            electrodes = replace(electrodes, position_mm=one)
        found = []
        for direction in nodes.direction:
            layers = np.empty((len(below), len(places), len(electrodes)))
            for first in range(0, len(places), _AT_ONCE):
                part = slice(first, first + _AT_ONCE)
                points = fiber_points(places[part], nodes.depth_mm, direction, along_mm)
                potential = potential_mv(self.profile, points, electrodes)
                layers[:, part] = np.swapaxes(operator @ potential, 0, 1)
            every = layers if which is None else layers[..., 0][:, which]
            found.append(every.reshape(-1, self.electrodes))
        return np.concatenate(found)


def _displacements(place_mm: Array, electrode_mm: Array) -> tuple[Array, NDArray[np.intp]] | None:
    """Return distinct displacements (D, 2) mm and their index, (N, E); None if too many differ."""
    sides, which = [], []
    for place, electrode in zip(place_mm.T, electrode_mm.T, strict=True):
        own, row = np.unique(place.round(_ROUND_MM), return_inverse=True)
        away = (own[:, None] - electrode).round(_ROUND_MM)
        side, index = np.unique(away, return_inverse=True)
        sides.append(side)
        which.append(index.reshape(away.shape)[row])
    if 2 * len(sides[0]) * len(sides[1]) >= which[0].size:
        return None
    x, y = np.meshgrid(*sides)
    return np.column_stack([x.ravel(), y.ravel()]), which[1] * len(sides[0]) + which[0]


def fiber_points(
    position_mm: Array, depth_mm: float, direction: Array, along_mm: NDArray[Any]
) -> Array:
    """Return points along straight fibers through places at one depth, (N, K, 3) mm."""
    origin = np.column_stack([position_mm, np.full(len(position_mm), depth_mm)])
    return np.asarray(origin[:, None] + along_mm[:, None] * direction)
