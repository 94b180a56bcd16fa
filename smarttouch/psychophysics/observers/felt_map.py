"""Answers of all classes to one interval, site by site; their middle and their width."""

import math

import numpy as np
from numpy.typing import NDArray

from smarttouch.delivered.perception import Perception
from smarttouch.kernels.bank import KernelBank
from smarttouch.profile import Profile
from smarttouch.psychophysics.observers.interval import Interval

Floats = NDArray[np.float32]


class SiteResponse:
    """Map of the strongest answers of the classes that a board reaches."""

    def __init__(self, profile: Profile, bank: KernelBank) -> None:
        self._perception = Perception(profile, bank, tuple(sorted(bank.weights)))
        self._position_mm = profile.electrodes.position_mm

    def of(self, interval: Interval) -> Floats:
        """Return how strongly each site was felt at most, (E,) in [0, 1]."""
        slots, _ = interval.distinct()
        width_us, current_ua = interval.width_us[slots], interval.current_ua[slots]
        answers = self._perception.answers(np.zeros(len(slots), np.uint32), width_us, current_ua)
        return answers.get(0, np.zeros(len(self._position_mm), np.float32))

    def center_mm(self, felt: Floats) -> NDArray[np.float64]:
        """Return the middle of a map, (2,) mm; NaN where nothing is felt."""
        return np.asarray(felt @ self._position_mm / (felt.sum() if felt.any() else math.nan))

    def width_mm(self, felt: Floats) -> float:
        """Return the distance of two equal points that spread as a map does, mm.

        Twice its largest standard deviation; NaN where nothing is felt.
        """
        if not felt.any():
            return math.nan
        away_mm = self._position_mm - self.center_mm(felt)
        spread = (felt[:, None] * away_mm).T @ away_mm / felt.sum()
        return 2 * math.sqrt(max(0.0, float(np.linalg.eigvalsh(spread)[-1])))
