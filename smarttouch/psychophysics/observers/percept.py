"""Model of the perceived frequency of a pulse train.

The paper's own explanation of its thresholds (Section III-C) as a model. Pulses fire RA
and, if they reach deep enough, PC. RA's pulses carry the frequency; but a person who has learned
from mechanical vibration what a frequency feels like expects ever more PC with it. A train
with too little PC for its frequency is taken for a slower one.

What follows: where no PC fires nothing above `ALONE_HZ` is believed; where some do, as in PC
mode, something above. What is assumed: the form of the soft minimum, and three numbers that fit
the paper's RA mode, `ALONE_HZ`, `BASE_WEBER` and `SHARPNESS`. That RA mode gives out near 65 Hz is
put in by the first, and explains nothing.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from smarttouch.afferent import Afferent
from smarttouch.physiology.receptors import best_hz, sensitivity

Array = NDArray[np.float64]

BASE_WEBER = 0.125
"""75 % discrimination threshold where nothing contradicts the pulses' own frequency. Ours: with
it thresholds stay below the 20 % of the paper up to 45 Hz (Section III-C)."""
ALONE_HZ = 65.0
"""Highest frequency believed without any PC. Ours: between 60 and 70 Hz, where the paper lets PC
come in and RA end. On the fingertip both are alike at 40 Hz."""
SHARPNESS = 3.2
"""Steepness of the limit of perceived frequency. Ours: with it the threshold at 75 Hz in RA mode
is 0.68, where the paper has 0.7."""


@dataclass(frozen=True)
class FrequencySense:
    """Model of perceived frequency: its mean, and the discrimination of two trains.

    Perceived is the soft minimum of the pulses' frequency f and of the highest frequency L
    that the activity of PC and RA lets believe: (f^−n + L^−n)^(−1/n), with noise on its
    logarithm.
    """

    weber: float = BASE_WEBER  # 75 % threshold where L is far away
    sharpness: float = SHARPNESS

    def believable_hz(self, ratio: float) -> float:
        """Return the highest frequency perceived at a ratio of PC to RA, Hz.

        It is the frequency of a mechanical vibration to which PC and RA, each of what it
        answers at its best, answer in that ratio (paper, Fig. 2). No PC at all means that
        the vibration lies where only RA answers: below `ALONE_HZ`.
        """
        hz, ratios = self._learned
        return float(np.interp(ratio, ratios, hz))

    @cached_property
    def _learned(self) -> tuple[Array, Array]:
        # Up to the best frequency of PC: beyond it the ratio falls again.
        hz = np.geomspace(ALONE_HZ, best_hz(Afferent.PC), 200)
        return hz, sensitivity(Afferent.PC, hz) / sensitivity(Afferent.RA, hz)

    @cached_property
    def spread(self) -> float:
        """Standard deviation of the logarithm of one perceived frequency."""
        return math.log1p(self.weber) / float(math.sqrt(2) * ndtri(0.75))

    def perceived_hz(self, hz: float, ratio: float) -> float:
        """Return the perceived frequency of a train, without noise, Hz."""
        n, limit_hz = self.sharpness, self.believable_hz(ratio)
        return float((hz**-n + limit_hz**-n) ** (-1 / n))

    def chance_higher(self, standard_hz: float, comparison_hz: float, ratio: float) -> float:
        """Return the probability that the comparison is judged faster, if both have that ratio."""
        apart = math.log(
            self.perceived_hz(comparison_hz, ratio) / self.perceived_hz(standard_hz, ratio)
        )
        return float(ndtr(apart / (math.sqrt(2) * self.spread)))
