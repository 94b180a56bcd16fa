"""A mixture as a source of stimuli, and what went out of it."""

import math
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from smarttouch.afferent import Afferent
from smarttouch.profile import Profile
from smarttouch.running.listener import Listener
from smarttouch.running.step import StepResult
from smarttouch.sources.source import StimulusSource
from smarttouch.sources.stimulus import Stimulus
from smarttouch.vibrotactile.mix import Mixture
from smarttouch.vibrotactile.train import Times

LONGEST_US = 20_000
"""Longest time between stimuli without a pulse, so that a lifted finger is noticed."""


class ColorSource(StimulusSource, Listener):
    """Source of the pulses of a mixture in the course of time.

    Pulses wait if sequences take longer than foreseen, and those of several stimuli go together.
    """

    ended = "the end of the trace"

    def __init__(
        self, title: str, profile: Profile, mixture: Mixture, force_n: float = math.nan
    ) -> None:
        super().__init__(title)
        self.knows_force = not math.isnan(force_n)
        self.duration_s = mixture.end_us / 1e6
        self._mixture, self._force_n = mixture, force_n
        self._next = 0
        self._given_us = np.full(len(mixture.time_us), -1, np.int64)
        self._count = Counter[Afferent]()

    def read(self, time_ns: int) -> Stimulus | None:
        """Return the stimulus that is due; None after the last one."""
        now_us = time_ns // 1000
        if now_us >= self._mixture.end_us:
            return None
        self.frames += 1
        mixture, first = self._mixture, self._next
        due_us = now_us + mixture.least_us // 2
        self._next += int(np.searchsorted(mixture.time_us[first:], due_us, side="right"))
        self._given_us[first : self._next] = now_us
        drive = mixture.drive[first : self._next].max(axis=0, initial=0.0)
        if mixture.vibrated and first == self._next > 0:
            # Vibrators go on with their last amplitudes.
            drive[Afferent.PC] = mixture.drive[first - 1, Afferent.PC]
        more = self._next < len(mixture.time_us)
        wait_us = int(mixture.time_us[self._next] if more else mixture.end_us) - now_us
        parts = max(1, min(-(-wait_us // LONGEST_US), wait_us // mixture.least_us))
        period_us = max(mixture.least_us, wait_us // parts)
        activation, number = mixture.at_sites(drive), self.frames - 1
        return Stimulus(activation, time_ns, self._force_n, period_us, number=number)

    def step(self, result: StepResult) -> None:
        """Count the pulses sent in a step."""
        if result.number is not None and result.step.sequence.intensity > 0:
            active = np.flatnonzero(result.step.tactile.activation.any(axis=1))
            self._count.update(Afferent(each) for each in active.tolist())

    def sent(self, afferent: Afferent) -> int:
        """Return the number of pulses of a class sent to each site so far."""
        return self._count[afferent]

    def error_us(self, afferent: Afferent) -> Times:
        """Return the delay of each requested pulse of a class, (K,) µs."""
        mixture = self._mixture
        given_us: NDArray[np.int64] = self._given_us[mixture.carried[afferent]]
        return (given_us - mixture.ideal_us[afferent])[given_us >= 0]
