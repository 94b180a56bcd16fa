"""Bootstrap confidence intervals: fits of resampled answers."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from smarttouch.psychophysics.fitting.answers import Counts
from smarttouch.psychophysics.fitting.likelihood import Maximum, maximize, saturated
from smarttouch.psychophysics.fitting.psychometric import Array, Model, Parameters

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
