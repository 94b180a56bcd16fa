"""QUEST+: each stimulus is the one with the least expected entropy after its answer."""

from dataclasses import dataclass, field

import numpy as np

from smarttouch.errors import ExperimentError
from smarttouch.psychophysics.fitting.estimate import Estimate
from smarttouch.psychophysics.fitting.psychometric import Array, Model, Parameters
from smarttouch.psychophysics.procedures.procedure import Condition, IntervalOrder

STIMULI, THRESHOLDS = 41, 61
SLOPES = 9
LAPSES = (0.0, 0.02, 0.05, 0.1)
"""Lapse rates of the grid, all equally likely beforehand (our own choice)."""
NARROWEST, WIDEST = 1 / 40, 1.0
"""Spreads of the grid, in spans of the stimuli."""


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
    fewest_trials: int = 20
    # it also ends when the posterior of the threshold is as narrow as this: a part of the
    # threshold, or, on a linear axis, in its unit. 0: never.
    enough_spread: float = 0.0
    two_intervals: bool = True  # whether standard and comparison come one after the other
    seed: int = 0  # of the interval in which the comparison comes
    trials: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        if not self.lowest < self.highest or (self.model.logarithmic and self.lowest <= 0):
            raise ExperimentError(
                f"stimuli from {self.lowest:g} to {self.highest:g} are no range: begin "
                f"{'above 0, and ' if self.model.logarithmic else ''}below its end",
                about="range",
            )
        if isinstance(self.model.guess, str) and self.model.guess == "free":
            raise ExperimentError(
                "QUEST+ needs a known guess rate: 0, 0.5 or one of letters", about="guess"
            )
        low, high = (float(self.model.axis(each)) for each in (self.lowest, self.highest))
        self._places = np.linspace(low, high, STIMULI)
        self._thresholds = np.linspace(low, high, THRESHOLDS)
        spreads = (high - low) * np.geomspace(NARROWEST, WIDEST, SLOPES)
        lapses = [each for each in LAPSES if each <= self.model.most_lapses]
        grid = np.meshgrid(self._thresholds, np.log(spreads), lapses, indexing="ij")
        threshold, log_spread, lapse = (each.ravel() for each in grid)
        guess = lapse if self.model.guess == "equal" else np.full_like(lapse, self.model.guess)
        parameters = Parameters(threshold, log_spread, lapse, guess)
        self._likely = self.model.probability(self._places, parameters).T
        self._unsure = _entropy(self._likely)
        self._posterior = np.full(len(threshold), 1 / len(threshold))
        self._intervals = IntervalOrder(self.two_intervals, self.seed)
        self._answered = 0
        self._place = 0
        self._shown: Condition | None = None

    @property
    def total(self) -> int | None:
        """Largest number of trials; None if it may end before."""
        return None if self.enough_spread else self.most_trials

    @property
    def done(self) -> bool:
        """Whether the posterior is narrow enough, or all trials are used."""
        enough = self._answered >= self.fewest_trials and self._spread <= self.enough_spread
        return enough or self.trials >= self.most_trials

    def next(self) -> Condition:
        """Return the next condition."""
        if self.done:
            raise ExperimentError("all trials are done: there is no next one", about="trial")
        if self._shown is None:
            says = _entropy(self._likely @ self._posterior) - self._unsure @ self._posterior
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


def _entropy(likely: Array) -> Array:
    """Return the entropy of an answer, in nats."""
    likely = np.clip(likely, 1e-12, 1 - 1e-12)
    return np.asarray(-(likely * np.log(likely) + (1 - likely) * np.log1p(-likely)))
