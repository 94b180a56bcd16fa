"""Lattice of a page of Braille: assignment of dots to cells."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.braille.cells import BLANK, dots_to_cells
from smarttouch.braille.comb import COLUMNS, ROWS
from smarttouch.braille.seed import Seed

Points = NDArray[np.floating[Any]]
Names = NDArray[np.int_]

NEAR = 0.22
"""Largest distance of a dot from its place of the lattice, in dot pitches."""
BY_CHANCE = 0.08
"""Share of random dots that are so near: six discs in a cell."""
_FIRST_REACH = 12.0
"""Radius around the seed, in dot pitches, that is assigned first."""
_GROWTH = 1.25
"""Factor by which the assigned part of the page grows."""
_DEGREES = ((24, 1), (100, 2), (math.inf, 3))
"""Degree of the fit up to a number of dots: rotated and sheared; in perspective; bent."""
_MOST_ROUNDS = 40
_MOST_CELLS = 500.0
"""Largest distance from the page's middle, in cells: no picture resolves more."""
_LEAST_SINE = 0.9
_MOST_RATIO = 1.3
"""Largest ratio of pitches, for a page tilted by 40° to the camera."""


@dataclass(frozen=True, eq=False)
class Lattice:
    """Places of cells in a picture.

    A map from the picture to columns and lines of cells: polynomials, as
    perspective and bent paper are gentle over a page.

    Attributes
    ----------
    center_px : ndarray, (2,) px
    scale_px : float, px
        Places are taken from the center and divided by the scale first.
    weights : ndarray, (T, 2)
        Of the powers of x and y; they give a column and a line, whole numbers
        at the first dot of each cell.
    dot_part : ndarray, (2,)
        Distance of dots, of that of cells and of that of lines.
    """

    center_px: NDArray[np.float64]
    scale_px: float
    weights: NDArray[np.float64]
    dot_part: NDArray[np.float64]

    def place(self, px: Points) -> NDArray[np.float64]:
        """Return column and line, (N, 2), of places in the picture, (N, 2) px."""
        powers = _powers((px - self.center_px) / self.scale_px, len(self.weights))
        return np.asarray(powers @ self.weights)

    def name(self, px: Points) -> tuple[Names, NDArray[np.float64]]:
        """Return the dot nearest to each place.

        Returns
        -------
        names : ndarray, (N, 4) int
            Column and line of the cell; column and row of the dot in it.
        away : ndarray, (N,)
            Distance of that dot, in dot pitches.
        """
        place = self.place(px)
        beyond = (np.abs(place) > _MOST_CELLS).any(axis=1)
        place = np.clip(place, -_MOST_CELLS, _MOST_CELLS)
        names = np.empty((len(px), 4), int)
        apart = np.empty((len(px), 2))
        for axis, teeth in enumerate((COLUMNS, ROWS)):
            part = self.dot_part[axis]
            offset = place[:, axis, None] - part * np.arange(len(teeth.share))
            group = np.rint(offset)
            tooth = np.abs(offset - group).argmin(axis=1)
            each = np.arange(len(px))
            names[:, axis], names[:, 2 + axis] = group[each, tooth], tooth
            apart[:, axis] = (offset - group)[each, tooth] / part
        return names, np.where(beyond, np.inf, np.hypot(*apart.T))

    def pitch_px(self) -> float:
        """Return the distance of dots in the middle, px."""
        return float(np.linalg.norm(self.steps(), axis=1).mean())

    def is_regular(self) -> bool:
        """Return whether the steps to the right and down are about equal, and perpendicular.

        A map that was fitted to clutter is not, or has folded.
        """
        slope = self.weights[1:3].T
        if abs(np.linalg.det(slope)) < 1e-3 * float((slope**2).sum()):
            return False
        right, down = self.steps()
        across, along = np.linalg.norm(right), np.linalg.norm(down)
        sine = (right[0] * down[1] - right[1] * down[0]) / (across * along)
        return bool(sine > _LEAST_SINE and max(across, along) < _MOST_RATIO * min(across, along))

    def steps(self) -> NDArray[np.float64]:
        """Return the steps to the dot on the right and the dot below, (2, 2) px, in the middle."""
        slope = np.linalg.inv(self.weights[1:3].T / self.scale_px)
        return np.asarray((slope * self.dot_part).T)


def grow_lattice(px: Points, seed: Seed) -> Lattice:
    """Fit a lattice to dots, some of them false, outwards from a seed.

    Parameters
    ----------
    px : ndarray, (N, 2) px
        Dots.
    seed : Seed
        Made of some of them.
    """
    lattice = _from_seed(seed)
    away_px = np.linalg.norm(px - seed.center_px, axis=1)
    reach_px = _FIRST_REACH * seed.rows.pitch
    last = -1
    for _ in range(_MOST_ROUNDS):
        names, away = lattice.name(px)
        named = nearest_only(names, away) & (away < NEAR) & (away_px <= reach_px)
        whole = reach_px > away_px.max()
        if whole and named.sum() == last:
            break
        last = int(named.sum()) if whole else -1
        lattice = _refit(lattice, px[named], names[named])
        reach_px *= _GROWTH
    return _upright(lattice, px)


def nearest_only(names: Names, away: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which dots are the nearest of those with the same assignment, (N,) bool."""
    order = np.argsort(away, kind="stable")
    shifted = names - names.min(axis=0, initial=0)
    codes = np.ravel_multi_index(tuple(shifted.T), tuple(shifted.max(axis=0, initial=0) + 1))
    _, first = np.unique(codes[order], return_index=True)
    nearest = np.zeros(len(away), bool)
    nearest[order[first]] = True
    return nearest


def cell_lines(names: Names) -> list[str]:
    """Return the lines of cells formed by dots.

    Blank cells stand before and between others where there is room for them,
    none at the end of a line; a line without dots is empty.

    Parameters
    ----------
    names : ndarray, (N, 4) int
        As `Lattice.name` gives them.
    """
    if not len(names):
        return []
    column, line = (names[:, :2] - names[:, :2].min(axis=0)).T
    raised = np.zeros((line.max() + 1, column.max() + 1, 6), bool)
    raised[line, column, 3 * names[:, 2] + names[:, 3]] = True
    return [dots_to_cells(each).rstrip(BLANK) for each in raised]


def _from_seed(seed: Seed) -> Lattice:
    columns, rows = seed.columns, seed.rows
    scale_px = _FIRST_REACH * rows.pitch
    weights = np.zeros((3, 2))
    weights[0] = -columns.first / columns.period, -rows.first / rows.period
    weights[1:, 0] = seed.across * scale_px / columns.period
    weights[1:, 1] = seed.down * scale_px / rows.period
    part = np.array([columns.pitch / columns.period, rows.pitch / rows.period])
    return Lattice(seed.center_px, scale_px, weights, part)


def _refit(lattice: Lattice, px: Points, names: Names) -> Lattice:
    """Return the lattice that fits these dots best, by least squares."""
    if len(px) < 6:
        return lattice
    degree = next(degree for most, degree in _DEGREES if len(px) <= most)
    center = px.mean(axis=0)
    scale = float(np.abs(px - center).max()) or 1.0
    powers = _powers((px - center) / scale, (degree + 1) * (degree + 2) // 2)
    weights = np.empty((powers.shape[1], 2))
    part = lattice.dot_part.copy()
    for axis, teeth in enumerate((COLUMNS, ROWS)):
        group, tooth = names[:, axis].astype(float), names[:, 2 + axis]
        if len(np.unique(group)) > 2 and np.ptp(tooth):
            # The distance of dots is one more unknown: it is what the group number lacks.
            weight = _solve(np.column_stack([powers, -tooth]), group)
            least, _, largest = teeth.period
            part[axis] = np.clip(weight[-1], 1 / largest, 1 / least)
        group += part[axis] * tooth
        weights[:, axis] = _solve(powers, group)
    return Lattice(center, scale, weights, part)


def _solve(terms: Points, values: Points) -> Points:
    """Return weights of terms, (N, T), that fit values, (N,): the smallest with the least error."""
    # A fraction of the time that lstsq takes on the terms themselves; they are tame.
    return np.asarray(np.linalg.lstsq(terms.T @ terms, terms.T @ values, rcond=1e-10)[0])


def _upright(lattice: Lattice, px: Points) -> Lattice:
    """Return the lattice with its first row and column in use, as a text uses them."""
    names, away = lattice.name(px)
    names = names[away < NEAR]
    weights = lattice.weights.copy()
    if len(names):
        weights[0] -= names[:, 2:].min(axis=0) * lattice.dot_part
    return Lattice(lattice.center_px, lattice.scale_px, weights, lattice.dot_part)


def _powers(place: Points, terms: int) -> NDArray[np.float64]:
    """Return 1, x, y, x², xy, y², ... of places, (N, terms)."""
    x, y = np.asarray(place, np.float64).T
    degree = 0
    powers: list[NDArray[np.float64]] = []
    while len(powers) < terms:
        powers += [x ** (degree - down) * y**down for down in range(degree + 1)]
        degree += 1
    return np.column_stack(powers)
