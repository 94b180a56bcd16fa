"""Simulated subject with known thresholds, who is slow, tires and drifts."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr


@dataclass
class SimulatedSubject:
    """Simulated responses at one electrode.

    Threshold and comfort are found at every second look; ``slope`` is the standard deviation of
    both in natural logarithms, ``guess`` the rate of false detections and ``lapse`` that of
    misses, ``reaction_s`` from a look to the key, of which single ones vary by a quarter, and
    ``drift`` the part by which both rise in a minute of stimulation.
    """

    threshold_ma: float
    comfort_ma: float
    slope: float = 0.1
    guess: float = 0.005
    lapse: float = 0.03
    look_s: float = 0.5
    reaction_s: float = 0.35
    drift: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)
        self._minutes = 0.0
        self._felt = False
        self._key_in_s: float | None = None
        self._look_in_s = 0.0
        self._forget()

    def presses(self, level_ma: float, seconds: float) -> bool:
        """Simulate a step of rising current; return whether a key is pressed."""
        self._minutes += seconds / 60
        if level_ma == 0:
            self._forget()
            return False
        if self._key_in_s is not None:
            self._key_in_s -= seconds
            if self._key_in_s > 0:
                return False
            self._key_in_s = None
            self._felt = not self._felt
            return True
        self._look_in_s -= seconds
        if self._look_in_s <= 0:
            self._look_in_s += self.look_s
            if self._finds(level_ma, self.comfort_ma if self._felt else self.threshold_ma):
                self._key_in_s = self.reaction_s * math.exp(0.25 * self._random.standard_normal())
        return False

    def _forget(self) -> None:
        self._felt = False
        self._key_in_s = None
        self._look_in_s = self._random.uniform(0, self.look_s)

    def _finds(self, level_ma: float, middle_ma: float) -> bool:
        middle_ma *= 1 + self.drift * self._minutes
        above = math.log(level_ma / middle_ma) / self.slope if level_ma else -math.inf
        chance = self.guess + (1 - self.guess - self.lapse) * float(ndtr(above))
        return bool(self._random.random() < chance)
