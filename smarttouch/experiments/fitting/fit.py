"""Fit of a psychometric function: one posterior on a grid gives estimates and intervals.

As Kuss, Jäkel and Wichmann (Journal of Vision 5(5):8, 2005) do with chains. Each function of the
grid is weighed by its likelihood, so that an estimate is within its interval, and both rise with
the share that is asked for. No randomness: the same answers give the same fit.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from smarttouch.experiments.fitting.answers import Counts
from smarttouch.experiments.fitting.psychometric import (
    MOST_GUESSES,
    Array,
    Model,
    Parameters,
    log_likelihood,
)

QUANTILES = (0.5, 0.025, 0.975)
"""Quantiles of the posterior: the estimate, and the ends of its interval of 95 %."""
_MIDDLES, _SPREADS, _LAPSES, _GUESSES = 151, 21, 5, 6
_NARROWEST, _WIDEST = 1 / 40, 1.0
"""Spreads, in spans of the comparisons; alike in logarithms, all equally likely (our own choice,
by which intervals of simulated subjects hold 92 to 98 % of thresholds)."""
_EDGE = 0.05
"""Part of a span: an interval that ends closer than this to the edge of the grid is unbounded."""
_STEEP = 0.05  # weight of spreads near the narrowest that the answers do not exclude
_NOTHING = 1e-7  # weight of places that a finer grid leaves out
_BY_LEVEL = 4
"""Fewest answers at each comparison; with fewer, comparisons were mostly placed adaptively, or the
deviance is uninformative (McCullagh and Nelder, *Generalized Linear Models*, 1989, sec. 4.4.5)."""


class Bounded(NamedTuple):
    """A figure and its credible interval; an end that is not determined is infinite."""

    value: float
    low: float
    high: float


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
        aside = self.model.shape.inverse(self.model.level) * spread
        place = self._quantiles(self.model.level)[0]
        return Parameters(
            place - aside, spread, *(np.array([self.weights @ each]) for each in (lapse, guess))
        )

    @property
    def deviance(self) -> float:
        """Twice the log likelihood that the best function loses against the observed shares."""
        n, k = self.counts.n, self.counts.k
        return float(2 * (log_likelihood(k / n, n, k) - self.log_likelihoods.max()))

    @property
    def sudden(self) -> bool:
        """Whether functions as steep as there are fit well: no answer says how steep it is."""
        steep = self.functions.spread < 1.5 * _NARROWEST * (self.ends[1] - self.ends[0])
        return float(self.weights[steep].sum()) > _STEEP

    @property
    def goodness(self) -> float | None:
        """Chance that answers of this very function fit no better; None where that says nothing.

        The deviance is chi squared, with as many degrees of freedom as there are comparisons
        beyond the parameters.
        """
        from scipy.special import chdtrc

        free = len(self.counts.n) - (4 if self.model.guess == "free" else 3)
        if free < 1 or self.counts.n.min() < _BY_LEVEL:
            return None
        return float(chdtrc(free, max(0.0, self.deviance)))

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
        place = self.model.place(part, self.functions)
        order = np.argsort(place)
        below = np.cumsum(self.weights[order]) - self.weights[order] / 2
        return np.interp(QUANTILES, below, place[order])


def fit(counts: Counts, model: Model, standard: float = 0.0) -> Fit:
    """Weigh psychometric functions by the answers at two comparisons or more.

    Beforehand all middles up to a span beyond the comparisons, all logarithms of spreads, all
    lapses and, if they are free, all guesses are equally likely.
    """
    x = model.axis(counts.stimulus)
    ends = _ends(model.axis([*counts.stimulus, standard or counts.stimulus[-1]]))
    first, last = ends
    span = (last - first) or 1.0
    middles = np.linspace(first - span, last + span, _MIDDLES)
    spreads = np.linspace(np.log(span * _NARROWEST), np.log(span * _WIDEST), _SPREADS)
    for _ in range(2):  # the second time where the first has found any weight
        functions = _grid(model, middles, np.exp(spreads))
        likely = log_likelihood(model.probability(x, functions), counts.n, counts.k)
        found = Fit(model, counts, ends, functions, likely)
        weights = found.weights.reshape(_MIDDLES, _SPREADS, -1)
        middles = _inner(middles, weights.sum(axis=(1, 2)))
        spreads = _inner(spreads, weights.sum(axis=(0, 2)))
    return found


def _inner(places: Array, weights: Array) -> Array:
    """Return as many places where there is any weight."""
    some = np.flatnonzero(weights > _NOTHING)
    low, high = places[max(some[0] - 1, 0)], places[min(some[-1] + 1, len(places) - 1)]
    return np.linspace(low, high, len(places))


def _ends(x: Array) -> tuple[float, float]:
    finite = x[np.isfinite(x)]
    return float(finite.min()), float(finite.max())


def _grid(model: Model, middles: Array, spreads: Array) -> Parameters:
    """Return functions, (G,), with each middle, spread, lapse and guess, in this order."""
    lapses = np.linspace(0, model.most_lapses, _LAPSES)
    known = 0.0 if isinstance(model.guess, str) else model.guess
    guesses = np.linspace(0, MOST_GUESSES, _GUESSES) if model.guess == "free" else [known]
    middle, spread, lapse, guess = map(
        np.ravel, np.meshgrid(middles, spreads, lapses, guesses, indexing="ij")
    )
    return Parameters(middle, spread, lapse, lapse if model.guess == "equal" else guess)
