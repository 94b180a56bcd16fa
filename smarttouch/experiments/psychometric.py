"""Psychometric functions: the probability that a stimulus is judged higher, felt, or named; and
their fit.

``p = guess + (1 - guess - lapse) F((x - middle) / spread)``, F the cumulative normal of the paper,
x a stimulus or its natural logarithm, as in Wichmann and Hill (Perception & Psychophysics 63, 2001,
Eq. 1).

One posterior on a grid gives estimates and intervals, as Kuss, Jäkel and Wichmann (Journal of
Vision 5(5):8, 2005) do with chains. Each function of the grid is weighed by its likelihood, so that
an estimate is within its interval, and both rise with the share that is asked for. No randomness:
the same answers give the same fit.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, ndtri

from smarttouch.base.errors import ExperimentError

Array = NDArray[np.float64]
Guess = float | Literal["equal", "free"]

MOST_LAPSES = 0.1
"""Largest lapse rate: share of answers independent of the stimulus (our own choice)."""
MOST_GUESSES = 0.5
"""Largest guess rate: share of *felt* without a stimulus, where it is not known beforehand."""
QUANTILES = (0.5, 0.025, 0.975)
"""Quantiles of the posterior: the estimate, and the ends of its interval of 95 %."""
_MIDDLES, _SPREADS, _LAPSES, _GUESSES = 151, 21, 5, 6
_NARROWEST, _WIDEST = 1 / 40, 1.0
"""Spreads, in spans of the comparisons; alike in logarithms, all equally likely (our own choice,
by which intervals of simulated subjects hold 92 to 98 % of thresholds)."""
_EDGE = 0.05
"""Part of a span: an interval that ends closer than this to the edge of the grid is unbounded."""
_NOTHING = 1e-7  # weight of places that a finer grid leaves out


class Counts(NamedTuple):
    """Number of trials and successes at each comparison."""

    stimulus: Array  # (K,): rising
    # n, k: (K,), answers and successes
    n: Array
    k: Array


class Parameters(NamedTuple):
    """Parameters, each one number or (G,) of many functions."""

    middle: Array  # where F is a half, on the model's axis: a logarithm if that is logarithmic
    spread: Array  # standard deviation of F on that axis
    # lapse, guess: shares
    lapse: Array
    guess: Array


class Bounded(NamedTuple):
    """A figure and its credible interval; an end that is not determined is infinite."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Model:
    """A family of psychometric functions, rising with the stimulus."""

    # lower asymptote: known (0.5 of two intervals, 1/m of m letters, 0), equal to the lapses
    # (*which was higher*, where the comparison is both lower and higher than the standard), or free
    # up to `MOST_GUESSES` (*felt*, with trials that show nothing)
    guess: Guess = "equal"
    # share of answers that defines the threshold, apart from lapses, and from guesses if these are
    # free; None: 0.75 where asymptotes are equal (Section III.C of the paper), else halfway between
    # guess and 1
    at: float | None = None
    logarithmic: bool = True  # whether F is one of the stimulus' logarithm
    most_lapses: float = MOST_LAPSES  # upper bound

    def __post_init__(self) -> None:
        floor = 0.0 if isinstance(self.guess, str) else self.guess
        if not 0 <= floor < 1 - 2 * self.most_lapses:
            raise ExperimentError(
                f"a guess rate of {floor:g} leaves no room for answers: give 0 to below "
                f"{1 - 2 * self.most_lapses:g}"
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
        values = np.asarray(stimulus, np.float64)
        if not self.logarithmic:
            return values
        if (values < 0).any():
            raise ExperimentError(f"{values.min():g} has no logarithm: fit it on a linear axis")
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(values))

    def stimulus(self, position: ArrayLike) -> Array:
        """Return the stimuli at places on the axis."""
        return np.asarray(np.exp(position) if self.logarithmic else position, np.float64)

    def place(self, part: float, parameters: Parameters) -> Array:
        """Return the place on the axis at which F equals the given part of 1."""
        return np.asarray(parameters.middle + ndtri(part) * parameters.spread)

    def probability(self, x: Array, parameters: Parameters) -> Array:
        """Return the probability of a success, (G, K), at places on the axis, (K,)."""
        middle, spread, lapse, guess = (
            np.asarray(parameter)[..., None] for parameter in parameters
        )
        return np.asarray(guess + (1 - guess - lapse) * ndtr((x - middle) / spread))


def log_likelihood(likely: Array, n: Array, k: Array) -> Array:
    """Return the logarithm of the likelihood, (...,), of k successes in n trials, (..., K), that
    have these probabilities."""
    # Away from 0 and 1, so that any answer has a finite one.
    likely = np.clip(likely, 1e-9, 1 - 1e-9)
    return np.asarray(np.log(likely) @ k + np.log1p(-likely) @ (n - k))


@dataclass(frozen=True, eq=False)
class Fit:
    """Psychometric functions of a family, weighed by the answers."""

    model: Model
    counts: Counts  # answers it was fitted to
    ends: tuple[float, float]  # of the comparisons and the standard, on the model's axis
    functions: Parameters  # (G,)
    log_likelihoods: Array  # (G,): of each function, without the binomial coefficients

    @cached_property
    def weights(self) -> Array:
        """Weights of the functions, (G,), of sum 1."""
        weights = np.exp(self.log_likelihoods - self.log_likelihoods.max())
        return np.asarray(weights / weights.sum())

    @cached_property
    def parameters(self) -> Parameters:
        """Mean of the functions, (1,) each, moved to the median of their threshold."""
        _, spread, lapse, guess = self.functions
        spread = np.exp([self.weights @ np.log(spread)])
        middle = self._quantiles(self.model.level)[0] - ndtri(self.model.level) * spread
        others = (np.array([self.weights @ grid]) for grid in (lapse, guess))
        return Parameters(middle, spread, *others)

    def bounded(self, part: float) -> Bounded:
        """Return the stimulus at which F equals the given part of 1, and its interval."""
        value, low, high = self._quantiles(part)
        first, last = self.ends
        edge = (1 - _EDGE) * (last - first)
        low = low if low > first - edge else -np.inf
        high = high if high < last + edge else np.inf
        return Bounded(*self.model.stimulus([value, low, high]).tolist())

    def __call__(self, stimulus: Array) -> Array:
        """Return the predicted shares at stimuli, (K,)."""
        return np.asarray(self.model.probability(self.model.axis(stimulus), self.parameters)[0])

    def _quantiles(self, part: float) -> Array:
        """Return `QUANTILES` of the place at which F equals the given part of 1."""
        position = self.model.place(part, self.functions)
        order = np.argsort(position)
        below = np.cumsum(self.weights[order]) - self.weights[order] / 2
        return np.interp(QUANTILES, below, position[order])


def fit(counts: Counts, model: Model, standard: float = 0.0) -> Fit:
    """Weigh psychometric functions by the answers at two comparisons or more.

    Beforehand all middles up to a span beyond the comparisons, all logarithms of spreads, all
    lapses and, if they are free, all guesses are equally likely.
    """
    x = model.axis(counts.stimulus)
    finite = model.axis([*counts.stimulus, standard or counts.stimulus[-1]])
    finite = finite[np.isfinite(finite)]
    first, last = float(finite.min()), float(finite.max())
    span = (last - first) or 1.0
    middles = np.linspace(first - span, last + span, _MIDDLES)
    spreads = np.linspace(np.log(span * _NARROWEST), np.log(span * _WIDEST), _SPREADS)
    for _ in range(2):  # the second time where the first has found any weight
        functions = _grid(model, middles, np.exp(spreads))
        likely = log_likelihood(model.probability(x, functions), counts.n, counts.k)
        found = Fit(model, counts, (first, last), functions, likely)
        weights = found.weights.reshape(_MIDDLES, _SPREADS, -1)
        middles = _inner(middles, weights.sum(axis=(1, 2)))
        spreads = _inner(spreads, weights.sum(axis=(0, 2)))
    return found


def _inner(places: Array, weights: Array) -> Array:
    """Return as many places where there is any weight."""
    some = np.flatnonzero(weights > _NOTHING)
    low, high = places[max(some[0] - 1, 0)], places[min(some[-1] + 1, len(places) - 1)]
    return np.linspace(low, high, len(places))


def _grid(model: Model, middles: Array, spreads: Array) -> Parameters:
    """Return functions, (G,), with each middle, spread, lapse and guess, in this order."""
    lapses = np.linspace(0, model.most_lapses, _LAPSES)
    known = 0.0 if isinstance(model.guess, str) else model.guess
    guesses = np.linspace(0, MOST_GUESSES, _GUESSES) if model.guess == "free" else [known]
    middle, spread, lapse, guess = map(
        np.ravel, np.meshgrid(middles, spreads, lapses, guesses, indexing="ij")
    )
    return Parameters(middle, spread, lapse, lapse if model.guess == "equal" else guess)
