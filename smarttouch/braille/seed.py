"""Seed of a lattice fit: skew, pitch and phase in one part of a page."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import cKDTree

from smarttouch.braille.comb import COLUMNS, ROWS, Comb, fit_comb

Points = NDArray[np.floating[Any]]

PITCH_SIGMAS = (4.0, 11.0)
"""Range of the dot pitch, in scales of a found dot."""
MOST_SKEW_DEG = 30.0
PART_SIGMAS = 120.0
"""Side of the part, some 20 dot pitches: a photograph is straight and even over it."""
MOST_DOTS = 400
_BINS_PER_SIGMA = 3
_TRIED = 2
"""Guesses of skew and pitch to try on the rows and columns."""
_HOPELESS = 0.0
"""Gain per dot, in nats, below which there is no Braille: rough guesses on it have 0.8 and more."""
_ROUGH_TURNS_DEG = (-2.0, 0.0, 2.0)
_FINE_TURNS_DEG = (-3.0, -2.2, -1.5, -0.7, 0.0, 0.7, 1.5, 2.2, 3.0)
"""Tried around a guess; rows and columns need not stand upright on one another."""


@dataclass(frozen=True, eq=False)
class Seed:
    """A lattice in one part of a page.

    Attributes
    ----------
    center_px : ndarray, (2,) px
        Of the part of the page that it was fitted to.
    across, down : ndarray, (2,) per px
        The directions in which columns and lines are counted.
    columns, rows : Comb
        Laid on the places along them, px from the center.
    dots : int
        Number of dots in that part.
    """

    center_px: NDArray[np.float64]
    across: NDArray[np.float64]
    down: NDArray[np.float64]
    columns: Comb
    rows: Comb
    dots: int

    @property
    def gain(self) -> float:
        """Gain in log likelihood per dot by this lattice, nats: 3.5 if all fit."""
        return (self.columns.gain + self.rows.gain) / self.dots


def find_seed(px: Points, sigma_px: float) -> Seed:
    """Return the likeliest lattice of the part of the page that has most dots.

    Parameters
    ----------
    px : ndarray, (N, 2) px
        Dots, at least two.
    sigma_px : float, px
        Scale at which they were found.
    """
    center = _crowd(px, PART_SIGMAS / 2 * sigma_px)
    apart = np.abs(px - center).max(axis=1)
    nearest = np.argsort(apart, kind="stable")[:MOST_DOTS]
    part = px[nearest[apart[nearest] <= PART_SIGMAS / 2 * sigma_px]] - center
    guesses = [_lay(part, center, *guess, _ROUGH_TURNS_DEG) for guess in _guesses(part, sigma_px)]
    best = max(guesses, key=lambda seed: seed.gain)
    if best.gain < _HOPELESS:
        return best
    # Halfway between how lines are turned and how columns are.
    right, down = best.across, best.down
    skew = math.atan2(right[1] - down[0], right[0] + down[1])
    return _lay(part, center, skew, best.rows.pitch, _FINE_TURNS_DEG)


def _crowd(px: Points, reach_px: float) -> NDArray[np.float64]:
    """Return the dot with the most others around it."""
    few = px[:: max(1, len(px) // 500)]
    around = cKDTree(px).query_ball_point(few, reach_px, return_length=True)
    return np.asarray(few[int(np.argmax(around))], np.float64)


def _guesses(part: Points, sigma_px: float) -> list[tuple[float, float]]:
    """Return the likeliest skews, rad, and dot pitches, px.

    Next to a dot there is often one across and one down, at one distance.
    """
    least, largest = (each * sigma_px for each in PITCH_SIGMAS)
    pairs = cKDTree(part).query_pairs(1.1 * largest, output_type="ndarray")
    step = part[pairs[:, 1]] - part[pairs[:, 0]]
    step = np.vstack([step, -step]).astype(np.float64) / sigma_px
    edge = 1.1 * PITCH_SIGMAS[1]
    bins = 2 * math.ceil(edge * _BINS_PER_SIGMA) + 1
    seen, _ = np.histogramdd(step, bins=bins, range=[(-edge, edge)] * 2)
    seen = gaussian_filter(seen, 0.35 * _BINS_PER_SIGMA)
    pitch = np.geomspace(least, largest, 48)
    angle = np.radians(np.arange(0, 180, 1.5))
    x, y = np.cos(angle)[:, None] * pitch, np.sin(angle)[:, None] * pitch
    at = (np.array([x, y]) / sigma_px + edge) / (2 * edge) * bins - 0.5
    ring = map_coordinates(seen, at, order=1)
    ring -= ring.mean(axis=0)
    both = ring + np.roll(ring, len(angle) // 2, axis=0)
    skew = (np.degrees(angle) + 45) % 90 - 45
    both[np.abs(skew) > MOST_SKEW_DEG] = -np.inf
    guesses: list[tuple[float, float]] = []
    while len(guesses) < _TRIED:
        row, column = np.unravel_index(int(both.argmax()), both.shape)
        guesses.append((math.radians(skew[row]), float(pitch[column])))
        near = np.abs(np.log(pitch / pitch[column])) < 0.15
        turned = np.abs((skew - skew[row] + 45) % 90 - 45) < 8
        both[np.ix_(turned, near)] = -np.inf
    return guesses


def _lay(
    part: Points,
    center: NDArray[np.float64],
    skew: float,
    pitch_px: float,
    turns_deg: tuple[float, ...],
) -> Seed:
    """Return the seed whose rows and columns fit best, each with one of the fine rotations."""
    laid = []
    for angle, teeth in ((skew, COLUMNS), (skew + math.pi / 2, ROWS)):
        turned = [angle + math.radians(turn) for turn in turns_deg]
        axes = [np.array([math.cos(each), math.sin(each)]) for each in turned]
        combs = [fit_comb(part @ axis, pitch_px, teeth) for axis in axes]
        best = max(range(len(combs)), key=lambda each: combs[each].gain)
        laid.append((axes[best], combs[best]))
    (across, columns), (down, rows) = laid
    return Seed(center, across, down, columns, rows, len(part))
