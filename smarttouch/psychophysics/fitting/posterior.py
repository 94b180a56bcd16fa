"""Credible intervals from a posterior on a grid, where answers are few or change too suddenly.

Resampling cannot know how steep a function is that changes between two comparisons, and finds what
adaptive procedures leave behind steeper than it is. Weighing every function by its likelihood can
(as Kuss, Jäkel and Wichmann, Journal of Vision 5(5):8, 2005, do with chains instead of a grid).
"""

import numpy as np

from smarttouch.psychophysics.fitting.answers import Counts
from smarttouch.psychophysics.fitting.likelihood import bounds_of
from smarttouch.psychophysics.fitting.psychometric import MOST_GUESSES, Array, Model, Parameters

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
