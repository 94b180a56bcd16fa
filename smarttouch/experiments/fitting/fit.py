"""Fit of one psychometric function, with bootstrap or credible intervals.

Resampling cannot know how steep a function is that changes between two comparisons, and finds what
adaptive procedures leave behind steeper than it is. Weighing every function by its likelihood can
(as Kuss, Jäkel and Wichmann, Journal of Vision 5(5):8, 2005, do with chains instead of a grid).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from smarttouch.experiments.fitting.answers import Counts
from smarttouch.experiments.fitting.psychometric import (
    MOST_GUESSES,
    Array,
    Maximum,
    Model,
    Parameters,
    bounds_of,
    maximize,
    saturated,
)

SAMPLES = 1000
CONFIDENCE = 0.95
_REPLICA_STARTS = 2


class Bounded(NamedTuple):
    """A figure and its confidence interval; an end that is not determined is infinite."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Replicas:
    """Fits of resampled answers."""

    parameters: Parameters  # (S,) each
    deviance: Array  # (S,)


def resample(
    model: Model, counts: Counts, best: Maximum, samples: int, seed: int, parametric: bool = True
) -> Replicas:
    """Fit answers resampled at the same comparisons, `best` being the fit of the answers
    themselves.

    Parametric answers are drawn from that fit, others are whole trials drawn from the trials (Efron
    and Tibshirani, *An Introduction to the Bootstrap*, 1993, chapter 6).
    """
    random = np.random.default_rng([seed, samples])
    x = model.axis(counts.stimulus)
    if parametric:
        likely = model.probability(x, best.parameters)[0]
        n = np.tile(counts.n, (samples, 1))
        k = random.binomial(counts.n.astype(int), likely, (samples, len(x))).astype(np.float64)
    else:
        cells = np.concatenate([counts.k, counts.n - counts.k])
        total = int(cells.sum())
        drawn = random.multinomial(total, cells / total, samples).astype(np.float64)
        k, missed = drawn[:, : len(x)], drawn[:, len(x) :]
        n = k + missed
    found = maximize(model, x, n, k, starts=_REPLICA_STARTS)
    return Replicas(found.parameters, 2 * (saturated(n, k) - found.log_likelihood))


def percentiles(replicas: Array, confidence: float) -> tuple[float, float]:
    """Return the percentile interval (Efron and Tibshirani 1993, Eq. 13.5)."""
    low, high = np.quantile(replicas, [(1 - confidence) / 2, (1 + confidence) / 2])
    return float(low), float(high)


_PLACES, _SPREADS, _LAPSES, _GUESSES = 301, 16, 5, 6
_NARROWEST, _WIDEST = 1 / 20, 2.0
"""Spreads, in spans of the comparisons; alike in logarithms, all equally likely (our own choice,
by which intervals of simulated subjects hold 92 to 95 % of thresholds)."""
_EDGE = 0.05
"""Part of a span: an interval that ends closer than this to the edge of the grid is unbounded."""


def credible_interval(
    model: Model, counts: Counts, level: float, confidence: float
) -> tuple[float, float]:
    """Return the credible interval of the place on the axis at which F reaches a level.

    Beforehand all places up to a span beyond the comparisons (at least two), all logarithms of
    spreads, all lapses and, if they are free, all guesses are equally likely. An end beyond the
    grid is infinite.
    """
    x = model.axis(counts.stimulus)
    within = bounds_of(model, x)
    low, high = float(within.low[0]), float(within.high[0])
    span = (high - low) / 3
    places = np.linspace(low, high, _PLACES)
    spreads = span * np.geomspace(_NARROWEST, _WIDEST, _SPREADS)
    lapses = np.linspace(0, model.most_lapses, _LAPSES)
    guesses = np.linspace(0, MOST_GUESSES, _GUESSES) if model.guess == "free" else np.zeros(1)
    grid = np.meshgrid(places, np.log(spreads), lapses, guesses, indexing="ij")
    place, log_spread, lapse, guess = (each.ravel() for each in grid)
    if model.guess == "equal":
        guess = lapse
    elif not isinstance(model.guess, str):
        guess = np.full_like(lapse, model.guess)
    # The place is that of the level: the model's own threshold lies beside it.
    aside = model.shape.inverse(model.level) - model.shape.inverse(level)
    threshold = place + aside * np.exp(log_spread)
    weight = _weigh(model, x, counts, Parameters(threshold, log_spread, lapse, guess))
    share = np.cumsum(weight.reshape(_PLACES, -1).sum(axis=1))
    ends = np.interp([(1 - confidence) / 2, (1 + confidence) / 2], share / share[-1], places)
    return (
        float(ends[0]) if ends[0] > low + _EDGE * span else -np.inf,
        float(ends[1]) if ends[1] < high - _EDGE * span else np.inf,
    )


def _weigh(model: Model, x: Array, counts: Counts, parameters: Parameters) -> Array:
    """Return the likelihood of each function, (G,), relative to the largest."""
    likely = np.clip(model.probability(x, parameters), 1e-9, 1 - 1e-9)
    value = np.log(likely) @ counts.k + np.log1p(-likely) @ (counts.n - counts.k)
    return np.asarray(np.exp(value - value.max()))


_STARTS = 20
_SUDDEN_SHARE = 0.05
"""Share of step-like replicas above which the replicas are too narrow for an interval."""
_CHANGING = (0.02, 0.98)
_FEWEST_CHANGING = 2
"""Comparisons with F between its ends; with fewer, its steepness is not determined."""
_BY_LEVEL = 4
"""Fewest answers at each comparison; with fewer, comparisons were mostly placed adaptively, or the
deviance is uninformative (McCullagh and Nelder, *Generalized Linear Models*, 1989, sec. 4.4.5)."""


@dataclass(frozen=True)
class BootstrapOptions:
    """Settings of the confidence intervals."""

    # samples, seed: of the bootstrap
    samples: int = SAMPLES
    seed: int = 0
    parametric: bool = True  # whether replicas are drawn from the fit, or from the trials
    confidence: float = CONFIDENCE


@dataclass(frozen=True, eq=False)
class Fit:
    """Most likely psychometric function."""

    model: Model
    counts: Counts  # answers it was fitted to
    best: Maximum  # the one function, B = 1

    @property
    def threshold(self) -> float:
        """Stimulus at the model's level."""
        return self.at(self.model.level)

    @property
    def spread(self) -> float:
        """Standard deviation of a normal F, on the model's axis."""
        return float(np.exp(self.best.parameters.log_spread[0]))

    @property
    def slope(self) -> float:
        """Steepness of F at its middle, per unit of the model's axis."""
        return float(self.model.shape.rises(np.zeros(1))[1][0]) / self.spread

    @property
    def lapse(self) -> float:
        """Upper asymptote, from 1."""
        return float(self.best.parameters.lapse[0])

    @property
    def guess(self) -> float:
        """Lower asymptote."""
        return float(self.best.parameters.guess[0])

    @property
    def deviance(self) -> float:
        """Deviance: twice the log likelihood lost against the observed shares."""
        lost = saturated(self.counts.n, self.counts.k) - self.best.log_likelihood[0]
        return float(2 * lost)

    @property
    def sudden(self) -> bool:
        """Whether answers change too suddenly to determine the steepness."""
        return _sudden(self.model, self.counts, self.best.parameters) > 0

    def at(self, part: float) -> float:
        """Return the stimulus at which F equals the given part of 1."""
        return float(self.model.stimulus(self.model.place(part, self.best.parameters)[0]))

    def __call__(self, stimulus: Array) -> Array:
        """Return the predicted shares at stimuli, (K,)."""
        x = self.model.axis(stimulus)
        return np.asarray(self.model.probability(x, self.best.parameters)[0])


def fit(counts: Counts, model: Model) -> Fit:
    """Fit one function by maximum likelihood to answers at two comparisons or more."""
    x = model.axis(counts.stimulus)
    return Fit(model, counts, maximize(model, x, counts.n, counts.k, starts=_STARTS))


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Uncertainty of a fit."""

    fit: Fit
    how: BootstrapOptions
    replicas: Replicas

    @property
    def sparse(self) -> bool:
        """Whether some comparison has few answers, as in adaptive procedures.

        Fits to such answers are too steep, and what is drawn from them varies too little: in
        simulations 95 % intervals of the bootstrap held 70 % of thresholds.
        """
        return bool(self.fit.counts.n.min() < _BY_LEVEL)

    @property
    def sudden(self) -> bool:
        """Whether fit or replicas change too suddenly to determine the steepness."""
        share = _sudden(self.fit.model, self.fit.counts, self.replicas.parameters)
        return self.fit.sudden or share > _SUDDEN_SHARE

    @property
    def by_posterior(self) -> bool:
        """Whether intervals come from the posterior instead of from replicas."""
        return self.sparse or self.sudden

    @property
    def goodness(self) -> float | None:
        """Share of replicas that fit no better; None where the deviance is not informative.

        Wichmann and Hill (2001), section on goodness of fit.
        """
        if not self.how.parametric or self.sparse:
            return None
        # Rounding must not make two that are the same differ.
        return float((self.replicas.deviance >= self.fit.deviance - 1e-6).mean())

    def at(self, part: float) -> Bounded:
        """Return the stimulus at which F equals the given part of 1, and its interval."""
        model = self.fit.model
        if self.by_posterior:
            low, high = credible_interval(model, self.fit.counts, part, self.how.confidence)
        else:
            places = model.place(part, self.replicas.parameters)
            low, high = percentiles(places, self.how.confidence)
        return Bounded(self.fit.at(part), *map(float, model.stimulus([low, high])))


def how_sure(found: Fit, how: BootstrapOptions) -> Uncertainty:
    """Compute the replicas of a fit."""
    drawn = resample(found.model, found.counts, found.best, how.samples, how.seed, how.parametric)
    return Uncertainty(found, how, drawn)


def _sudden(model: Model, counts: Counts, parameters: Parameters) -> float:
    """Return the share of functions that rise within about one step of the comparisons."""
    bare = parameters._replace(lapse=np.zeros_like(parameters.lapse), guess=np.zeros(1))
    rise = model.probability(model.axis(counts.stimulus), bare)
    changing = (rise > _CHANGING[0]) & (rise < _CHANGING[1])
    return float((changing.sum(axis=1) < _FEWEST_CHANGING).mean())
