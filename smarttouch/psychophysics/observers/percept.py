"""Model of perceived pulse trains: afferents recruited, and perceived frequency.

The paper's own explanation of its thresholds (Section III-C) as a model. Pulses fire RA
and, if they reach deep enough, PC. RA's pulses tell the frequency; but who has learned
from mechanical vibration what a frequency feels like expects ever more PC with it. A train
with too little PC for its frequency is taken for a slower one.

What follows: in PC mode, whose pulses fire RA more than PC, nothing above 100 Hz or so is
believed. What is assumed: the part of the afferents that an activating function recruits, the
form of the soft minimum, and three numbers that fit the paper's RA mode, `ALONE_HZ`, `BASE_WEBER`
and `SHARPNESS`. That RA mode gives out near 65 Hz is put in by the first, and explains nothing.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from smarttouch.afferent import Afferent
from smarttouch.delivered.perception import strength
from smarttouch.kernels.bank import KernelBank
from smarttouch.physiology.receptors import best_hz, sensitivity
from smarttouch.profile import Profile
from smarttouch.psychophysics.observers.interval import Interval

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
class Activity:
    """Activity of the vibration senses in an interval.

    Attributes
    ----------
    hz : float, Hz
        Of the pulses that fired; 0 where fewer than two did.
    ra, pc : float
        Recruited part of the afferents where it is largest, over all pulses.
    """

    hz: float
    ra: float
    pc: float

    @property
    def ratio(self) -> float:
        """Ratio of PC to RA; infinite where PC alone fired."""
        if self.ra == 0:
            return math.inf if self.pc else 0.0
        return self.pc / self.ra


class Recruitment:
    """Recruitment model: the part of RA and PC that fires at each pulse.

    A node of Ranvier fires where its activating function (AF) exceeds a threshold, the same
    for all classes (paper, Section II); here the least AF with which any mode is felt, the
    profile's detection current through its own kernel. Afferents around a node differ: of
    an AF x times the threshold a part of 1 − 1/x fires. (That part is our assumption, the
    simplest that begins at 0 and ends at all.)

    Parameters
    ----------
    profile : Profile
        Thresholds and pulse.
    bank : KernelBank
        Receptors, and kernels of the modes that are offered.
    """

    def __init__(self, profile: Profile, bank: KernelBank) -> None:
        self._pulse = profile.pulse
        own = np.stack([(bank.receptor[each] * bank.kernels(each)).sum(1) for each in bank.weights])
        # Masked sites have no kernel: nothing fires there.
        least = np.where(own > 0, own, np.inf).min(axis=0)
        self._threshold_ua = np.asarray(1000 * profile.threshold_ma * least, np.float32)
        self._axons: dict[Afferent, NDArray[np.float32]] = {
            each: np.ascontiguousarray(bank.receptor[each].T)
            for each in (Afferent.RA, Afferent.PC)
            if each in bank.receptor
        }

    def of(self, interval: Interval) -> Activity:
        """Return the activity of a whole interval."""
        if not len(interval.time_s):
            return Activity(0.0, 0.0, 0.0)
        slots, which = interval.distinct()
        does = strength(interval.width_us[slots], self._pulse)
        current_ua = interval.current_ua[slots] * does[:, None]
        ra, pc = (self._recruited(current_ua, each)[which] for each in (Afferent.RA, Afferent.PC))
        hz = _hz(interval.time_s, ra) or _hz(interval.time_s, pc)
        return Activity(hz, float(ra.max(axis=1).sum()), float(pc.max(axis=1).sum()))

    def _recruited(
        self, current_ua: NDArray[np.float32], afferent: Afferent
    ) -> NDArray[np.float32]:
        """Return the part that each slot fires under each electrode, (N, E) in [0, 1)."""
        axons = self._axons.get(afferent)
        if axons is None:
            return np.zeros_like(current_ua)
        above = current_ua @ axons
        above /= self._threshold_ua
        return np.asarray(1 - 1 / np.maximum(above, 1), np.float32)


def _hz(time_s: Array, recruited: NDArray[np.float32]) -> float:
    """Return the frequency of pulses at the place that fires most."""
    fired_s = time_s[recruited[:, recruited.sum(axis=0).argmax()] > 0]
    period_s = float(np.median(np.diff(fired_s))) if len(fired_s) > 1 else 0.0
    return 1 / period_s if period_s > 0 else 0.0


@dataclass(frozen=True)
class FrequencySense:
    """Model of perceived frequency: its mean, and the discrimination of two trains.

    Perceived is the soft minimum of the pulses' frequency f and of the highest frequency L
    that the activity of PC and RA lets believe: (f^−n + L^−n)^(−1/n), with noise on its
    logarithm.

    Attributes
    ----------
    weber : float
        75 % threshold where L is far away.
    sharpness : float
        n.
    """

    weber: float = BASE_WEBER
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
