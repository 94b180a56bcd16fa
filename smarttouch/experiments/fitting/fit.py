"""Fit of one psychometric function by maximum likelihood, with credible intervals.

A grid of functions serves both: climbs begin at its best points, and all of it, weighed by the
likelihood, gives the intervals (as Kuss, Jäkel and Wichmann, Journal of Vision 5(5):8, 2005, do
with chains). Resampling cannot know how steep a function is that changes between two comparisons,
and finds what adaptive procedures leave behind steeper than it is. No randomness: the same data
give the same fit.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from smarttouch.experiments.fitting.answers import Counts
from smarttouch.experiments.fitting.psychometric import (
    MOST_GUESSES,
    Array,
    Model,
    Parameters,
    log_likelihood,
    saturated,
)

CONFIDENCE = 0.95
_PLACES, _SPREADS, _LAPSES, _GUESSES = 301, 16, 5, 6
_NARROWEST, _WIDEST = 1 / 20, 2.0
"""Spreads, in spans of the comparisons; alike in logarithms, all equally likely (our own choice,
by which intervals of simulated subjects hold 92 to 95 % of thresholds)."""
_EDGE = 0.05
"""Part of a span: an interval that ends closer than this to the edge of the grid is unbounded."""
_STEEPEST, _FLATTEST = 1 / 300, 10.0  # bounds of the fitted spread, in spans of the stimuli
_STARTS, _COARSE = 4, 6  # climbs, and the part of the places where they may begin
_CHANGING = (0.02, 0.98)
_FEWEST_CHANGING = 2
"""Comparisons with F between its ends; with fewer, its steepness is not determined."""
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
    """Most likely psychometric function."""

    model: Model
    counts: Counts  # answers it was fitted to
    parameters: Parameters  # of the one function, (1,) each
    log_likelihood: float  # without the binomial coefficients

    @property
    def threshold(self) -> float:
        """Stimulus at the model's level."""
        return self.at(self.model.level)

    @property
    def spread(self) -> float:
        """Standard deviation of a normal F, on the model's axis."""
        return float(np.exp(self.parameters.log_spread[0]))

    @property
    def slope(self) -> float:
        """Steepness of F at its middle, per unit of the model's axis."""
        return float(self.model.shape.rises(np.zeros(1))[1][0]) / self.spread

    @property
    def lapse(self) -> float:
        """Upper asymptote, from 1."""
        return float(self.parameters.lapse[0])

    @property
    def guess(self) -> float:
        """Lower asymptote."""
        return float(self.parameters.guess[0])

    @property
    def deviance(self) -> float:
        """Deviance: twice the log likelihood lost against the observed shares."""
        return float(2 * (saturated(self.counts.n, self.counts.k) - self.log_likelihood))

    @property
    def sudden(self) -> bool:
        """Whether it rises within about one step of the comparisons: no answer says how steeply."""
        bare = self.parameters._replace(lapse=np.zeros(1), guess=np.zeros(1))
        rise = self.model.probability(self.model.axis(self.counts.stimulus), bare)
        return int(((rise > _CHANGING[0]) & (rise < _CHANGING[1])).sum()) < _FEWEST_CHANGING

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

    def at(self, part: float) -> float:
        """Return the stimulus at which F equals the given part of 1."""
        return float(self.model.stimulus(self.model.place(part, self.parameters)[0]))

    def bounded(self, part: float) -> Bounded:
        """Return the stimulus at which F equals the given part of 1, and its interval."""
        ends = credible_interval(self.model, self.counts, part)
        return Bounded(self.at(part), *map(float, self.model.stimulus(ends)))

    def __call__(self, stimulus: Array) -> Array:
        """Return the predicted shares at stimuli, (K,)."""
        return np.asarray(self.model.probability(self.model.axis(stimulus), self.parameters)[0])


def fit(counts: Counts, model: Model) -> Fit:
    """Fit one function by maximum likelihood to answers at two comparisons or more."""
    from scipy.optimize import minimize

    x = model.axis(counts.stimulus)
    places = _places(x)
    low, high = float(places[0]), float(places[-1])
    log_span = np.log((high - low) / 3)
    bounds = [
        (low, high),
        (log_span + np.log(_STEEPEST), log_span + np.log(_FLATTEST)),
        (0.0, model.most_lapses),
        (0.0, MOST_GUESSES) if model.guess == "free" else (_known_guess(model),) * 2,
    ]

    def parameters(values: Array) -> Parameters:
        threshold, log_spread, lapse, guess = values[:, None]
        return Parameters(threshold, log_spread, lapse, lapse if model.guess == "equal" else guess)

    def lost(values: Array) -> tuple[float, Array]:
        likely, slopes = model.slopes(x, parameters(values))
        likely = np.clip(likely[0], 1e-9, 1 - 1e-9)
        steep = slopes[0] @ ((counts.k - counts.n * likely) / (likely * (1 - likely)))
        return -float(log_likelihood(likely, counts.n, counts.k)), -steep

    # Climbs from the best functions of the most likely spreads.
    coarse = places[::_COARSE]
    grid = _grid(model, coarse, model.level, _NARROWEST / 5)
    value = log_likelihood(model.probability(x, grid), counts.n, counts.k)
    by_spread = value.reshape(len(coarse), _SPREADS, -1).swapaxes(0, 1).reshape(_SPREADS, -1)
    table = np.reshape(grid, (4, len(coarse), _SPREADS, -1)).swapaxes(1, 2)
    likely = by_spread.max(axis=1).argsort()[-_STARTS:]
    starts = table.reshape(4, _SPREADS, -1)[:, likely, by_spread[likely].argmax(axis=1)].T
    found = [
        minimize(
            lost, start, jac=True, method="L-BFGS-B", bounds=bounds,
            options={"ftol": 1e-12, "gtol": 1e-7},
        )
        for start in starts
    ]  # fmt: skip
    best = min(found, key=lambda each: float(each.fun))
    return Fit(model, counts, parameters(best.x), -float(best.fun))


def credible_interval(
    model: Model, counts: Counts, level: float, confidence: float = CONFIDENCE
) -> tuple[float, float]:
    """Return the credible interval of the place on the axis at which F reaches a level.

    Beforehand all places up to a span beyond the comparisons (at least two), all logarithms of
    spreads, all lapses and, if they are free, all guesses are equally likely. An end beyond the
    grid is infinite.
    """
    x = model.axis(counts.stimulus)
    places = _places(x)
    value = log_likelihood(model.probability(x, _grid(model, places, level)), counts.n, counts.k)
    share = np.cumsum(np.exp(value - value.max()).reshape(_PLACES, -1).sum(axis=1))
    ends = np.interp([(1 - confidence) / 2, (1 + confidence) / 2], share / share[-1], places)
    edge = _EDGE * (places[-1] - places[0]) / 3
    return (
        float(ends[0]) if ends[0] > places[0] + edge else -np.inf,
        float(ends[1]) if ends[1] < places[-1] - edge else np.inf,
    )


def _places(x: Array) -> Array:
    """Return the places of the grid: up to a span beyond the stimuli."""
    finite = x[np.isfinite(x)]
    low, high = float(finite.min()), float(finite.max())
    span = (high - low) or 1.0
    return np.linspace(low - span, high + span, _PLACES)


def _grid(model: Model, places: Array, level: float, narrowest: float = _NARROWEST) -> Parameters:
    """Return functions, (G,), that reach a level at places, with every spread, lapse and guess."""
    spreads = (places[-1] - places[0]) / 3 * np.geomspace(narrowest, _WIDEST, _SPREADS)
    lapses = np.linspace(0, model.most_lapses, _LAPSES)
    free = model.guess == "free"
    guesses = np.linspace(0, MOST_GUESSES, _GUESSES) if free else [_known_guess(model)]
    grid = np.meshgrid(places, np.log(spreads), lapses, guesses, indexing="ij")
    place, log_spread, lapse, guess = (each.ravel() for each in grid)
    # The place is that of the level: the model's own threshold lies beside it.
    aside = model.shape.inverse(model.level) - model.shape.inverse(level)
    threshold = place + aside * np.exp(log_spread)
    return Parameters(threshold, log_spread, lapse, lapse if model.guess == "equal" else guess)


def _known_guess(model: Model) -> float:
    return 0.0 if isinstance(model.guess, str) else model.guess
