"""Spikes of a finger's afferents: which fires when, under the slots of a scan sequence."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from smarttouch.physiology.drive_memory import DriveMemory
from smarttouch.physiology.finger import Finger, strength

Floats = NDArray[np.float32]

_EXACT_FROM = 0.9
_FARTHEST = 6.0
"""Standard deviations of its noise below threshold from which an afferent is not tried."""


class Slots(Protocol):
    """Currents in time: a scan sequence, or anything that has the same fields."""

    @property
    def current_ua(self) -> NDArray[np.int16]: ...
    @property
    def width_us(self) -> NDArray[np.uint16]: ...
    @property
    def discharge_us(self) -> NDArray[np.uint16]: ...
    @property
    def period_us(self) -> int: ...


@dataclass(frozen=True, eq=False)
class Spikes:
    """Spikes of one sequence."""

    fired: NDArray[np.bool_]  # (A, S) whether each afferent fired in each slot
    time_us: NDArray[np.int64]  # (S,) start of each slot, from the first sequence on

    @property
    def counts(self) -> NDArray[np.intp]:
        """Number of spikes of each afferent, (A,)."""
        return np.asarray(self.fired.sum(axis=1))


class SpikeModel:
    """Afferents of a finger that fire, with their thresholds, noise and refractoriness.

    An afferent fires in a slot where the drive of any of its nodes reaches its threshold, unless it
    fired a refractory time ago or less. A pulse counts by its width, by Weiss's law. The seed is
    that of the noise from pulse to pulse.
    """

    def __init__(self, finger: Finger, seed: int = 1) -> None:
        self.finger = finger
        anatomy = [one.anatomy for one in finger.populations.values()]
        classes = finger.classes
        self._chronaxie_us = np.array([each.chronaxie_us for each in anatomy], np.float32)
        self._noise = np.array([each.noise for each in anatomy], np.float32)[classes]
        self._refractory_us = np.array([each.refractory_us for each in anatomy])[classes]
        self._seed = seed
        self._reference = strength(finger.profile.pulse.width_us, self._chronaxie_us)
        longest = strength(finger.profile.limits.pulse_us, self._chronaxie_us) / self._reference
        self._drives = DriveMemory(*finger.rows, _EXACT_FROM / max(1.0, longest.max()))
        self.begin_anew()

    def begin_anew(self) -> None:
        """Forget all spikes, and begin with the same noise; known currents stay known."""
        self._random = np.random.default_rng(self._seed)
        self._last_us = np.full(len(self.finger.classes), -np.inf)
        self._now_us = 0

    def drive(self, current_ua: NDArray[Any], width_us: NDArray[Any]) -> Floats:
        """Return each afferent's largest drive by currents (S, E) µA, (A, S) float32.

        1 is its threshold; currents are positive cathodic, pulse widths (S,). Drives from 0.9 on
        are exact. A smaller one is at most 0.01 off where the slot's currents are those of an
        earlier slot, scaled.
        """
        highest = self._drives.drive(np.asarray(current_ua, np.float32) / np.float32(1000))
        width = np.asarray(width_us, np.float32)[:, None]
        by_class = (strength(width, self._chronaxie_us) / self._reference).astype(np.float32)
        highest *= by_class.T[self.finger.classes]
        return np.asarray(highest)

    def fire(self, slots: Slots, above: Floats | None = None) -> Spikes:
        """Return the spikes of one sequence, by its `drive` if given; the next one follows it."""
        lasts = slots.width_us.astype(np.int64) + slots.discharge_us
        time_us = self._now_us + np.cumsum(lasts) - lasts
        if above is None:
            above = self.drive(slots.current_ua, slots.width_us)
        # The others stay silent: so large a noise comes once in a thousand million pulses.
        near = np.flatnonzero((above >= 1 - _FARTHEST * self._noise[:, None]).any(axis=1))
        spread = self._noise[near, None] * self._random.standard_normal(
            (len(near), above.shape[1]), np.float32
        )
        chosen = above[near] >= 1 + spread
        last_us, rest_us = self._last_us[near], self._refractory_us[near]
        for slot, begin_us in enumerate(time_us):
            chosen[:, slot] &= begin_us - last_us >= rest_us
            last_us[chosen[:, slot]] = begin_us
        self._last_us[near] = last_us
        fired = np.zeros(above.shape, np.bool_)
        fired[near] = chosen
        self._now_us += slots.period_us
        return Spikes(fired, time_us)
