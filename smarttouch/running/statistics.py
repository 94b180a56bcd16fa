"""Run statistics in constant memory."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from smarttouch.sources.stimulus import Input
from smarttouch.stimulation.sequence import SelectivityReport

_PER_E = 100
"""Bins for each factor of e: a figure is true to half a percent."""
_FACTORS = 17
"""From 1 µs to 24 s."""


class LatencyHistogram:
    """Histogram of durations in bins of one percent; the largest is kept as it is."""

    def __init__(self) -> None:
        self._bins = np.zeros(_PER_E * _FACTORS + 1, np.int64)
        self.count = 0
        self.largest_us = 0.0
        self.total_us = 0.0

    def add(self, value_us: float) -> None:
        """Count one duration, µs."""
        self.count += 1
        self.total_us += value_us
        self.largest_us = max(self.largest_us, value_us)
        index = 0 if value_us <= 1 else min(len(self._bins) - 1, int(_PER_E * math.log(value_us)))
        self._bins[index] += 1

    def quantile(self, share: float) -> float:
        """Return the duration that so many are not above, µs."""
        if not self.count:
            return 0.0
        index = int(np.searchsorted(np.cumsum(self._bins), share * self.count))
        return min(self.largest_us, math.exp((index + 0.5) / _PER_E))

    def figures(self) -> dict[str, float]:
        """Return p50, p99 and the maximum, µs."""
        return {"p50": self.quantile(0.5), "p99": self.quantile(0.99), "max": self.largest_us}


@dataclass
class RunStatistics:
    """Statistics of a run, kept as it goes.

    Examples
    --------
    See `smarttouch.run`; ``statistics.figures`` has all of them by name.
    """

    frames: int = 0
    """Sequences sent; each from one input."""
    seen: int = 0
    """Different frames or stimuli that were read."""
    felt: int = 0
    """Different frames or stimuli of which a sequence was sent."""
    real_time: bool = False
    """Whether the loop's thread had real-time priority."""
    slots: int = 0
    slowed: int = 0
    """Sequences longer than the period asked for."""
    lowest_rate_hz: float = float("inf")
    late: int = 0
    """Frames that came more than a period after their time."""
    restarts: int = 0
    """Number of times that the board was lost and started anew."""
    lifts: int = 0
    """Number of times that the board found the finger lifted."""
    blind: int = 0
    """Sequences without current because the force or the image was not known."""
    active: float = 0.0
    off_target: float = 0.0
    """Largest of all proofs: what points that share slots did to other classes."""
    spill: float = 0.0
    """And to their own class elsewhere."""
    seconds: float = 0.0
    scan_us: int = 0
    """Sum of the periods of all sequences sent."""
    asked_us: int = 0
    """Sum of the periods they would have had if their slots had fit."""
    latency: LatencyHistogram = field(default_factory=LatencyHistogram)
    """From the input in hand to the last byte written."""
    motion_to_bytes: LatencyHistogram = field(default_factory=LatencyHistogram)
    """From the taking of the image to the last byte written."""
    work: LatencyHistogram = field(default_factory=LatencyHistogram)
    """Processor time that a frame took the loop, without waiting."""
    period_error: LatencyHistogram = field(default_factory=LatencyHistogram)
    """Error of the time between two frames against their period."""
    ended: str = ""
    """Reason for which the run has ended."""
    notes: list[str] = field(default_factory=list)
    """Sentences that a user should know after the run."""
    figures: dict[str, Any] = field(default_factory=dict)
    """All figures of the run by name, complete after its end; for JSON."""
    _last_seen: int | None = None
    _last_felt: int | None = None

    def see(self, given: Input) -> None:
        """Count a frame or stimulus that was read."""
        self.seen += given.number != self._last_seen
        self._last_seen = given.number

    def feel(self, given: Input) -> None:
        """Count a frame or stimulus that was sent."""
        self.frames += 1
        self.felt += given.number != self._last_felt
        self._last_felt = given.number

    def weigh(self, proof: SelectivityReport | None) -> None:
        """Keep the worst of what points that share slots do."""
        if proof is not None and proof.shared is not None:
            other, spill = proof.shared
            self.off_target = max(self.off_target, other)
            self.spill = max(self.spill, spill)

    @property
    def work_share(self) -> float:
        """The loop's own work, of the time that the board scans."""
        return self.work.total_us / self.scan_us if self.scan_us else 0.0
