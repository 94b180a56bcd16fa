"""Fit of the psychometric function ``p = guess + (1 - guess - lapse) F((x - middle) / spread)``.
p is the probability of a success (Wichmann and Hill, Perception & Psychophysics 63, 2001, Eq. 1).
F is the cumulative normal, as in the paper. x is the stimulus or its natural logarithm.

Estimates and credible intervals come from the posterior on a grid of parameters. With a grid, the
same answers always give the same result. Kuss, Jäkel and Wichmann (Journal of Vision 5(5):8, 2005)
sample the posterior by Markov chains instead.
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
"""Largest lapse rate (our own choice). Lapses are answers that do not depend on the stimulus."""
MOST_GUESSES = 0.5
"""Largest guess rate, if it is fitted. Guesses are answers *felt* in trials without a stimulus."""
QUANTILES = (0.5, 0.025, 0.975)
"""Quantiles of the posterior: the estimate and the ends of its 95 % interval."""
_MIDDLES, _SPREADS, _LAPSES, _GUESSES = 151, 21, 5, 6
_NARROWEST, _WIDEST = 1 / 40, 1.0
"""Smallest and largest spread on the grid, relative to the range of comparisons. Our choice: with
these limits, 92 to 98 % of simulated subjects have their true threshold in the 95 % interval."""
_EDGE = 0.05
"""Margin at the edge of the grid, relative to the range of comparisons. If a credible interval
ends in this margin, the end counts as undetermined."""
_NEGLIGIBLE = 1e-7  # the finer grid leaves out values with a posterior weight below this


class Counts(NamedTuple):
    """Trials and successes at each comparison."""

    stimulus: Array  # (K,): ascending
    n: Array  # (K,): number of answers
    k: Array  # (K,): number of successes


class Parameters(NamedTuple):
    """Parameters of one psychometric function, or of G functions, (G,) each."""

    middle: Array  # x at which F is 0.5
    spread: Array  # standard deviation of F, in units of x
    lapse: Array  # lapse rate, 0 to 1
    guess: Array  # guess rate, 0 to 1


class Bounded(NamedTuple):
    """Estimate and its credible interval. An undetermined end of the interval is infinite. On a
    logarithmic axis, an undetermined lower end is 0; for a Weber fraction, it is -1."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Model:
    """Family of psychometric functions that increase with the stimulus."""

    # Lower asymptote. A number is the known guess rate: 0.5 for two intervals, 1/m for m letters.
    # "equal": guess rate and lapse rate are equal, for comparisons on both sides of a standard.
    # "free": the guess rate is fitted, which needs some trials without a stimulus.
    guess: Guess = "equal"
    # Share of successes that defines the threshold. Lapses are left out, and if `guess` is "free",
    # guesses too. None means 0.75 if `guess` is "equal" (paper, Section III.C), 0.5 if `guess` is
    # "free", and (1 + `guess`) / 2 if `guess` is a number.
    at: float | None = None
    logarithmic: bool = True  # whether x is the logarithm of the stimulus
    most_lapses: float = MOST_LAPSES  # upper bound of the lapse rate

    def __post_init__(self) -> None:
        floor = 0.0 if isinstance(self.guess, str) else self.guess
        if not 0 <= floor < 1 - 2 * self.most_lapses:
            raise ExperimentError(
                f"a guess rate of {floor:g} is out of range: give at least 0 and "
                f"less than {1 - 2 * self.most_lapses:g}"
            )
        if self.at is not None and not floor < self.at < 1:
            raise ExperimentError(
                f"{self.at:g} as share of successes cannot define the threshold: give a share "
                f"between {floor:g} and 1"
            )

    @property
    def level(self) -> float:
        """Value of the cumulative normal F at the threshold."""
        if isinstance(self.guess, str):
            return self.at or (0.75 if self.guess == "equal" else 0.5)
        return 0.5 if self.at is None else (self.at - self.guess) / (1 - self.guess)

    @property
    def share(self) -> float:
        """Share of successes at the threshold, see `at`."""
        if isinstance(self.guess, str):
            return self.level
        return self.guess + (1 - self.guess) * self.level

    def axis(self, stimulus: ArrayLike) -> Array:
        """Return x for stimuli; minus infinity for a stimulus of zero on a logarithmic axis."""
        values = np.asarray(stimulus, np.float64)
        if not self.logarithmic:
            return values
        if (values < 0).any():
            raise ExperimentError(
                f"stimulus {values.min():g} has no logarithm: fit with logarithmic=False"
            )
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(values))

    def stimulus(self, position: ArrayLike) -> Array:
        """Return the stimuli for values of x."""
        return np.asarray(np.exp(position) if self.logarithmic else position, np.float64)

    def place(self, part: float, parameters: Parameters) -> Array:
        """Return the x at which the cumulative normal F equals ``part``."""
        return np.asarray(parameters.middle + ndtri(part) * parameters.spread)

    def probability(self, x: Array, parameters: Parameters) -> Array:
        """Return the probability of a success, (G, K), at each x, (K,)."""
        middle, spread, lapse, guess = (
            np.asarray(parameter)[..., None] for parameter in parameters
        )
        return np.asarray(guess + (1 - guess - lapse) * ndtr((x - middle) / spread))


def log_likelihood(likely: Array, n: Array, k: Array) -> Array:
    """Return the log likelihood, (...,). Per comparison, ``n`` is the number of trials, (K,), ``k``
    the number of successes, (K,), and ``likely`` the probability of a success, (..., K)."""
    # Clip the probabilities, so that their logarithms are finite.
    likely = np.clip(likely, 1e-9, 1 - 1e-9)
    return np.asarray(np.log(likely) @ k + np.log1p(-likely) @ (n - k))


@dataclass(frozen=True, eq=False)
class Fit:
    """Posterior of the psychometric functions of a model, given answers."""

    model: Model
    counts: Counts  # fitted answers
    ends: tuple[float, float]  # smallest and largest x among the comparisons and the standard
    functions: Parameters  # (G,)
    log_likelihoods: Array  # (G,): without the binomial coefficients

    @cached_property
    def weights(self) -> Array:
        """Posterior weights of the functions, (G,); their sum is 1."""
        weights = np.exp(self.log_likelihoods - self.log_likelihoods.max())
        return np.asarray(weights / weights.sum())

    @cached_property
    def parameters(self) -> Parameters:
        """Estimates, (1,) each. `middle` follows from the posterior median of the threshold.
        `spread` is the geometric posterior mean. The other estimates are posterior means."""
        _, spread, lapse, guess = self.functions
        spread = np.exp([self.weights @ np.log(spread)])
        middle = self._quantiles(self.model.level)[0] - ndtri(self.model.level) * spread
        others = (np.array([self.weights @ grid]) for grid in (lapse, guess))
        return Parameters(middle, spread, *others)

    def bounded(self, part: float) -> Bounded:
        """Return the stimulus at which F equals ``part``, with its credible interval."""
        value, low, high = self._quantiles(part)
        first, last = self.ends
        edge = (1 - _EDGE) * (last - first)
        low = low if low > first - edge else -np.inf
        high = high if high < last + edge else np.inf
        return Bounded(*self.model.stimulus([value, low, high]).tolist())

    def __call__(self, stimulus: Array) -> Array:
        """Return the predicted shares of successes at stimuli, (K,)."""
        return np.asarray(self.model.probability(self.model.axis(stimulus), self.parameters)[0])

    def _quantiles(self, part: float) -> Array:
        """Return the posterior quantiles (`QUANTILES`) of the x at which F equals ``part``."""
        position = self.model.place(part, self.functions)
        order = np.argsort(position)
        below = np.cumsum(self.weights[order]) - self.weights[order] / 2
        return np.interp(QUANTILES, below, position[order])


def fit(counts: Counts, model: Model, standard: float = 0.0) -> Fit:
    """Fit psychometric functions to answers at two or more comparisons.

    Priors are uniform for `middle`, the logarithm of `spread`, the lapse rate and, if it is fitted,
    the guess rate. The grid covers a range of `middle` three times as wide as `Fit.ends`.
    """
    x = model.axis(counts.stimulus)
    finite = model.axis([*counts.stimulus, standard or counts.stimulus[-1]])
    finite = finite[np.isfinite(finite)]
    first, last = float(finite.min()), float(finite.max())
    span = (last - first) or 1.0
    middles = np.linspace(first - span, last + span, _MIDDLES)
    spreads = np.linspace(np.log(span * _NARROWEST), np.log(span * _WIDEST), _SPREADS)
    for _ in range(2):  # the second grid is finer and leaves out values of negligible weight
        functions = _grid(model, middles, np.exp(spreads))
        likely = log_likelihood(model.probability(x, functions), counts.n, counts.k)
        found = Fit(model, counts, (first, last), functions, likely)
        weights = found.weights.reshape(_MIDDLES, _SPREADS, -1)
        middles = _refined(middles, weights.sum(axis=(1, 2)))
        spreads = _refined(spreads, weights.sum(axis=(0, 2)))
    return found


def _refined(values: Array, weights: Array) -> Array:
    """Return as many values, spread evenly over the part in which weights exceed `_NEGLIGIBLE`."""
    some = np.flatnonzero(weights > _NEGLIGIBLE)
    low, high = values[max(some[0] - 1, 0)], values[min(some[-1] + 1, len(values) - 1)]
    return np.linspace(low, high, len(values))


def _grid(model: Model, middles: Array, spreads: Array) -> Parameters:
    """Return functions, (G,), for all combinations of parameters; `middle` varies slowest."""
    lapses = np.linspace(0, model.most_lapses, _LAPSES)
    known = 0.0 if isinstance(model.guess, str) else model.guess
    guesses = np.linspace(0, MOST_GUESSES, _GUESSES) if model.guess == "free" else [known]
    middle, spread, lapse, guess = map(
        np.ravel, np.meshgrid(middles, spreads, lapses, guesses, indexing="ij")
    )
    return Parameters(middle, spread, lapse, lapse if model.guess == "equal" else guess)
