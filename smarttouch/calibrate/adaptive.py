"""Adaptive yes-no threshold: each pulse train at the level of most information.

A posterior over threshold, slope and guesses on a grid; each level is the one whose
answer is expected to leave the least entropy (the psi method: Kontsevich and Tyler,
Vision Research 39, 1999). Trials without current find out how often *felt* is said of
nothing.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

GRID_FACTOR = 3.0
"""Factor by which the grid of thresholds reaches below and above the expected threshold."""
PRIOR_SPREAD = 0.35
"""Spread of the prior of the logarithm of the threshold, around the ascending estimate."""
SLOPES = (0.04, 0.08, 0.14, 0.22, 0.32)
"""Standard deviations of the psychometric function, in natural logarithms of current."""
GUESSES = (0.01, 0.05, 0.15, 0.3)
LAPSE = 0.03
BLANK_SHARE = 0.15
"""Part of the trials without current."""
ENOUGH_SPREAD = 0.05
"""Spread of the posterior of the log threshold that ends the procedure."""
FEWEST_TRIALS = 12
MOST_TRIALS = 30
MOST_GUESSED = 0.4
"""Part of the blank trials called felt above which the threshold is not determined."""


@dataclass
class AdaptiveThreshold:
    """Adaptive procedure at one electrode.

    In a loop until `done`: show the level of `next`, then `answer` whether it was felt.
    """

    expected_ma: float  # the ascending estimate
    ceiling_ma: float  # never exceeded; the ascending comfort is a good one
    seed: int | tuple[int, ...] = 0  # of when blank trials come
    trials: int = 0
    blanks: int = 0
    guessed: int = 0
    _level_ma: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)
        reach = np.log(GRID_FACTOR)
        around = np.linspace(-reach, reach, 111)
        self._log = np.log(self.expected_ma) + around
        prior = np.exp(-((around / PRIOR_SPREAD) ** 2) / 2)
        guess = np.array([0.4, 0.3, 0.2, 0.1])
        self._posterior = prior[:, None, None] * np.ones(len(SLOPES))[:, None] * guess
        self._posterior /= self._posterior.sum()

    @property
    def done(self) -> bool:
        enough = self.trials >= FEWEST_TRIALS and self.spread <= ENOUGH_SPREAD
        return enough or self.trials >= MOST_TRIALS

    @property
    def threshold_ma(self) -> float:
        """Level that is felt half the time, apart from guesses and lapses."""
        return float(np.exp(self._marginal @ self._log))

    @property
    def spread(self) -> float:
        """Standard deviation of the posterior, as a part of the threshold."""
        mean = self._marginal @ self._log
        return float(np.sqrt(self._marginal @ (self._log - mean) ** 2))

    @property
    def believable(self) -> bool:
        """True if blank trials were mostly called blank."""
        return self.guessed <= MOST_GUESSED * max(self.blanks, 2)

    def next(self) -> float:
        """Return the level of the next trial, mA."""
        self._level_ma = 0.0 if self._random.random() < BLANK_SHARE else self._best()
        return self._level_ma

    def answer(self, felt: bool) -> None:
        """Take the answer: whether the last level was felt."""
        self.trials += 1
        if self._level_ma == 0.0:
            self.blanks += 1
            self.guessed += felt
        likely = self._felt(np.array([self._level_ma]))[0]
        self._posterior *= likely if felt else 1 - likely
        self._posterior /= self._posterior.sum()

    @property
    def _marginal(self) -> NDArray[np.float64]:
        return np.asarray(self._posterior.sum(axis=(1, 2)))

    def _best(self) -> float:
        """Return the candidate with the most expected information."""
        middle, width = np.log(self.threshold_ma), max(self.spread, 0.05)
        levels = np.exp(middle + width * np.linspace(-2.5, 2.5, 11))
        levels = np.minimum(levels, self.ceiling_ma)
        felt = self._felt(levels)
        joint = felt * self._posterior
        says = joint.sum(axis=(1, 2, 3))
        yes = joint.sum(axis=(2, 3))
        no = self._marginal - yes
        # What is to be known is the threshold; slope and guesses only matter for it.
        left = -_plogp(yes) - _plogp(no) + _plogp(np.stack([says, 1 - says], axis=1))
        return float(levels[left.argmin()])

    def _felt(self, levels_ma: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the chance that each level is called felt, (L, thresholds, slopes, guesses)."""
        with np.errstate(divide="ignore"):
            above = np.log(levels_ma)[:, None, None] - self._log[:, None]
        detected = ndtr(above / np.array(SLOPES))[..., None]
        guess = np.array(GUESSES)
        return np.asarray(guess + (1 - guess - LAPSE) * detected)


def _plogp(part: NDArray[np.float64]) -> NDArray[np.float64]:
    logs = np.log(part, out=np.zeros_like(part), where=part > 0)
    return np.asarray((part * logs).sum(axis=1))
