"""Adaptive procedures: the weighted staircase and QUEST+, with ranges that suit each experiment."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from smarttouch.base.errors import ExperimentError
from smarttouch.experiments.fitting.psychometric import Array, Estimate, Model, Parameters
from smarttouch.experiments.psychophysics.procedures import (
    WIDEST_RATIO,
    Condition,
    Interleaved,
    IntervalOrder,
    Procedure,
)

COARSE_FACTOR = 2.0  # factor of steps until the second reversal (our own choice)
COARSE_REVERSALS = 2
FEWEST_REVERSALS = 4  # fewest reversals with fine steps, for an estimate
PINNED_TRIALS = 4
"""Answers in a row toward the end of the range, after which the threshold lies beyond it."""


@dataclass
class WeightedStaircase(Procedure):
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
                f"{self.highest:g}: begin within it"
            )
        if self.logarithmic and self.lowest <= 0:
            raise ExperimentError(
                f"a staircase of ratios cannot go down to {self.lowest:g}: end it above 0"
            )
        if not (self.step > 0 and 0 < self.target < 1):
            raise ExperimentError(
                "a staircase needs a step above 0 and a target between 0 and 1, not "
                f"{self.step:g} and {self.target:g}"
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
            raise ExperimentError("the staircase is done: there is no next trial")
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


STIMULI, THRESHOLDS = 41, 61
SLOPES = 9
LAPSES = (0.0, 0.02, 0.05, 0.1)
"""Lapse rates of the grid, all equally likely beforehand (our own choice)."""
NARROWEST, WIDEST = 1 / 40, 1.0
"""Spreads of the grid, in spans of the stimuli, as far as nothing is known of them."""


@dataclass
class QuestPlus:
    """QUEST+ for one threshold, on a grid of threshold, slope and lapse (Watson, Journal of Vision
    17(3):10, 2017).

    The expected entropy of the posterior is least where the answer's own entropy exceeds most
    what is expected of it given the parameters: the same stimulus, found without one posterior for
    each.
    """

    # lowest, highest: range of stimuli and thresholds
    lowest: float
    highest: float
    model: Model = field(default_factory=Model)
    standard: float = 0.0  # standard; 0 if there is none
    most_trials: int = 60
    two_intervals: bool = True  # whether standard and comparison come one after the other
    seed: int = 0  # of the interval in which the comparison comes
    widest: float = WIDEST  # spread of the grid, in spans of the stimuli
    trials: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        if not self.lowest < self.highest or (self.model.logarithmic and self.lowest <= 0):
            raise ExperimentError(
                f"stimuli from {self.lowest:g} to {self.highest:g} are no range: begin "
                f"{'above 0, and ' if self.model.logarithmic else ''}below its end"
            )
        if isinstance(self.model.guess, str) and self.model.guess == "free":
            raise ExperimentError("QUEST+ needs a known guess rate: 0, 0.5 or one of letters")
        low, high = (float(self.model.axis(each)) for each in (self.lowest, self.highest))
        self._places = np.linspace(low, high, STIMULI)
        self._thresholds = np.linspace(low, high, THRESHOLDS)
        spreads = (high - low) * np.geomspace(NARROWEST, self.widest, SLOPES)
        lapses = [each for each in LAPSES if each <= self.model.most_lapses]
        grid = np.meshgrid(self._thresholds, np.log(spreads), lapses, indexing="ij")
        threshold, log_spread, lapse = (each.ravel() for each in grid)
        guess = lapse if self.model.guess == "equal" else np.full_like(lapse, self.model.guess)
        parameters = Parameters(threshold, np.exp(log_spread), lapse, guess)
        self._likely = self.model.probability(self._places, parameters).T
        self._unsure = entropy(self._likely)
        self._posterior = np.full(len(threshold), 1 / len(threshold))
        self._intervals = IntervalOrder(self.two_intervals, self.seed)
        self._answered = 0
        self._place = 0
        self._shown: Condition | None = None

    @property
    def total(self) -> int:
        """Number of trials."""
        return self.most_trials

    @property
    def done(self) -> bool:
        """Whether all trials are used."""
        return self.trials >= self.most_trials

    def next(self) -> Condition:
        """Return the next condition."""
        if self.done:
            raise ExperimentError("all trials are done: there is no next one")
        if self._shown is None:
            says = entropy(self._likely @ self._posterior) - self._unsure @ self._posterior
            self._place = int(says.argmax())
            comparison = float(self.model.stimulus(self._places[self._place]))
            interval = self._intervals.next()
            self._shown = Condition(self.standard, comparison, interval, self.trials, 0)
        return self._shown

    def answer(self, success: bool | None) -> None:
        """Update the posterior by the answer; no answer leaves it as it is, and uses the trial."""
        self.next()
        self.trials += 1
        self._shown = None
        if success is None:
            return
        self._answered += 1
        likely = self._likely[self._place]
        self._posterior = self._posterior * (likely if success else 1 - likely)
        self._posterior /= self._posterior.sum()

    def estimate(self) -> Estimate | None:
        """Return mean and standard deviation of the threshold's posterior; None without answers."""
        if not self._answered:
            return None
        threshold = float(self.model.stimulus(self._marginal @ self._thresholds))
        spread = self._spread * (threshold if self.model.logarithmic else 1.0)
        return Estimate(threshold, spread, self._answered)

    @property
    def _marginal(self) -> Array:
        return np.asarray(self._posterior.reshape(THRESHOLDS, -1).sum(axis=1))

    @property
    def _spread(self) -> float:
        mean = self._marginal @ self._thresholds
        return float(np.sqrt(self._marginal @ (self._thresholds - mean) ** 2))


def entropy(likely: Array) -> Array:
    """Return the entropy of an answer, in nats."""
    likely = np.clip(likely, 1e-12, 1 - 1e-12)
    return np.asarray(-(likely * np.log(likely) + (1 - likely) * np.log1p(-likely)))


NARROWEST_RATIO = 1.01
_START_RATIO = 1.6  # first ratio of a staircase: clearly faster (our own choice)
_STEP = 0.03
"""Step of a staircase of frequencies: a quarter of the mechanical threshold of about 20 % is 5 %.
"""
_DETECTION_STEP = 0.05
_DETECTION_RANGE = (0.3, 3.0)  # range of detection, as parts of the profile's threshold


def frequency_procedures(
    method: str, standards: Sequence[float], highest_hz: float, trials: int | None, seed: int
) -> Procedure:
    """Return a staircase or QUEST+ of each standard, mixed at random.

    Comparisons are faster than the standard: the upper threshold is looked for.
    """
    procedures: list[Procedure] = []
    for index, standard in enumerate(standards):
        low, high = NARROWEST_RATIO * standard, min(WIDEST_RATIO * standard, highest_hz)
        if high <= low:
            raise ExperimentError(
                f"nothing can be faster than a standard of {standard:g} Hz within the profile's "
                f"limit of {highest_hz:g} Hz: give lower standards"
            )
        order = seed + 1000 * index
        if method == "staircase":
            first, most = min(_START_RATIO * standard, high), trials or 80
            procedures.append(
                WeightedStaircase(first, low, high, _STEP, standard, most_trials=most, seed=order)
            )
        else:
            procedures.append(
                QuestPlus(low, high, Model(guess=0.5), standard, trials or 60, seed=order)
            )
    return Interleaved(procedures, seed)


def detection_procedure(
    method: str,
    threshold_ma: float,
    full_ma: float,
    two_intervals: bool,
    trials: int | None,
    seed: int,
) -> Procedure:
    """Return a staircase or QUEST+ of current, up to the strongest comfortable one."""
    low = _DETECTION_RANGE[0] * threshold_ma
    high = min(_DETECTION_RANGE[1] * threshold_ma, full_ma)
    if method == "staircase":
        start = min(1.5 * threshold_ma, high)
        return WeightedStaircase(
            start, low, high, _DETECTION_STEP, most_trials=trials or 80,
            two_intervals=two_intervals, seed=seed,
        )  # fmt: skip
    model = Model(guess=0.5 if two_intervals else 0.0)
    return QuestPlus(
        low, high, model, 0.0, trials or 60, two_intervals=two_intervals, seed=seed
    )  # fmt: skip
