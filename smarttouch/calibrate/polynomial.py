"""Polynomials from the reading of a load cell to newtons."""

import numpy as np
from numpy.typing import NDArray

FEWEST_FOR_BEND = 4
"""Fewest distinct weights for a quadratic."""


def fit(
    reading: NDArray[np.float64], force: NDArray[np.float64], degree: int
) -> NDArray[np.float64]:
    """Return coefficients, lowest first; fitted about the mean, as raw counts are large."""
    fitted = np.polynomial.Polynomial.fit(reading, force, degree)
    coefficients = np.zeros(degree + 1)
    found = fitted.convert().coef
    coefficients[: len(found)] = found
    return coefficients


def left_out(
    grams: NDArray[np.float64],
    reading: NDArray[np.float64],
    force: NDArray[np.float64],
    degree: int,
) -> float:
    """Return the rms error, N, at weights left out of the fit; infinite if too few."""
    weights = np.unique(grams)
    if len(weights) < (FEWEST_FOR_BEND if degree > 1 else 3):
        return float("inf")
    errors = []
    for each in weights:
        out = grams == each
        fitted = np.polynomial.Polynomial.fit(reading[~out], force[~out], degree)
        errors += list(fitted(reading[out]) - force[out])
    return float(np.sqrt(np.mean(np.square(errors))))


def rises(coefficients: NDArray[np.float64], reading: NDArray[np.float64]) -> bool:
    """Return whether a curve goes in one direction over and a little beyond the readings."""
    low, high = reading.min(), reading.max()
    spare = 0.25 * (high - low)
    slope = np.polynomial.Polynomial(coefficients).deriv()
    ends = slope(np.array([low - spare, high + spare]))
    return bool(ends[0] * ends[1] > 0)


def zero_of(polynomial: np.polynomial.Polynomial, reading: NDArray[np.float64]) -> float:
    """Return the reading without force; NaN if the curve has none."""
    roots = polynomial.roots()
    real = roots[np.isreal(roots)].real
    middle = (reading.min() + reading.max()) / 2
    return float(real[np.abs(real - middle).argmin()]) if len(real) else float("nan")


def hysteresis(grams: NDArray[np.float64], force: NDArray[np.float64]) -> float:
    """Return the largest difference of weighings of one weight; NaN if none was repeated."""
    apart = [np.ptp(force[grams == each]) for each in np.unique(grams) if (grams == each).sum() > 1]
    return float(max(apart)) if apart else float("nan")
