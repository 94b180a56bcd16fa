"""The weighted up-down staircase: a step down after a success, a larger one up after a failure."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from smarttouch.errors import ExperimentError
from smarttouch.psychophysics.fitting.estimate import Estimate
from smarttouch.psychophysics.procedures.procedure import Condition, IntervalOrder

COARSE_FACTOR = 2.0
"""Factor of steps until the second reversal (our own choice)."""
COARSE_REVERSALS = 2
FEWEST_REVERSALS = 4
"""Fewest reversals with fine steps, for an estimate."""
PINNED_TRIALS = 4
"""Answers in a row toward the end of the range, after which the threshold lies beyond it."""


@dataclass
class WeightedStaircase:
    """One staircase of one standard.

    Steps up are target / (1 - target) times as large as steps down, so that it comes to rest
    where the target share of answers are successes (Kaernbach, Perception & Psychophysics 49,
    1991, Eq. 1). A trial without an answer is shown again, and counts as one of the most trials.
    """

    # start, lowest, highest: comparison to begin with, and its range
    start: float
    lowest: float
    highest: float
    # down, once it is fine: as a part of the comparison, or in its unit if not logarithmic
    step: float
    standard: float = 0.0  # standard; 0 if there is none
    target: float = 0.75  # share of successes that is looked for
    logarithmic: bool = True  # whether steps are ratios
    # reversals, most_trials: limits, the first of which ends it
    reversals: int = 14
    most_trials: int = 80
    two_intervals: bool = True  # whether standard and comparison come one after the other
    seed: int = 0  # of the interval in which the comparison comes
    trials: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        if not self.lowest <= self.start <= self.highest or self.lowest == self.highest:
            raise ExperimentError(
                f"a staircase cannot begin at {self.start:g} in a range from {self.lowest:g} to "
                f"{self.highest:g}: begin within it",
                about="start",
            )
        if self.logarithmic and self.lowest <= 0:
            raise ExperimentError(
                f"a staircase of ratios cannot go down to {self.lowest:g}: end it above 0",
                about="lowest",
            )
        if not (self.step > 0 and 0 < self.target < 1):
            raise ExperimentError(
                f"a staircase needs a step above 0 and a target between 0 and 1, not "
                f"{self.step:g} and {self.target:g}",
                about="target" if self.step > 0 else "step",
            )
        self._intervals = IntervalOrder(self.two_intervals, self.seed)
        self._down = math.log1p(self.step) if self.logarithmic else self.step
        self._level = self._to_scale(self.start)
        self._turns: list[float] = []
        self._rising: bool | None = None
        self._pinned = 0
        self._answered = 0
        self._shown: Condition | None = None

    @property
    def total(self) -> int | None:
        """None: the number of trials depends on the answers."""
        return None

    @property
    def done(self) -> bool:
        """Whether it has enough reversals or trials, or is stuck at the end of its range."""
        return (
            len(self._turns) >= self.reversals
            or self.trials >= self.most_trials
            or self._pinned >= PINNED_TRIALS
        )

    @property
    def turns(self) -> list[float]:
        """Comparisons at which the direction changed, in their order."""
        return [self._from_scale(each) for each in self._turns]

    def next(self) -> Condition:
        """Return the next condition."""
        if self.done:
            raise ExperimentError("the staircase is done: there is no next trial", about="trial")
        if self._shown is None:
            comparison = self._from_scale(self._level)
            interval = self._intervals.next()
            self._shown = Condition(self.standard, comparison, interval, self.trials, 0)
        return self._shown

    def answer(self, success: bool | None) -> None:
        """Step down after a success, up after a failure."""
        shown = self.next()
        self.trials += 1
        if success is None:
            self._shown = replace(shown, repetition=self.trials)
            return
        self._shown = None
        self._answered += 1
        if self._rising is not None and self._rising == success:
            self._turns.append(self._level)
        self._rising = not success
        step = self._down * (COARSE_FACTOR if len(self._turns) < COARSE_REVERSALS else 1)
        up = step * self.target / (1 - self.target)
        wanted = self._level - step if success else self._level + up
        low, high = self._to_scale(self.lowest), self._to_scale(self.highest)
        self._pinned = self._pinned + 1 if wanted < low or wanted > high else 0
        self._level = min(max(wanted, low), high)

    def estimate(self) -> Estimate | None:
        """Return the mean of the reversals with fine steps, from as many peaks as valleys.

        In simulations that is 4 to 5 % above the threshold, because it comes from above; a fit to
        the same answers is not. None if there are too few, or if it stands at the range's end.
        """
        fine = self._turns[COARSE_REVERSALS:]
        fine = fine[len(fine) % 2 :]
        if len(fine) < FEWEST_REVERSALS or self._pinned >= PINNED_TRIALS:
            return None
        middles = np.reshape(fine, (-1, 2)).mean(axis=1)
        threshold = self._from_scale(float(middles.mean()))
        spread = float(middles.std(ddof=1) / math.sqrt(len(middles)))
        if self.logarithmic:
            spread *= threshold
        return Estimate(threshold, spread, self._answered)

    def _to_scale(self, value: float) -> float:
        return math.log(value) if self.logarithmic else value

    def _from_scale(self, level: float) -> float:
        return math.exp(level) if self.logarithmic else level
