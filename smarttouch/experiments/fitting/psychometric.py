"""Psychometric functions, the probability that a stimulus is judged higher, felt, or named, and
their fit by maximum likelihood, for thousands of data sets at once.

``p = guess + (1 - guess - lapse) F((x - threshold) / spread + F⁻¹(level))``, x a stimulus or its
natural logarithm, as in Wichmann and Hill (Perception & Psychophysics 63, 2001, Eq. 1), with the
threshold itself as parameter of place. From the best of a grid, Fisher's scoring with Levenberg's
damping inside bounds (Nocedal and Wright, *Numerical Optimization*, 2006, chapters 10 and 16.7). No
randomness: the same data give the same fit."""

import math
from dataclasses import dataclass
from enum import StrEnum
from itertools import product
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

    def rises(self, z: Array) -> tuple[Array, Array]:
        """Return F and its slope at z."""
        if self is Shape.NORMAL:
            return ndtr(z), np.exp(-(z**2) / 2) / math.sqrt(2 * math.pi)
        if self is Shape.LOGISTIC:
            part = expit(z)
            return part, part * (1 - part)
        # Beyond 7 nothing is left of 1 - F, and the exponential would overflow.
        power = math.log(2) * np.exp(np.minimum(z, 7.0))
        return -np.expm1(-power), power * np.exp(-power)

    def inverse(self, part: float) -> float:
        """Return the z at which F equals the given part of 1."""
        if self is Shape.NORMAL:
            return float(ndtri(part))
        if self is Shape.LOGISTIC:
            return float(logit(part))
        return math.log(-math.log1p(-part) / math.log(2))


class Parameters(NamedTuple):
    """Parameters, each one number or (B,) of many functions."""

    # stimulus at the model's level, on its axis: a logarithm if that is logarithmic
    threshold: Array
    # logarithm of the spread on that axis, which is the standard deviation of a normal F
    log_spread: Array
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
                "Weibull's function needs a logarithmic axis: choose normal or logistic",
                about="shape",
            )
        floor = 0.0 if isinstance(self.guess, str) else self.guess
        if not 0 <= floor < 1:
            raise ExperimentError(
                f"a guess rate of {floor:g} is no share: give 0 to below 1", about="guess"
            )
        if not 0 <= self.most_lapses < (1 - floor) / 2:
            raise ExperimentError(
                f"a lapse rate of up to {self.most_lapses:g} leaves no room for answers: give less "
                f"than {(1 - floor) / 2:g}",
                about="most_lapses",
            )
        if self.at is not None and not floor < self.at < 1:
            raise ExperimentError(
                f"the threshold cannot be at {self.at:g} of the answers: give a share between "
                f"{floor:g} and 1",
                about="at",
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
            raise ExperimentError(
                f"{given.min():g} has no logarithm: fit it on a linear axis",
                about="stimulus",
                remedy="linear",
            )
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(given))

    def stimulus(self, place: ArrayLike) -> Array:
        """Return the stimuli at places on the axis."""
        return np.asarray(np.exp(place) if self.logarithmic else place, np.float64)

    def place(self, part: float, parameters: Parameters) -> Array:
        """Return the place on the axis at which F equals the given part of 1."""
        apart = self.shape.inverse(part) - self.shape.inverse(self.level)
        return np.asarray(parameters.threshold + apart * np.exp(parameters.log_spread))

    def probability(self, x: Array, parameters: Parameters) -> Array:
        """Return the probability of a success, (..., B, K), at places on the axis, (K,)."""
        return self.slopes(x, parameters)[0]

    def slopes(self, x: Array, parameters: Parameters) -> tuple[Array, Array]:
        """Return probabilities, (B, K), and their derivatives by each parameter, (B, 4, K)."""
        threshold, log_spread, lapse, guess = (np.asarray(each)[..., None] for each in parameters)
        spread = np.exp(log_spread)
        apart = (x - threshold) / spread
        rise, slope = self.shape.rises(apart + self.shape.inverse(self.level))
        height = 1 - guess - lapse
        # At minus infinity the slope is 0, and so is its product with any distance.
        apart = np.where(np.isfinite(apart), apart, 0.0)
        by_lapse = 1 - 2 * rise if self.guess == "equal" else -rise
        changes = (-height * slope / spread, -height * slope * apart, by_lapse, 1 - rise)
        return guess + height * rise, np.stack(changes, axis=-2)


@dataclass(frozen=True)
class Estimate:
    """Threshold that a procedure estimates from its own answers."""

    threshold: float  # in the unit of the comparison
    spread: float  # its standard deviation, in the same unit
    trials: int  # answered ones


_TINY = 1e-9
"""Least distance of probabilities from 0 and 1, which keeps the likelihood of any answer finite."""
_FLATTEST, _STEEPEST = 10.0, 1 / 300  # bounds of the spread, in spans of the stimuli
_GRID_PLACES, _GRID_SPREADS = 41, 13
_GRID_SHARES = (0.005, 0.03, 0.08)
_GRID_GUESSES = (0.01, 0.1, 0.3)
_STEPS = 100
_SETTLED = 1e-7


@dataclass(frozen=True, eq=False)
class Bounds:
    """Bounds of the parameters, (4,) each, in the order of `Parameters`."""

    low: Array
    high: Array


@dataclass(frozen=True, eq=False)
class Maximum:
    """Maximum of the likelihood."""

    parameters: Parameters  # (B,) each
    log_likelihood: Array  # (B,): without the binomial coefficients


def bounds_of(model: Model, x: Array) -> Bounds:
    """Return the bounds for stimuli at places x: thresholds up to a span beyond them."""
    finite = x[np.isfinite(x)]
    low, high = float(finite.min()), float(finite.max())
    span = (high - low) or 1.0
    known = _known_guess(model)
    guess = (0.0, MOST_GUESSES) if model.guess == "free" else (known, known)
    pairs = (
        (low - span, high + span),
        (np.log(span * _STEEPEST), np.log(span * _FLATTEST)),
        (0.0, model.most_lapses),
        guess,
    )
    return Bounds(*np.array(pairs).T)


def log_likelihood(model: Model, x: Array, n: Array, k: Array, parameters: Parameters) -> Array:
    """Return the logarithm of the likelihood of k successes in n trials, (B,)."""
    return _log_likelihood(model.probability(x, parameters), n, k)


def saturated(n: Array, k: Array) -> Array:
    """Return the log likelihood of the saturated model, (...,): the observed shares themselves."""
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(n > 0, k / n, 0.5)
    return _log_likelihood(share, n, k)


def maximize(model: Model, x: Array, n: Array, k: Array, starts: int = 1) -> Maximum:
    """Return the most likely function of each data set: successes k of n trials, (B, K), at places
    x, (K,), on the model's axis, of which at least one is finite.

    The climb begins at the best points of a grid, as many as `starts`.
    """
    n, k = np.atleast_2d(n).astype(np.float64), np.atleast_2d(k).astype(np.float64)
    within = bounds_of(model, x)
    found = _of_grid(model, x, n, k, _grid(model, x), starts)
    found = np.clip(found, within.low, within.high).reshape(-1, 4)
    n, k = (np.repeat(each, starts, axis=0) for each in (n, k))
    best, value = _climb(model, x, found, n, k, within)
    value = value.reshape(-1, starts)
    chosen, rows = value.argmax(axis=1), np.arange(len(value))
    best = best.reshape(-1, starts, 4)[rows, chosen]
    return Maximum(_parameters(model, best), value[rows, chosen])


def _grid(model: Model, x: Array) -> Array:
    """Return the grid of starting parameters, (G, 4)."""
    finite = x[np.isfinite(x)]
    low, high = float(finite.min()), float(finite.max())
    span = (high - low) or 1.0
    places = np.linspace(low - 0.2 * span, high + 0.2 * span, _GRID_PLACES)
    spreads = np.log(span) + np.linspace(np.log(0.01), np.log(3), _GRID_SPREADS)
    lapses = [each for each in _GRID_SHARES if each < model.most_lapses] or [0.0]
    guesses = _GRID_GUESSES if model.guess == "free" else (_known_guess(model),)
    return np.array(list(product(places, spreads, lapses, guesses)))


def _known_guess(model: Model) -> float:
    return 0.0 if isinstance(model.guess, str) else model.guess


def _of_grid(model: Model, x: Array, n: Array, k: Array, grid: Array, count: int) -> Array:
    """Return the best points of the grid for each data set, (B, count, 4)."""
    likely = np.clip(model.probability(x, _parameters(model, grid)), _TINY, 1 - _TINY)
    value = k @ np.log(likely).T + (n - k) @ np.log1p(-likely).T
    best = np.argpartition(-value, count - 1, axis=1)[:, :count]
    return np.asarray(grid[best])


def _parameters(model: Model, table: Array) -> Parameters:
    guess = table[:, 2] if model.guess == "equal" else table[:, 3]
    return Parameters(table[:, 0], table[:, 1], table[:, 2], guess)


def _log_likelihood(likely: Array, n: Array, k: Array) -> Array:
    likely = np.clip(likely, _TINY, 1 - _TINY)
    return np.asarray((k * np.log(likely) + (n - k) * np.log1p(-likely)).sum(axis=-1))


def _climb(
    model: Model, x: Array, start: Array, n: Array, k: Array, within: Bounds
) -> tuple[Array, Array]:
    """Return the nearest maximum of each data set, (B, 4), and its log likelihood, (B,)."""
    at = start.copy()
    value = _log_likelihood(model.probability(x, _parameters(model, at)), n, k)
    damping = np.full(len(at), 1e-3)
    active = np.arange(len(at))
    for _ in range(_STEPS):
        step = _step(model, x, at[active], n[active], k[active], within, damping[active])
        tried = np.clip(at[active] + step, within.low, within.high)
        moved = np.abs(tried - at[active]).max(axis=1)
        reached = _log_likelihood(
            model.probability(x, _parameters(model, tried)), n[active], k[active]
        )
        better = reached > value[active]
        at[active[better]] = tried[better]
        value[active[better]] = reached[better]
        damping[active] *= np.where(better, 0.2, 6.0)
        settled = (moved < _SETTLED) | (damping[active] > 1e8)
        active = active[~settled]
        if not len(active):
            break
    return at, value


def _step(
    model: Model, x: Array, at: Array, n: Array, k: Array, within: Bounds, damping: Array
) -> Array:
    """Return the step from each point, (B, 4); 0 for a parameter at its bound."""
    likely, slopes = model.slopes(x, _parameters(model, at))
    likely = np.clip(likely, _TINY, 1 - _TINY)
    weight = 1 / (likely * (1 - likely))
    gradient = np.einsum("bpk,bk->bp", slopes, (k - n * likely) * weight)
    information = np.einsum("bpk,bqk,bk->bpq", slopes, slopes, n * weight)
    free = _free(at, gradient, within)
    if model.guess == "equal":
        free[:, 3] = False
    gradient = np.where(free, gradient, 0.0)
    information = information * (free[:, :, None] & free[:, None, :])
    diagonal = np.einsum("bpp->bp", information)
    # A view: what is added here is added to the matrices.
    diagonal += damping[:, None] * diagonal + 1e-9 + ~free
    return np.asarray(np.linalg.solve(information, gradient[..., None])[..., 0])


def _free(at: Array, gradient: Array, within: Bounds) -> NDArray[np.bool_]:
    low, high = within.low, within.high
    stuck = ((at <= low) & (gradient <= 0)) | ((at >= high) & (gradient >= 0)) | (low == high)
    return np.asarray(~stuck)
