"""Courses of a finger's afferents: where each branch begins, bends and goes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.afferent import Afferent
from smarttouch.physiology.anatomy import Bystander, ClassAnatomy

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Population:
    """Afferents of one class, each with one or more branches."""

    afferent: Afferent | Bystander
    receptor_mm: Array  # (A, 2) middle of each afferent's endings, where its spikes are perceived
    course_mm: Array  # (B, P, 3) corners of each branch, ending first; z is the depth
    owner: NDArray[np.intp]  # (B,) afferent of each branch
    factor: Array  # (A,) threshold relative to the class's
    anatomy: ClassAnatomy


def course_points(
    one: Population, branches: NDArray[np.intp], nodes: int, spacing_mm: float
) -> Array:
    """Return places of nodes along branches, (B, N, 3) mm, ending first."""
    points = _along(one.course_mm[branches], np.arange(nodes, dtype=np.float64) * spacing_mm)
    return _rounded(points, int(one.anatomy.bend_mm / spacing_mm / 2))


def course_length_mm(course_mm: Array, corners: int) -> Array:
    """Return the lengths of courses up to a corner, (B,) mm."""
    steps = np.linalg.norm(np.diff(course_mm[:, : corners + 1], axis=1), axis=2)
    return np.asarray(steps.sum(axis=1))


def _along(course_mm: Array, along_mm: Array) -> Array:
    """Return places along courses, (B, N, 3), at distances from their ends, (N,)."""
    steps = np.diff(course_mm, axis=1)
    lengths = np.linalg.norm(steps, axis=2)
    begins = np.cumsum(lengths, axis=1) - lengths
    points = np.repeat(course_mm[:, :1], len(along_mm), axis=1)
    for index in range(steps.shape[1]):
        last = index == steps.shape[1] - 1
        done = along_mm - begins[:, index, None]
        # A course goes straight on beyond its last corner.
        done = np.maximum(done, 0) if last else np.clip(done, 0, lengths[:, index, None])
        length = np.maximum(lengths[:, index], 1e-12)
        points += done[..., None] * (steps[:, index] / length[:, None])[:, None]
    return np.asarray(points)


def _rounded(points_mm: Array, reach: int) -> Array:
    """Return courses with bends rounded by running means over `reach` nodes to either side."""
    reach = min(reach, points_mm.shape[1] - 1)
    if reach < 1:
        return points_mm
    pad = ((0, 0), (reach + 1, reach), (0, 0))
    sums = np.cumsum(np.pad(points_mm, pad, mode="reflect", reflect_type="odd"), axis=1)
    return np.asarray((sums[:, 2 * reach + 1 :] - sums[:, : -2 * reach - 1]) / (2 * reach + 1))
