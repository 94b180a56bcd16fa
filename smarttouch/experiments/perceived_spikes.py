"""Delivered pulses of an interval, the spikes they cause in a finger, and the frequency perceived.

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

from smarttouch.base.afferent import Afferent
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.response import fire_all
from smarttouch.physiology.spikes import SpikeModel
from smarttouch.physiology.vibration_thresholds import best_hz, sensitivity
from smarttouch.running.delivered import DeliveredSlots


@dataclass(frozen=True, eq=False)
class Interval:
    """Pulses delivered in one interval of a trial, as the board reports them."""

    time_s: NDArray[np.float64]  # (N,) float64, s: of each slot, since the interval began
    width_us: NDArray[np.float32]  # (N,) float32, µs: duration of each slot
    current_ua: NDArray[np.int16]  # (N, E) int16, µA: current of each electrode, positive cathodic


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

FITTED = (
    "the simulated participant's sense of frequency was fitted to the paper's RA mode "
    f"({ALONE_HZ:g} Hz, {BASE_WEBER:.1%}, steepness {SHARPNESS:g}): where no PC fires, its "
    "thresholds are no result"
)
"""What to know of a modeled participant's answers to frequencies."""


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


Floats = NDArray[np.float32]

_LONGEST_US = 60_000  # longest pause that counts in full: refractory times are shorter


@dataclass(frozen=True, eq=False)
class Response:
    """Spikes of an interval."""

    finger: Finger
    fired: NDArray[np.bool_]  # (A, N) bool: whether each afferent fired in each slot
    time_s: NDArray[np.float64]  # (N,), s: of each slot

    @cached_property
    def counts(self) -> NDArray[np.intp]:
        """Number of spikes of each afferent, (A,)."""
        return np.asarray(self.fired.sum(axis=1))

    @property
    def per_slot(self) -> float:
        """Mean number of afferents that fire in a slot."""
        return float(self.fired.sum() / max(1, self.fired.shape[1]))

    @property
    def hz(self) -> float:
        """Frequency of the RA afferent that fires most, or else the PC; 0 with a spike or none."""
        for afferent in (Afferent.RA, Afferent.PC):
            own = np.where(self.finger.classes == afferent, self.counts, 0)
            if own.max(initial=0) > 1:
                fired_s = self.time_s[self.fired[own.argmax()]]
                apart_s = np.diff(fired_s)
                return float(1 / np.median(apart_s))
        return 0.0

    @property
    def ratio(self) -> float:
        """Ratio of PC to RA spikes, each for its density; infinite where PC alone fires.

        Whoever learned from vibration what a frequency feels like had as many afferents of each
        class as the finger has: a class with few counts for more.
        """
        anatomy = self.finger.anatomy
        ra, pc = (
            float(self.counts[self.finger.classes == each].sum() / anatomy.of(each).density_per_cm2)
            for each in (Afferent.RA, Afferent.PC)
        )
        if ra == 0:
            return math.inf if pc else 0.0
        return pc / ra

    @property
    def center_mm(self) -> NDArray[np.float64]:
        """Middle of the receptors that fire, (2,) mm; NaN where none does."""
        total = self.counts.sum()
        places = self.finger.receptor_mm.astype(np.float64)
        return np.asarray(self.counts @ places / (total or math.nan))


class Nerve:
    """Afferents of one finger that respond to the intervals of trials; the seed is of the noise
    from pulse to pulse."""

    def __init__(self, finger: Finger, seed: int = 0) -> None:
        self.finger: Finger = finger
        self._model = SpikeModel(finger, seed)

    def of(self, interval: Interval) -> Response:
        """Return the spikes of an interval."""
        width_us = interval.width_us.astype(np.uint16)
        apart_us = np.diff(interval.time_s * 1e6, append=math.inf) - width_us
        pause_us = np.clip(apart_us, 0, _LONGEST_US).astype(np.uint16)
        lasts_us = int(width_us.sum(dtype=np.int64) + pause_us.sum(dtype=np.int64))
        slots = DeliveredSlots(interval.current_ua, width_us, pause_us, lasts_us)
        (spikes,) = fire_all(self._model, [slots])
        return Response(self.finger, spikes.fired, interval.time_s)
