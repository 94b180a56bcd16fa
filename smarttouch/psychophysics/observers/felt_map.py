"""Where on the array an interval was felt, and what a subject can say of it."""

import math

import numpy as np
from numpy.typing import NDArray

from smarttouch.kernels.bank import KernelBank
from smarttouch.perception import Perception
from smarttouch.profile import Profile
from smarttouch.psychophysics.observers.interval import Interval


class FeltMap:
    """The answers of all classes that the board reaches, site by site.

    Parameters
    ----------
    profile : Profile
    bank : KernelBank
        The profile's.
    """

    def __init__(self, profile: Profile, bank: KernelBank) -> None:
        self._perception = Perception(profile, bank, tuple(sorted(bank.weights)))
        self._position_mm = profile.electrodes.position_mm

    def of(self, interval: Interval) -> NDArray[np.float32]:
        """Return how strongly each site was felt at most, (E,) in [0, 1]."""
        slots, _ = interval.distinct()
        answers = self._perception.answers(
            np.zeros(len(slots), np.uint32), interval.width_us[slots], interval.current_ua[slots]
        )
        return answers.get(0, np.zeros(len(self._position_mm), np.float32))

    def center_mm(self, felt: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the middle of a map, (2,) mm; NaN where nothing is felt."""
        if not felt.any():
            return np.full(2, np.nan)
        return np.asarray(felt @ self._position_mm / felt.sum())

    def width_mm(self, felt: NDArray[np.float32]) -> float:
        """Return how far apart two equal points would lie that spread as a map does, mm.

        Twice its largest standard deviation; NaN where nothing is felt.
        """
        away_mm = self._position_mm - self.center_mm(felt)
        if np.isnan(away_mm).any():
            return math.nan
        spread = (felt[:, None] * away_mm).T @ away_mm / felt.sum()
        return 2 * math.sqrt(max(0.0, float(np.linalg.eigvalsh(spread)[-1])))
