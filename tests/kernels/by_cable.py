"""Kernels judged by the cable model: thresholds of fibers to fire and of others."""

from dataclasses import dataclass, replace

import numpy as np

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.driving_problem import fiber_points
from smarttouch.physiology.activating_function import everywhere, potential_mv, targets
from smarttouch.physiology.driving_function import FIBERS
from smarttouch.physiology.membrane import thresholds_ma

from ..fit_fibers import fiber_cases

_APART_MM = 0.5
_EARLY = 0.6


@dataclass(frozen=True)
class CableJudgement:
    """Thresholds of one kernel by the cable model.

    That of the target's fiber, of what the driving function predicts, and over the lowest of
    another class's fibers; 0 if none fires.
    """

    target: float
    off_target: float


def judge_by_cable(problem, weights, site, count=8):
    """Return the thresholds of fibers under a kernel, (E,) mA, of a problem without a spread.

    Of each set of the other classes so many fibers are judged: where the driving function is
    largest, half a millimeter or more apart.
    """
    aim = targets(problem.profile, problem.afferent)
    place = aim.position_mm[[site]]
    aimed = float(problem.target[site] @ weights)
    own = _thresholds(problem, aim, place, aim.direction[:1], weights / aimed, np.ones(1))[0]
    best, start = np.inf, 0
    for afferent in [each for each in Afferent if each is not problem.afferent]:
        nodes = everywhere(problem.profile, afferent)
        rows = problem._layers(nodes) * len(nodes.position_mm)
        drive = problem.rows[0].other[start : start + rows] @ weights / aimed
        start += rows
        layers = drive.reshape(len(nodes.direction), -1, len(nodes.position_mm)).max(axis=1)
        for direction, along in zip(nodes.direction, layers, strict=True):
            places = _highest(nodes.position_mm, along, count)
            toward = np.tile(direction, (len(places), 1))
            placed = nodes.position_mm[places]
            found = _thresholds(problem, nodes, placed, toward, weights / aimed, along[places])
            best = min(best, float(np.nanmin(found, initial=np.inf)))
    return CableJudgement(float(own), float(own / best))


def _highest(position_mm, drive, count):
    """Return places of the highest drives, apart from one another and above zero."""
    chosen = []
    left = np.flatnonzero(drive > 0)
    while len(left) and len(chosen) < count:
        chosen.append(int(left[drive[left].argmax()]))
        away = np.linalg.norm(position_mm[left] - position_mm[chosen[-1]], axis=1)
        left = left[away > _APART_MM]
    return np.array(chosen, np.intp)


def _thresholds(problem, nodes, position_mm, direction, current_ma, drive):
    """Return thresholds of straight fibers, of the currents given."""
    if not len(position_mm):
        return np.zeros(0)
    like, driving = problem.anatomy[nodes.afferent], problem.driving(nodes)
    fiber = replace(FIBERS[like.fiber], end=driving.end)
    places = fiber_cases.along_mm(
        driving.end, fiber.internode_mm, 4.0 if fiber.internode_mm < 0.2 else 8.0
    )
    points = np.concatenate(
        [
            fiber_points(one[None], nodes.depth_mm, toward, places)
            for one, toward in zip(position_mm, direction, strict=True)
        ]
    )
    potentials = potential_mv(problem.profile, points) @ current_ma
    width = problem.profile.pulse.width_us
    near = _EARLY / np.maximum(drive * like.threshold_factor, 1e-3)
    return like.threshold_factor * thresholds_ma(potentials, fiber, width, near, step_us=width / 50)
