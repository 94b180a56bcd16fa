"""A load cell's line from known weights."""

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

STANDARD_GRAVITY = 9.80665  # m/s²
FEWEST_READINGS = 5
MOST_MISSING = 0.5  # largest part of missing readings
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
    """A line from readings to forces, and its errors."""

    curve: tuple[float, float]  # N at a reading of 0, and N for one count
    full_n: float  # full force, the reference of percentages
    weighings: tuple[Weighing, ...]

    @property
    def slope_n(self) -> float:
        """N for one count."""
        return self.curve[1]

    @property
    def zero(self) -> float:
        """Reading without a weight."""
        return -self.curve[0] / self.slope_n

    def force_n(self, reading: float) -> float:
        """Return the force of a reading."""
        return self.curve[0] + self.slope_n * reading

    @property
    def off_n(self) -> NDArray[np.float64]:
        """Error of the line at each weighing."""
        return np.array([self.force_n(each.reading) - each.force_n for each in self.weighings])

    @property
    def residual_n(self) -> float:
        """Root of the mean square error."""
        return float(np.sqrt(np.mean(self.off_n**2)))

    def sentence(self) -> str:
        """Return the sentence for the profile."""
        grams = [each.grams for each in self.weighings]
        return (
            f"line through {len(grams)} weighings from {min(grams):g} to {max(grams):g} g, zero "
            f"at {self.zero:.6g}, {self.slope_n:.4g} N a count, residual rms "
            f"{self.residual_n:.4f} N ({self.residual_n / self.full_n:.2%} of full force), worst "
            f"{np.abs(self.off_n).max():.4f} N"
        )


def weigh_on(url: str, weights: Iterable[float], seconds: float) -> list[Weighing]:
    """Weigh on a load cell by its URL; each weight, in grams, is taken when it lies on the cell."""
    with open_cell(url) as cell:
        return [weigh(cell, grams, seconds) for grams in weights]


def parse_grams(text: str) -> float:
    """Return a weight, g, as somebody typed it."""
    try:
        grams = float(text)
    except ValueError:
        grams = math.nan
    if not 0 <= grams < math.inf:
        raise CalibrationError(f"{text!r} is not a weight: give grams, such as 20")
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
    """Fit a line to weighings of three weights or more; residuals are judged by the law's full
    force."""
    grams = np.array([each.grams for each in weighings])
    reading = np.array([each.reading for each in weighings])
    _require_weights(grams, law)
    _require_answer(weighings, reading)
    # Fitted about the mean, as raw counts are large.
    forces = [each.force_n for each in weighings]
    zero_n, slope_n = np.polynomial.Polynomial.fit(reading, forces, 1).convert().coef
    curve = float(f"{zero_n:.9g}"), float(f"{slope_n:.9g}")
    found = ForceFound(curve, law.full_n, tuple(weighings))
    if found.residual_n > MOST_RESIDUAL * law.full_n:
        worst = weighings[int(np.abs(found.off_n).argmax())]
        raise CalibrationError(
            f"the line misses the weights by {found.residual_n:.3f} N rms, above "
            f"{MOST_RESIDUAL:.0%} of full force, {law.full_n:g} N: weigh {worst.grams:g} g again"
        )
    restless = max(weighings, key=lambda each: abs(each.drift))
    drift_n = abs(restless.drift * found.slope_n)
    if drift_n > MOST_DRIFT * law.full_n:
        raise CalibrationError(
            f"the reading drifted by {drift_n:.3f} N while {restless.grams:g} g lay on the cell: "
            "wait until it settles, and weigh again"
        )
    return found


def _require_weights(grams: NDArray[np.float64], law: ForceLaw) -> None:
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


def _require_answer(weighings: Sequence[Weighing], reading: NDArray[np.float64]) -> None:
    noise = float(np.median([each.spread for each in weighings]))
    moved = float(np.ptp(reading))
    if moved <= 5 * noise or moved == 0:
        raise CalibrationError(
            f"the readings move by {moved:.6g} from the lightest to the heaviest weight, and by "
            f"{noise:.6g} by themselves: is the cell connected, and the weight on it?"
        )
