"""Run statistics in constant memory."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from smarttouch.running.step import StepResult

_PER_E = 100
"""Bins for each factor of e: a figure is true to half a percent."""
_FACTORS = 17
"""From 1 µs to 24 s."""


class LatencyHistogram:
    """Histogram of durations in bins of one percent; the largest is kept as it is."""

    def __init__(self) -> None:
        self.bins = np.zeros(_PER_E * _FACTORS + 1, np.int64)
        self.count = 0
        self.largest_us = 0.0
        self.total_us = 0.0

    def quantile(self, share: float) -> float:
        """Return the duration that so many are not above, µs."""
        if not self.count:
            return 0.0
        index = int(np.searchsorted(np.cumsum(self.bins), share * self.count))
        return min(self.largest_us, math.exp((index + 0.5) / _PER_E))

    def figures(self) -> dict[str, float]:
        """Return p50, p99 and the maximum, µs."""
        return {"p50": self.quantile(0.5), "p99": self.quantile(0.99), "max": self.largest_us}


def add_durations(durations: Iterable[tuple[LatencyHistogram, float]]) -> None:
    """Count a duration in each of some histograms, µs."""
    for histogram, value_us in durations:
        histogram.count += 1
        histogram.total_us += value_us
        histogram.largest_us = max(histogram.largest_us, value_us)
        index = 0 if value_us <= 1 else min(_PER_E * _FACTORS, int(_PER_E * math.log(value_us)))
        histogram.bins[index] += 1


@dataclass
class RunStatistics:
    """Statistics of a run, kept as it goes.

    Examples
    --------
    See `smarttouch.run`; ``statistics.figures`` has all of them by name.
    """

    def __repr__(self) -> str:
        return (
            f"RunStatistics(frames={self.frames}, slots={self.slots}, seconds={self.seconds:g}, "
            f"late={self.late}, restarts={self.restarts}, ended={self.ended!r})"
        )

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
    """Number of times that the board was lost and restarted."""
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
    _last_sent: int | None = None

    def enter(self, result: StepResult, error_us: float | None) -> None:
        """Enter a step whose sequence was sent."""
        step, sequence = result.step, result.step.sequence
        self.frames += 1
        self.felt += step.input.number != self._last_sent
        self._last_sent = step.input.number
        self.slots += len(sequence.width_us)
        if sequence.proof is not None and (shared := sequence.proof.shared) is not None:
            self.off_target = max(self.off_target, shared[0])
            self.spill = max(self.spill, shared[1])
        self.slowed += sequence.period_us > step.asked_us
        self.asked_us += step.asked_us
        self.scan_us += sequence.period_us
        self.lowest_rate_hz = min(self.lowest_rate_hz, 1e6 / sequence.period_us)
        activation = step.tactile.activation
        self.active += int(np.count_nonzero(activation.any(axis=0))) / activation.shape[1]
        took = [
            (self.latency, result.latency_us),
            (self.motion_to_bytes, result.latency_us + step.input.age_ns / 1000),
            (self.work, result.work_us),
        ]
        if error_us is not None:
            took.append((self.period_error, error_us))
        add_durations(took)

    @property
    def work_share(self) -> float:
        """The loop's own work, of the time that the board scans."""
        return self.work.total_us / self.scan_us if self.scan_us else 0.0
