"""Statistics of a run in constant memory, and phase lock of the loop to the board."""

import math
from collections import deque
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Mode
from smarttouch.boards.board import Board, BoardReport
from smarttouch.kernels.bank import KernelBank
from smarttouch.running.step_records import FirstPulse, StepResult
from smarttouch.sources.source_contract import Source

_PER_E = 100  # number of bins from a duration to this duration times e (2.718)
_FACTORS = 17  # the bins reach from 1 µs to e**17 µs, which is 24 s


class LatencyHistogram:
    """Histogram of durations in bins that are 1 % wide, with the exact maximum."""

    def __init__(self) -> None:
        self.bins: NDArray[np.int64] = np.zeros(_PER_E * _FACTORS + 1, np.int64)
        self.count: int = 0
        self.largest_us: float = 0.0
        self.total_us: float = 0.0

    def add(self, value_us: float) -> None:
        """Count a duration, µs."""
        self.count += 1
        self.total_us += value_us
        self.largest_us = max(self.largest_us, value_us)
        index = 0 if value_us <= 1 else min(_PER_E * _FACTORS, int(_PER_E * math.log(value_us)))
        self.bins[index] += 1

    def quantile(self, share: float) -> float:
        """Return a quantile of the durations, µs."""
        if not self.count:
            return 0.0
        index = int(np.searchsorted(np.cumsum(self.bins), share * self.count))
        return min(self.largest_us, math.exp((index + 0.5) / _PER_E))

    def figures(self) -> dict[str, float]:
        """Return p50, p99 and the maximum, µs."""
        return {"p50": self.quantile(0.5), "p99": self.quantile(0.99), "max": self.largest_us}


@dataclass
class RunStatistics:
    """Statistics of a run, updated at each step.

    Examples
    --------
    See `smarttouch.run`; ``statistics.figures`` has all statistics by name.
    """

    def __repr__(self) -> str:
        return (
            f"RunStatistics(frames={self.frames}, slots={self.slots}, seconds={self.seconds:g}, "
            f"late={self.late}, restarts={self.restarts}, ended={self.ended!r})"
        )

    frames: int = 0
    """Number of sequences sent."""
    seen: int = 0
    """Number of distinct frames or stimuli read."""
    delivered: int = 0
    """Number of distinct frames or stimuli sent."""
    real_time: bool = False
    """Whether the loop's thread had real-time priority."""
    slots: int = 0
    slowed: int = 0
    """Number of sequences longer than the requested period."""
    lowest_rate_hz: float = float("inf")
    late: int = 0
    """Number of sequences that began more than one period after their deadline."""
    restarts: int = 0
    """Number of times that the board was lost and restarted."""
    lifts: int = 0
    """Number of times that the board detected a lifted finger."""
    blind: int = 0
    """Number of sequences without current because force or image were unknown."""
    active: float = 0.0
    off_target: float = 0.0
    """Largest off-target activation in slots with several points."""
    spill: float = 0.0
    """Largest spill in slots with several points: activation of the targets' class, farther than
    a pitch from every target, relative to that of the weakest target."""
    kernels: KernelBank | None = None
    """Kernel bank of the run."""
    modes: set[Mode] = field(default_factory=set)
    """Modes in which slots were sent."""
    seconds: float = 0.0
    scan_us: int = 0
    """Total duration of sent sequences."""
    asked_us: int = 0
    """Total requested duration of sent sequences."""
    latency: LatencyHistogram = field(default_factory=LatencyHistogram)
    """Time from reading an input to writing the last byte of its sequence."""
    motion_to_bytes: LatencyHistogram = field(default_factory=LatencyHistogram)
    """Time from the capture of an image to writing the last byte of its sequence."""
    first_pulse: LatencyHistogram = field(default_factory=LatencyHistogram)
    """Time from the capture of an image to its first pulse, if the board reports this pulse."""
    waited: LatencyHistogram = field(default_factory=LatencyHistogram)
    """Time from writing the last byte of a sequence to its first pulse."""
    work: LatencyHistogram = field(default_factory=LatencyHistogram)
    """Processor time of the loop for one step."""
    period_error: LatencyHistogram = field(default_factory=LatencyHistogram)
    """Absolute difference between the actual and the expected start of a step."""
    ended: str = ""
    """Reason for the end of the run."""
    notes: list[str] = field(default_factory=list)
    """Sentences for the user after the run."""
    figures: dict[str, Any] = field(default_factory=dict)
    """All statistics by name, for JSON; empty until the end of the run."""
    _last_sent: int | None = None

    def enter(self, result: StepResult, error_us: float | None) -> None:
        """Add a step whose sequence was sent."""
        step, sequence = result.step, result.step.sequence
        self.frames += 1
        self.delivered += step.input.number != self._last_sent
        self._last_sent = step.input.number
        if slots := len(sequence.width_us):
            self.slots += slots
            self.modes.add(step.mode)
        proof = sequence.proof
        if proof is not None and (several := proof.points > 1).any():
            self.off_target = max(self.off_target, float(proof.off_target[several].max()))
            self.spill = max(self.spill, float(proof.spill[several].max()))
        self.slowed += sequence.period_us > step.asked_us
        self.asked_us += step.asked_us
        self.scan_us += sequence.period_us
        self.lowest_rate_hz = min(self.lowest_rate_hz, 1e6 / sequence.period_us)
        activation = step.tactile.activation
        self.active += int(np.count_nonzero(activation.any(axis=0))) / activation.shape[1]
        self.latency.add(result.latency_us)
        self.motion_to_bytes.add(result.latency_us + step.input.age_ns / 1000)
        self.work.add(result.work_us)
        if error_us is not None:
            self.period_error.add(error_us)

    @property
    def work_share(self) -> float:
        """Processor time of the loop, relative to the duration of scans."""
        return self.work.total_us / self.scan_us if self.scan_us else 0.0

    @property
    def selectivity(self) -> tuple[float, float] | None:
        """Largest off-target activation, and largest spill. Both include the kernels of all used
        modes, and all slots with several points. None if unknown."""
        bank, other, spill = self.kernels, self.off_target, self.spill
        if bank is None or bank.discs:
            return (other, spill) if other or spill else None
        classes = {kind for mode in self.modes for kind in mode.afferents} & bank.weights.keys()
        for afferent in classes:
            other = max(other, float(bank.off_target[afferent].max()))
            spill = max(spill, float(bank.spill[afferent].max()))
        return (other, spill) if classes else None

    def complete(
        self, source: Source, board: Board, report: BoardReport | None, ended: str
    ) -> None:
        """Set all figures of a run; those from the board's report are None without a report."""
        other, spill = self.selectivity or (None, None)
        first_pulse, waited = (
            spread.figures() if spread.count else None for spread in (self.first_pulse, self.waited)
        )
        self.ended = ended
        self.figures = {
            "ended": ended,
            "seconds": self.seconds,
            "frames": self.frames,
            "frames_in": source.frames,
            "frames_delivered": self.delivered,
            "dropped_frames": source.dropped_frames + self.seen - self.delivered,
            "sequences": self.frames,
            "slots": self.slots,
            "worst_other": other,
            "worst_spill": spill,
            "pulses": report and report.pulses,
            "pulses_at_most": report and (report.most_pulses or report.pulses),
            "acknowledged": board.acknowledged,
            "refused": board.refused,
            "late_frames": self.late,
            "without_force_or_image": self.blind,
            "replaced": board.replaced,
            "packets_refused_by_host": report and report.refused_by_host,
            "packets_refused_by_board": report and report.refused_packets,
            "dropped_late": board.dropped_late,
            "restarts": self.restarts,
            "lifts": self.lifts,
            "reported_by": report and report.by,
            "rate_asked_hz": 1e6 * self.frames / self.asked_us if self.asked_us else None,
            "rate_hz": self.frames / self.seconds if self.seconds else 0.0,
            "lowest_rate_hz": self.lowest_rate_hz if self.frames else None,
            "slowed_sequences": self.slowed,
            "latency_us": self.latency.figures(),
            "motion_to_bytes_us": self.motion_to_bytes.figures(),
            "motion_to_pulse_us": first_pulse,
            "bytes_to_pulse_us": waited,
            "real_time": self.real_time,
            "period_error_us": self.period_error.figures(),
            "work_us": self.work.figures(),
            "work_share": self.work_share,
            "max_current_ma": report and report.max_current_ma,
            "max_charge_uc": report and report.max_charge_uc,
            "max_net_charge_uc": report and report.max_net_charge_uc,
            "dose_s": board.dose.seconds,
            "dose_mc": board.dose.most_mc,
            "dose_net_uc": board.dose.most_net_uc,
            "emulator_violations": report.violations if report and report.by == "board" else None,
            "active_fraction": self.active / self.frames if self.frames else 0.0,
        }


GUARD_NS = 500_000  # spare time between the typical arrival of a sequence and its start
_IDLE_NS = 1_000_000
"""If a board pauses longer than this between two sequences, the second sequence was late."""
_ONE_LATE_IN = 20  # 1 of 20 recent sequences may be delayed longer than usual
_REMEMBERED = 250  # number of sequences for which transfer times are remembered


@dataclass(frozen=True)
class Sent:
    """Sequence that was sent, with times by the loop's clock."""

    number: int
    taken_ns: int  # capture time of the image
    deadline_ns: int
    elapsed_ns: int  # time of the run at the deadline
    waited_ns: int  # time that the send waited for space on the board; 0 unless 1 to 100 ms
    sent_ns: int
    period_ns: int
    ahead_ns: int  # time by which the board's clock is ahead of the loop's


class PhaseLock:
    """Phase lock, which moves a loop's deadlines later, so that images are as fresh as possible.

    The board reports when it starts each sequence. The deadline should precede this start by the
    sum of transfer time, usual delay of sending, and `GUARD_NS`. If a deadline is too early, all
    following deadlines are postponed. A deadline that is too late needs no correction, because the
    board then delays this sequence and all that follow.
    """

    def __init__(self, board: Board, statistics: RunStatistics) -> None:
        self._board, self._statistics = board, statistics
        self._pending: deque[Sent] = deque(maxlen=8)
        self._delays_ns: deque[int] = deque(maxlen=64)
        self._transfers: deque[tuple[int, int]] = deque(maxlen=8)
        """Sequence number and transfer time, ns, of recent sequences that reached an idle board."""
        self._free_ns: int | None = None
        """Expected end, by the loop's clock, of the newest sequence with a known start."""
        self.newest: FirstPulse | None = None
        """Newest `FirstPulse` that the board reported since the last step, or None."""

    def follow(self, zero_ns: int, sent: Sent | None = None) -> int:
        """Store the sent sequence. Return the delay, ns, to add to all later deadlines. ``zero_ns``
        is the start of the run by the loop's clock, plus all earlier delays."""
        if sent is not None:
            self._delays_ns.append(sent.sent_ns - sent.waited_ns - sent.deadline_ns)
            self._pending.append(sent)
        self.newest, more_ns = None, 0
        for earlier in list(self._pending):
            start = self._board.start_of(earlier.number)
            if start is None:
                continue
            self._pending.remove(earlier)
            begun_ns = start[0] - earlier.ahead_ns
            waited_ns, number = begun_ns - earlier.sent_ns, earlier.number
            taken_ns = begun_ns - earlier.taken_ns
            self.newest = FirstPulse(number, taken_ns / 1000, waited_ns / 1000)
            self._statistics.first_pulse.add(taken_ns / 1000)
            self._statistics.waited.add(waited_ns / 1000)
            while self._transfers and self._transfers[0][0] < number - _REMEMBERED:
                self._transfers.popleft()
            # Use the median of at least two transfer times: a single one may include a delay.
            transfers, transfer_ns = sorted(self._transfers, key=itemgetter(1)), 0
            if len(transfers) > 1:
                transfer_ns = transfers[(len(transfers) - 1) // 2][1]
            if self._free_ns is not None and begun_ns > self._free_ns + _IDLE_NS:
                self._transfers.append((number, waited_ns))
                transfer_ns = max(transfer_ns, waited_ns)
            self._free_ns = begun_ns + earlier.period_ns
            # 95th percentile of the recent delays of sending.
            delay_ns = sorted(self._delays_ns)[-1 - len(self._delays_ns) // _ONE_LATE_IN]
            lead_ns = begun_ns - zero_ns - earlier.elapsed_ns
            more_ns = max(0, lead_ns - transfer_ns - delay_ns - GUARD_NS)
        return more_ns

    def forget(self) -> None:
        """After the board was lost, forget the sequences whose start it has not reported."""
        self._pending.clear()
        self._free_ns = None
