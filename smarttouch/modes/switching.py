"""Kernels for boards that switch one source instead of weighting many."""

from itertools import chain, combinations

import numpy as np

from smarttouch.errors import DesignError
from smarttouch.modes.design import SPILL, Kernel, Problem
from smarttouch.primary import Primary

SHELLS = 10
"""Rings of neighbors, by distance, that a return may be made of."""

_POLE = {Primary.RA: -1.0, Primary.SAI: 1.0, Primary.PC: 1.0}
"""What a target needs above it: RA an anode, SAI and PC a cathode (Fig. 10)."""


def polarity(primary: Primary) -> str:
    """Return which pole stands over the target of a mode."""
    return "anodic" if _POLE[primary] < 0 else "cathodic"


def design_three_state(problem: Problem, site: int) -> Kernel:
    """Choose cathode, anode and insulated for one source (paper, Fig. 19).

    The target's electrode is one pole; the other is made of whole rings of
    neighbors, every subset of the nearest `SHELLS` rings being tried. The
    source's current divides equally. Of the choices whose own-class spill
    stays within `SPILL` the most selective is taken; where none does, the one
    with the least sum of worst other and spill.
    """
    distance = problem.profile.electrodes.distance_mm[site].round(6)
    rings = [np.flatnonzero(distance == ring) for ring in np.unique(distance)[1 : SHELLS + 1]]
    choices = chain.from_iterable(combinations(rings, size) for size in range(1, len(rings) + 1))
    candidates = np.array([_divided(problem, site, np.concatenate(rings)) for rings in choices])
    own = candidates @ problem.target[site]
    candidates, own = candidates[own > 0], own[own > 0]
    if not len(own):
        raise DesignError(
            f"no switching pattern activates {problem.primary.name} at site {site}: "
            "its electrodes are too far apart for its depth"
        )
    worst = (problem.other @ candidates.T).max(axis=0) / own
    far = problem.own_beyond_a_pitch(site)
    spill = (far @ candidates.T).max(axis=0) / own if len(far) else np.zeros_like(own)
    confined = spill <= SPILL
    score = np.where(confined, worst, np.inf) if confined.any() else worst + spill
    return problem.judge(candidates[int(np.argmin(score))], site)


def design_one_against_all(problem: Problem, site: int) -> Kernel:
    """Return the only pattern such a board has: one electrode against all others."""
    others = np.flatnonzero(np.arange(problem.target.shape[1]) != site)
    return problem.judge(_divided(problem, site, others), site)


def _divided(problem: Problem, site: int, others: np.ndarray) -> np.ndarray:
    weights = np.zeros(problem.target.shape[1])
    weights[others] = -_POLE[problem.primary] / len(others)
    weights[site] = _POLE[problem.primary]
    return weights
