"""Observer of known thresholds in mA, for procedures that are to find them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from smarttouch.delivered.perception import strength
from smarttouch.profile import Profile
from smarttouch.psychophysics.observers.interval import Interval


@dataclass
class KnownObserver:
    """Observer that says whether a current is felt, or enough, by given thresholds."""

    profile: Profile
    # (E,) mA: threshold_ma, enough_ma: strongest electrode's current that is felt, or enough, in
    # half of the trials
    threshold_ma: NDArray[np.float32]
    enough_ma: NDArray[np.float32]
    seed: int = 0
    slope: float = 0.1  # standard deviation of both, in natural logarithms of current
    # guess, lapse: rate of false detections, and rate at which what is felt is not noticed
    guess: float = 0.02
    lapse: float = 0.02

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)
        self._middles_ma = {"felt": self.threshold_ma, "enough": self.enough_ma}

    def respond(
        self, task: str, intervals: Sequence[Interval], alternatives: Sequence[str]
    ) -> str | None:
        """Return y or n, to the task felt or enough."""
        return "y" if self._random.random() < self._chance_of(task, intervals) else "n"

    def chance_felt(self, current_ma: float, electrode: int, task: str = "felt") -> float:
        """Return the probability that a pulse is called felt, or with that task enough."""
        middle_ma = float(self._middles_ma[task][electrode])
        above = math.log(current_ma / middle_ma) if current_ma > 0 else -math.inf
        return chance_of_yes(above / self.slope, task, self.guess, self.lapse)

    def _chance_of(self, task: str, intervals: Sequence[Interval]) -> float:
        """Return the probability of a yes to the strongest pulse of all."""
        current_ua = np.concatenate([each.current_ua for each in intervals])
        if not len(current_ua):
            return self.chance_felt(0.0, 0, task)
        width_us = np.concatenate([each.width_us for each in intervals])
        magnitude = np.abs(current_ua) * strength(width_us, self.profile.pulse)[:, None]
        strongest = magnitude.argmax(axis=1)
        felt_ma = magnitude[np.arange(len(magnitude)), strongest] / 1000
        most = int((felt_ma / self._middles_ma[task][strongest]).argmax())
        return self.chance_felt(float(felt_ma[most]), int(strongest[most]), task)


def chance_of_yes(above: float, task: str, guess: float, lapse: float) -> float:
    """Return the probability of a yes to a stimulus so many standard deviations above the middle.

    Nothing is never enough, but may be called felt.
    """
    guess = guess if task == "felt" else 0.0
    return guess + (1 - guess - lapse) * float(ndtr(above))
