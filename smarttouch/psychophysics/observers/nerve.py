"""Spikes of a finger in one interval of a trial, and what there is to judge of them."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from smarttouch.afferent import Afferent
from smarttouch.delivered.population import FIELD_MM, DeliveredSlots
from smarttouch.physiology.feeling import fire_all
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.spikes import SpikeModel
from smarttouch.psychophysics.observers.interval import Interval

Floats = NDArray[np.float32]

_LONGEST_US = 60_000
"""Longest pause that counts in full: refractory times are shorter."""


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

    @property
    def width_mm(self) -> float:
        """Distance of two equal points that spread as the receptors that fire do, mm.

        Twice their largest standard deviation; NaN where none fires.
        """
        if not self.counts.any():
            return math.nan
        away_mm = self.finger.receptor_mm - self.center_mm
        spread = (self.counts[:, None] * away_mm).T @ away_mm / self.counts.sum()
        return 2 * math.sqrt(max(0.0, float(np.linalg.eigvalsh(spread)[-1])))


class Nerve:
    """Afferents of one finger that respond to the intervals of trials; the seed is of the noise
    from pulse to pulse."""

    def __init__(self, finger: Finger, seed: int = 0) -> None:
        self.finger, self._model = finger, SpikeModel(finger, seed)
        away = finger.receptor_mm[:, None] - finger.profile.electrodes.position_mm
        self._field = np.exp(-(away**2).sum(axis=2) / (2 * FIELD_MM**2)).astype(np.float32)

    def of(self, interval: Interval) -> Response:
        """Return the spikes of an interval."""
        width_us = interval.width_us.astype(np.uint16)
        apart_us = np.diff(interval.time_s * 1e6, append=math.inf) - width_us
        pause_us = np.clip(apart_us, 0, _LONGEST_US).astype(np.uint16)
        lasts_us = int(width_us.sum(dtype=np.int64) + pause_us.sum(dtype=np.int64))
        slots = DeliveredSlots(interval.current_ua, width_us, pause_us, lasts_us)
        (spikes,) = fire_all(self._model, [slots])
        return Response(self.finger, spikes.fired, interval.time_s)

    def at_electrodes(self, response: Response) -> Floats:
        """Return the spikes around each electrode, (E,), put where the receptors are."""
        return np.asarray(response.counts @ self._field, np.float32)
