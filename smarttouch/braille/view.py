"""Dots found on a page of Braille by one appearance, and their fit to cells."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from smarttouch.braille.dots import FoundDots, Look, find_dots
from smarttouch.braille.lattice import BY_CHANCE, NEAR, Lattice, Names, grow_lattice, nearest_only
from smarttouch.braille.seed import find_seed

FEWEST_DOTS = 10
"""Fewest dots; fewer fit some lattice by chance."""
_STRONG = 0.5
"""Part of the usual strength of dots for the lattice fit, unless a gap separates them better."""
_GAP = 0.8
"""Least part of the variance of strengths between two groups: even spread has 0.75."""
_TIMES = 1.2
"""Ratio of the mean strengths of the two groups."""
_LEAST_GAIN = 0.5
"""Least gain in nats per dot: Braille has 1.8 and more, texts and photographs 0.5 and less."""
_AROUND = 12
_LEAST_AROUND = 0.6
"""Least part of strong dots around a place that fit; with less they are dirt beside the text."""
_FEW = 12.0
"""Number of dots at which certainty is lower by a third."""
_ALONE = 14.0
"""Distance from all other dots, in pitches, at which a dot is dirt: five cells or three lines."""
_MOST_DIRT = 0.02
"""Largest share of dots that do not fit, among those as weak as the ones read."""


@dataclass(frozen=True, eq=False)
class View:
    """Result of one look at a page.

    Attributes
    ----------
    image : ndarray, (H, W) float32
        Image under even light, see `even_light`.
    dots : FoundDots
        In pixels of that image.
    lattice : Lattice
        Fitted to the strong ones.
    names : ndarray, (N, 4) int
        Cell and number of each dot, as in `Lattice.name`.
    inside : ndarray, (N,) bool
        Whether each lies within the text.
    fit : ndarray, (N,) bool
        Whether each of those lies at its place.
    strong : ndarray, (N,) bool
        Whether each is strong.
    certainty : float, in [0, 1]
        Fit of strong dots of the lines to cells, beyond chance.
    """

    image: NDArray[np.float32]
    dots: FoundDots
    lattice: Lattice
    names: Names
    inside: NDArray[np.bool_]
    fit: NDArray[np.bool_]
    strong: NDArray[np.bool_]
    certainty: float

    @property
    def proven(self) -> NDArray[np.bool_]:
        """Certain dots, (N,) bool: strong ones that fit."""
        return self.fit & self.strong

    def contrast(self) -> float:
        """Return the contrast that four in five proven dots reach, of the paper's grey."""
        return self.dots.usual * float(np.percentile(self.dots.strength[self.proven], 20))

    def read(self) -> NDArray[np.bool_]:
        """Return which dots to read, (N,) bool: down to where dirt is as strong, none alone."""
        strength = self.dots.strength
        levels = np.arange(0.3, 0.85, 0.05)
        fitting = np.array([(self.fit & (strength >= level)).sum() for level in levels])
        dirt = np.array([(self.inside & (strength >= level)).sum() for level in levels]) - fitting
        clean = np.flatnonzero(dirt <= _MOST_DIRT * fitting)
        level = levels[clean[0]] if len(clean) else levels[-1]
        read = self.fit & (strength >= level)
        if read.sum() > 1:
            apart, _ = cKDTree(self.dots.px[read]).query(self.dots.px[read], k=2)
            read[read] = np.asarray(apart)[:, 1] < _ALONE * self.lattice.pitch_px()
        return np.asarray(read)


def look_at(image: NDArray[np.float32], look: Look) -> View | None:
    """Return the view of a page, None if it is not like cells at all.

    Parameters
    ----------
    image : ndarray, (H, W) float32
        Made by `even_light`.
    look : Look
        Expected appearance of dots.
    """
    dots = find_dots(image, look)
    strong = dots.strength >= _strong_level(dots.strength)
    if strong.sum() < FEWEST_DOTS:
        return None
    seed = find_seed(dots.px[strong], look.sigma_px)
    if seed.gain < _LEAST_GAIN:
        return None
    lattice = grow_lattice(dots.px[strong], seed)
    if not lattice.is_regular():
        return None
    names, away = lattice.name(dots.px)
    fit = nearest_only(names, away) & (away < NEAR)
    inside = _inside(dots.px, strong, fit)
    fit &= inside
    block = strong & inside
    certainty = _certainty(away[block], fit[block], len(lattice.weights) + 1)
    return View(image, dots, lattice, names, inside, fit, strong, certainty)


def _strong_level(strength: NDArray[np.float64]) -> float:
    """Return the level between two groups of strengths (Otsu's way), or half of the usual one.

    On a page embossed from both sides, the rims of the back's dots are the weaker group.
    """
    if len(strength) < 2 * FEWEST_DOTS:
        return _STRONG
    falling = np.sort(strength)[::-1]
    count = np.arange(1, len(falling))
    above = np.cumsum(falling)[:-1] / count
    below = (falling.sum() - above * count) / (len(falling) - count)
    between = count * (len(falling) - count) * (above - below) ** 2 / len(falling) ** 2
    cut = int(between.argmax())
    mixed = between[cut] < _GAP * falling.var() or above[cut] < _TIMES * below[cut]
    if mixed or cut < FEWEST_DOTS:
        return _STRONG
    return max(_STRONG, float(falling[cut] + falling[cut + 1]) / 2)


def _inside(
    px: NDArray[np.float64], strong: NDArray[np.bool_], fit: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return which dots, (N,) bool, are in a text: most strong ones around them fit."""
    fitting = fit[strong]
    _, around = cKDTree(px[strong]).query(px, k=min(_AROUND, len(fitting)))
    return np.asarray(fitting[around].mean(axis=1) >= _LEAST_AROUND)


def _certainty(away: NDArray[np.float64], fit: NDArray[np.bool_], free: int) -> float:
    """Return the certainty that dots, (N,), make cells, given how many fit by chance."""
    count = int(fit.sum())
    if count <= free:
        return 0.0
    share = (count / len(fit) - BY_CHANCE) / (1 - BY_CHANCE)
    # Dots that are near by chance are anywhere near: half the square of NEAR away.
    spread = float(np.sum(away[fit] ** 2)) / (count - free) / (NEAR**2 / 2)
    return max(0.0, share) * max(0.0, 1 - spread) * (1 - math.exp(-count / _FEW))
