"""A load cell's curve from known weights."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import CalibrationError
from smarttouch.experiments.procedures import middle_and_spread
from smarttouch.profile import ForceLaw
from smarttouch.sources.force import open_cell

FEWEST_FOR_BEND = 4  # fewest distinct weights for a quadratic


STANDARD_GRAVITY = 9.80665  # m/s²
FEWEST_READINGS = 5
MOST_MISSING = 0.5  # largest part of missing readings
BEND_WORTH = 0.7
"""Largest error of a quadratic, relative to a line's."""
BEND_LEAST = 0.002  # error, as a part of full force, below which a line is good enough
MOST_RESIDUAL = 0.05  # largest rms residual, as a part of full force
MOST_DRIFT = 0.03  # largest drift, as a part of full force, while one weight lies on the cell
LEAST_REACH = 0.5  # least heaviest weight, as a part of full force


class Cell(Protocol):
    """Source of raw readings, such as a load cell on a serial port."""

    def collect(self, seconds: float) -> NDArray[np.float64]: ...


@dataclass(frozen=True)
class Weighing:
    """Readings of one weight on the cell."""

    grams: float
    reading: float  # median of the raw readings
    spread: float  # robust standard deviation of single readings
    drift: float  # from the first half of the readings to the second
    count: int  # number of readings

    @property
    def force_n(self) -> float:
        return self.grams / 1000 * STANDARD_GRAVITY


@dataclass(frozen=True)
class ForceFound:
    """A curve, and its errors."""

    curve: tuple[float, ...]  # coefficients of a polynomial, lowest first: reading to N
    zero: float  # reading without a weight, by the curve
    slope_n: float  # N for one count, at the middle of the range
    residual_n: float  # root of the mean square
    worst_n: float
    noise_n: float  # of a single reading
    # largest difference between two weighings of one weight; NaN if none came twice
    hysteresis_n: float
    full_n: float  # full force, the reference of percentages
    weighings: tuple[Weighing, ...]

    def force_n(self, reading: float) -> float:
        """Return the force of a reading by the curve."""
        return float(np.polynomial.polynomial.polyval(reading, self.curve))

    def sentence(self) -> str:
        """Return the sentence for the profile."""
        kind = "line" if len(self.curve) == 2 else "parabola"
        grams = [each.grams for each in self.weighings]
        twice = (
            ""
            if np.isnan(self.hysteresis_n)
            else f", hysteresis {self.hysteresis_n:.4f} N ({self.hysteresis_n / self.full_n:.1%})"
        )
        return (
            f"{kind} through {len(grams)} weighings from {min(grams):g} to {max(grams):g} g, zero "
            f"at {self.zero:.6g}, {self.slope_n:.4g} N a count, residual rms "
            f"{self.residual_n:.4f} N ({self.residual_n / self.full_n:.2%} of full force), worst "
            f"{self.worst_n:.4f} N, noise {self.noise_n:.4f} N{twice}"
        )


def weigh_on(url: str, weights: Iterable[float], seconds: float) -> list[Weighing]:
    """Weigh on a load cell by its URL; each weight, in grams, is taken when it lies on the cell."""
    with open_cell(url) as cell:
        return [weigh(cell, grams, seconds) for grams in weights]


def parse_grams(text: str) -> list[float]:
    """Return what ``0,20,50`` names."""
    try:
        grams = [float(each) for each in text.split(",")]
    except ValueError:
        grams = [math.nan]
    if not all(0 <= each < math.inf for each in grams):
        message = f"weights {text!r} are not understood: give grams like 0,20,50,100"
        raise CalibrationError(message)
    return grams


def weigh(cell: Cell, grams: float, seconds: float) -> Weighing:
    """Take readings of one weight."""
    raw = np.asarray(cell.collect(seconds), np.float64)
    good = raw[np.isfinite(raw)]
    if len(good) < FEWEST_READINGS or len(good) < (1 - MOST_MISSING) * len(raw):
        raise CalibrationError(
            f"{len(good)} of {len(raw)} readings at {grams:g} g are numbers, {FEWEST_READINGS} "
            "and half of all are needed: check the cell's connections, or read longer (--seconds)"
        )
    middle, spread = middle_and_spread(good)
    half = len(good) // 2
    drift = float(np.median(good[half:]) - np.median(good[:half]))
    return Weighing(grams, middle, spread, drift, len(good))


def fit_curve(weighings: Sequence[Weighing], law: ForceLaw) -> ForceFound:
    """Fit a line, or a parabola where that is clearly better, to weighings of three weights or
    more.

    One weight given twice, on the way up and on the way down, gives the hysteresis. Residuals are
    judged by the law's full force.
    """
    grams = np.array([each.grams for each in weighings])
    reading = np.array([each.reading for each in weighings])
    force = np.array([each.force_n for each in weighings])
    _require_weights(grams, law)
    _require_answer(weighings, grams, reading)
    polynomial, line_n = _fit(reading, force, 1)
    if len(np.unique(grams)) >= FEWEST_FOR_BEND and line_n > BEND_LEAST * law.full_n:
        bent, bend_n = _fit(reading, force, 2)
        if bend_n < BEND_WORTH * line_n and _goes_one_way(bent, reading):
            polynomial = bent
    residual = polynomial(reading) - force
    middle = (reading.min() + reading.max()) / 2
    slope_n = float(polynomial.deriv()(middle))
    roots = polynomial.roots()
    real = roots[np.isreal(roots)].real
    apart = [np.ptp(polynomial(reading[grams == each])) for each in np.unique(grams)]
    twice = len(grams) > len(apart)
    found = ForceFound(
        tuple(float(f"{each:.9g}") for each in polynomial.coef),
        float(real[np.abs(real - middle).argmin()]) if len(real) else math.nan,
        slope_n,
        float(np.sqrt(np.mean(residual**2))),
        float(np.abs(residual).max()),
        float(np.median([each.spread for each in weighings])) * abs(slope_n),
        float(max(apart)) if twice else math.nan,
        law.full_n,
        tuple(weighings),
    )
    _require_good(found)
    return found


def _fit(
    reading: NDArray[np.float64], force: NDArray[np.float64], degree: int
) -> tuple[np.polynomial.Polynomial, float]:
    """Return a polynomial, and its rms error, N, for the degrees of freedom that are left."""
    # Fitted about the mean, as raw counts are large.
    found = np.polynomial.Polynomial.fit(reading, force, degree).convert()
    found = np.polynomial.Polynomial(np.resize([*found.coef, 0, 0], degree + 1))
    free = max(1, len(reading) - degree - 1)
    return found, float(np.sqrt(((found(reading) - force) ** 2).sum() / free))


def _goes_one_way(polynomial: np.polynomial.Polynomial, reading: NDArray[np.float64]) -> bool:
    """Return whether a curve goes in one direction over and a little beyond the readings."""
    spare = 0.25 * np.ptp(reading)
    ends = polynomial.deriv()(np.array([reading.min() - spare, reading.max() + spare]))
    return bool(ends[0] * ends[1] > 0)


def _require_weights(grams: NDArray[np.float64], law: ForceLaw) -> None:
    if len(wrong := grams[~(np.isfinite(grams) & (grams >= 0))]):
        message = f"{wrong[0]:g} g is no weight: give a number of grams, 0 or more"
        raise CalibrationError(message)
    distinct = len(np.unique(grams))
    if distinct < 3:
        raise CalibrationError(
            f"{distinct} different weights do not determine the residual: give three or more"
        )
    full_g = 1000 * law.full_n / STANDARD_GRAVITY
    if grams.max() < LEAST_REACH * full_g:
        raise CalibrationError(
            f"the heaviest weight of {grams.max():g} g is far below full force, {full_g:.0f} g: "
            "give one about as heavy as that"
        )


def _require_answer(
    weighings: Sequence[Weighing], grams: NDArray[np.float64], reading: NDArray[np.float64]
) -> None:
    noise = float(np.median([each.spread for each in weighings]))
    moved = float(np.ptp(reading))
    if moved <= 5 * noise or moved == 0:
        raise CalibrationError(
            f"the readings move by {moved:.6g} from the lightest to the heaviest weight, and by "
            f"{noise:.6g} by themselves: is the cell connected, and the weight on it?"
        )
    mean = np.array([reading[grams == each].mean() for each in np.unique(grams)])
    steps = np.diff(mean)
    turned = steps * np.sign(mean[-1] - mean[0]) <= 0
    if turned.any():
        first, second = np.unique(grams)[[turned.argmax(), turned.argmax() + 1]]
        raise CalibrationError(
            f"the reading does not change in one direction from {first:g} to {second:g} g: weigh "
            "again, each weight alone and at rest"
        )


def _require_good(found: ForceFound) -> None:
    if found.residual_n > MOST_RESIDUAL * found.full_n:
        worst = max(
            found.weighings, key=lambda each: abs(found.force_n(each.reading) - each.force_n)
        )
        raise CalibrationError(
            f"the curve misses the weights by {found.residual_n:.3f} N rms, above "
            f"{MOST_RESIDUAL:.0%} of full force, {found.full_n:g} N: weigh {worst.grams:g} g again"
        )
    restless = max(found.weighings, key=lambda each: abs(each.drift))
    drift_n = abs(restless.drift * found.slope_n)
    if drift_n > MOST_DRIFT * found.full_n:
        raise CalibrationError(
            f"the reading drifted by {drift_n:.3f} N while {restless.grams:g} g lay on the cell: "
            "wait until it settles, and weigh again"
        )
