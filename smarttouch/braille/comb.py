"""Periodic rows or columns of dots along one axis."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

BINS = 96
"""Bins of a period."""
SPREAD = 0.08
"""Initial spread of dots around their places, as a part of the dot pitch."""
CLUTTER = 0.15
"""Initial share of false dots."""


@dataclass(frozen=True)
class Teeth:
    """Prior knowledge of one axis of Braille.

    Attributes
    ----------
    share : tuple of float
        Share of dots at each tooth. The first a little more than the others:
        where a page leaves it open which dots it uses, they are the first.
    period : tuple of float
        Least, usual and largest distance of groups, in dot pitches.
    """

    share: tuple[float, ...]
    period: tuple[float, float, float]


COLUMNS = Teeth((0.53, 0.47), (2.25, 2.65, 3.15))
"""Teeth of a cell's columns: 6.2 mm for dots of 2.34 mm (NLS 800); standards differ, from 5.9/2.5
to 7.6/2.5.
"""
ROWS = Teeth((0.36, 0.34, 0.30), (3.6, 4.27, 5.1))
"""Teeth of a line's rows: 10.0 mm for dots of 2.34 mm; standards vary, 9.5/2.54 to 11/2.2."""
_STRETCHES = (0.93, 0.965, 1.0, 1.035, 1.07)
"""Factors of the pitch to try."""
_STEPS = (16, 32, 64, 128)
"""Numbers of periods to try."""
_DOUBT = 6.0
"""Twice the nats that a period loses if it is off by a tenth: what is usual decides where dots
do not."""


@dataclass(frozen=True)
class Comb:
    """A comb fitted to places along an axis.

    Attributes
    ----------
    pitch, period, first : float
        Distance of teeth, distance of groups, place of one group's first tooth.
    gain : float, nats
        By how much the places are more likely with it than anywhere.
    """

    pitch: float
    period: float
    first: float
    gain: float


def fit_comb(place: NDArray[np.floating[Any]], pitch: float, teeth: Teeth) -> Comb:
    """Fit the likeliest comb to places, (N,), with about the given pitch."""
    extent = float(np.ptp(place)) / pitch
    least, usual, largest = teeth.period
    # The farthest group may be off by a twelfth of a pitch.
    finest = (largest - least) * extent / usual * 6
    steps = next((each for each in _STEPS if each > finest), _STEPS[-1])
    period = np.linspace(least, largest, steps) * pitch
    start = float(place.min())
    bins = np.floor((place - start)[None] / period[:, None] % 1 * BINS).astype(int)
    flat = bins.clip(0, BINS - 1) + BINS * np.arange(steps)[:, None]
    count = np.bincount(flat.ravel(), minlength=BINS * steps).reshape(steps, BINS)
    spectrum = np.fft.rfft(count, axis=1)
    template, doubt = _templates(teeth, steps)
    gain = np.fft.irfft(spectrum * template, n=BINS) - doubt
    stretch, row, phase = np.unravel_index(int(gain.argmax()), gain.shape)
    return Comb(
        _STRETCHES[stretch] * pitch,
        float(period[row]),
        float(start + (phase + 0.5) / BINS * period[row]),
        float(gain[stretch, row, phase]),
    )


@lru_cache(maxsize=16)
def _templates(
    teeth: Teeth, steps: int
) -> tuple[NDArray[np.complexfloating[Any, Any]], NDArray[np.floating[Any]]]:
    """Return `_template` of every stretch, stacked."""
    gains, doubts = zip(*(_template(teeth, steps, each) for each in _STRETCHES), strict=True)
    return np.array(gains), np.array(doubts)


def _template(
    teeth: Teeth, steps: int, stretch: float
) -> tuple[NDArray[np.complexfloating[Any, Any]], NDArray[np.floating[Any]]]:
    """Return the gain of each phase by one dot, and the cost of each period.

    The first, (S, F), is the Fourier transform of the logarithm of how dense
    dots are over one period, 1 being even.
    """
    least, usual, largest = teeth.period
    period = np.linspace(least, largest, steps)[:, None] / stretch
    place = np.arange(BINS) / BINS * period
    density = np.full(place.shape, CLUTTER)
    for tooth, share in enumerate(teeth.share):
        away = (place - tooth + period / 2) % period - period / 2
        bell = np.exp(-((away / SPREAD) ** 2) / 2) / (SPREAD * math.sqrt(2 * math.pi))
        density += (1 - CLUTTER) * share * bell * period
    doubt = _DOUBT * ((period / usual - 1) / 0.1) ** 2 / 2
    return np.fft.rfft(np.log(density), axis=1).conj(), doubt
