"""Psychometric functions: the probability that a stimulus is judged higher, felt, or named.

``p = guess + (1 - guess - lapse) F((x - middle) / spread)``, x a stimulus or its natural logarithm,
as in Wichmann and Hill (Perception & Psychophysics 63, 2001, Eq. 1)."""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit, logit, ndtr, ndtri

from smarttouch.base.errors import ExperimentError

Array = NDArray[np.float64]
Guess = float | Literal["equal", "free"]

MOST_LAPSES = 0.1
"""Largest lapse rate: share of answers independent of the stimulus (our own choice)."""
MOST_GUESSES = 0.5
"""Largest guess rate: share of *felt* without a stimulus, where it is not known beforehand."""


class Shape(StrEnum):
    """Shape of F: the paper's cumulative normal, the logistic function, or Weibull's.

    Weibull's function of a stimulus is Gumbel's, ``1 - exp(-ln 2 exp z)``, of its logarithm.
    All are a half at 0.
    """

    NORMAL = "normal"
    LOGISTIC = "logistic"
    WEIBULL = "weibull"

    def rise(self, z: Array) -> Array:
        """Return F at z."""
        if self is Shape.NORMAL:
            return np.asarray(ndtr(z))
        if self is Shape.LOGISTIC:
            return np.asarray(expit(z))
        # Beyond 7 nothing is left of 1 - F, and the exponential would overflow.
        return -np.expm1(-math.log(2) * np.exp(np.minimum(z, 7.0)))

    def inverse(self, part: float) -> float:
        """Return the z at which F equals the given part of 1."""
        if self is Shape.NORMAL:
            return float(ndtri(part))
        if self is Shape.LOGISTIC:
            return float(logit(part))
        return math.log(-math.log1p(-part) / math.log(2))


class Parameters(NamedTuple):
    """Parameters, each one number or (G,) of many functions."""

    middle: Array  # where F is a half, on the model's axis: a logarithm if that is logarithmic
    spread: Array  # on that axis; the standard deviation of a normal F
    # lapse, guess: shares
    lapse: Array
    guess: Array


@dataclass(frozen=True)
class Model:
    """A family of psychometric functions, rising with the stimulus."""

    shape: Shape = Shape.NORMAL  # Weibull's needs a logarithmic axis
    logarithmic: bool = True  # whether F is one of the stimulus' logarithm
    # lower asymptote: known (0.5 of two intervals, 1/m of m letters, 0), equal to the lapses
    # (*which was higher*, where the comparison is both lower and higher than the standard), or free
    # up to `MOST_GUESSES` (*felt*, with trials that show nothing)
    guess: Guess = "equal"
    # share of answers that defines the threshold, apart from lapses, and from guesses if these are
    # free; None: 0.75 where asymptotes are equal (Section III.C of the paper), else halfway between
    # guess and 1
    at: float | None = None
    most_lapses: float = MOST_LAPSES  # upper bound

    def __post_init__(self) -> None:
        if self.shape is Shape.WEIBULL and not self.logarithmic:
            raise ExperimentError(
                "Weibull's function needs a logarithmic axis: choose normal or logistic"
            )
        floor = 0.0 if isinstance(self.guess, str) else self.guess
        if not 0 <= floor < 1:
            raise ExperimentError(f"a guess rate of {floor:g} is no share: give 0 to below 1")
        if not 0 <= self.most_lapses < (1 - floor) / 2:
            raise ExperimentError(
                f"a lapse rate of up to {self.most_lapses:g} leaves no room for answers: give less "
                f"than {(1 - floor) / 2:g}"
            )
        if self.at is not None and not floor < self.at < 1:
            raise ExperimentError(
                f"the threshold cannot be at {self.at:g} of the answers: give a share between "
                f"{floor:g} and 1"
            )

    @property
    def level(self) -> float:
        """F at the threshold."""
        if isinstance(self.guess, str):
            return self.at or (0.75 if self.guess == "equal" else 0.5)
        return 0.5 if self.at is None else (self.at - self.guess) / (1 - self.guess)

    @property
    def share(self) -> float:
        """Share of answers at the threshold, apart from lapses (and guesses, if free)."""
        if isinstance(self.guess, str):
            return self.level
        return self.guess + (1 - self.guess) * self.level

    def axis(self, stimulus: ArrayLike) -> Array:
        """Return the place of stimuli on the axis; a stimulus of zero may be at minus infinity."""
        given = np.asarray(stimulus, np.float64)
        if not self.logarithmic:
            return given
        if (given < 0).any():
            raise ExperimentError(f"{given.min():g} has no logarithm: fit it on a linear axis")
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(given))

    def stimulus(self, place: ArrayLike) -> Array:
        """Return the stimuli at places on the axis."""
        return np.asarray(np.exp(place) if self.logarithmic else place, np.float64)

    def place(self, part: float, parameters: Parameters) -> Array:
        """Return the place on the axis at which F equals the given part of 1."""
        return np.asarray(parameters.middle + self.shape.inverse(part) * parameters.spread)

    def probability(self, x: Array, parameters: Parameters) -> Array:
        """Return the probability of a success, (G, K), at places on the axis, (K,)."""
        middle, spread, lapse, guess = (np.asarray(each)[..., None] for each in parameters)
        return np.asarray(guess + (1 - guess - lapse) * self.shape.rise((x - middle) / spread))


def log_likelihood(likely: Array, n: Array, k: Array) -> Array:
    """Return the logarithm of the likelihood, (...,), of k successes in n trials, (..., K), that
    have these probabilities."""
    # Away from 0 and 1, so that any answer has a finite one.
    likely = np.clip(likely, 1e-9, 1 - 1e-9)
    return np.asarray(np.log(likely) @ k + np.log1p(-likely) @ (n - k))
