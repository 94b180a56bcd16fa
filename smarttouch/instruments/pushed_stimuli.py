"""Activations that other programs send: the newest wins, and wakes the loop."""

import math
import threading
import time

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.imaging.array_window import reading_force_n
from smarttouch.profile import Profile
from smarttouch.sources.source_contract import Stimulus, StimulusSource

SILENT_S = 0.5
"""Silence after which an activation is stale."""
_IDLE_NS = 45_000_000
"""Longest time without a sequence while nothing is active."""


class PushedStimuli(StimulusSource):
    """Source of activations that arrive by themselves; half a second of silence is an empty one.

    One that follows none or an empty one is read at once, the others with the next sequence, and
    pulses keep the profile's rates. With ``follow``, and where all three classes are driven, which
    have no rates of their own, each is read at once, in as far as the profile's limit allows, and
    is one pulse of every active class; the last is repeated at the profile's rate until it is
    stale.
    """

    knows_force = True

    def __init__(self, title: str, profile: Profile, follow: bool = False) -> None:
        super().__init__(title)
        self.news: threading.Event = threading.Event()
        self._press_n = reading_force_n(profile)
        self._newest = np.zeros((len(Afferent), len(profile.electrodes)), np.float32), -math.inf, 0
        """Activation, when it came (`time.monotonic`), and its number from 1."""
        self._read_number = 0
        self._follow, self._least_us = follow, math.ceil(1e6 / profile.limits.rate_hz)
        self._repeat_ns = round(1e9 / profile.pulse.rate_hz)
        self._read_ns = 0

    @property
    def _follows(self) -> bool:
        return self._follow or len(self.afferents) == len(Afferent)

    @property
    def given(self) -> int:
        """Number of activations that came so far."""
        return self._newest[2]

    def push(self, activation: NDArray[np.float32]) -> None:
        """Take an activation, (3, E) in [0, 1], that is not written to again."""
        self._newest = activation, time.monotonic(), self.given + 1
        self.news.set()

    def patience_ns(self, time_ns: int) -> int:
        """Return how long the next read may wait for another activation, ns."""
        self.news.clear()
        activation, came_s, number = self._newest
        if number != self._read_number:
            return 0
        if time.monotonic() - came_s > SILENT_S or not activation.any():
            return _IDLE_NS
        if not self._follows:
            return 0
        return max(0, self._read_ns + self._repeat_ns - time_ns)

    def read(self, time_ns: int) -> Stimulus | None:
        """Return what came last; stale after a silence."""
        activation, came_s, number = self._newest
        since_s = time.monotonic() - came_s
        if number != self._read_number:
            self.frames += 1
            self.dropped_frames += max(0, number - self._read_number - 1)
            self._read_number = number
        stale = since_s > SILENT_S
        self._read_ns = time_ns
        driven, rows = np.zeros_like(activation), list(self.afferents)
        if not stale:
            driven[rows] = activation[rows]
        return Stimulus(
            driven,
            time_ns,
            self._press_n,
            self._least_us if self._follows else None,
            number=number,
            age_ns=0 if stale else int(1e9 * max(0.0, since_s)),
            stale=stale,
        )
