"""Fit of one psychometric function to the answers to one standard."""

from dataclasses import dataclass

import numpy as np

from smarttouch.psychophysics.fitting.answers import Counts
from smarttouch.psychophysics.fitting.bootstrap import (
    CONFIDENCE,
    SAMPLES,
    Bounded,
    Replicas,
    percentiles,
    resample,
)
from smarttouch.psychophysics.fitting.likelihood import Maximum, maximize, saturated
from smarttouch.psychophysics.fitting.posterior import credible_interval
from smarttouch.psychophysics.fitting.psychometric import Array, Model, Parameters

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
        """Return the shares that it expects at stimuli, (K,)."""
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
