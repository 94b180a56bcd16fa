"""Simulated observers that judge spikes or answer at random.

The model follows the paper's explanation of its thresholds (Section III-C). Pulses fire RA
afferents. Pulses that reach deep enough also fire PC afferents. The rate of RA spikes tells the
frequency. In mechanical vibration, the share of PC spikes grows with frequency. A person therefore
perceives a pulse train with few PC spikes as slower than it is.

The soft minimum in `perceived_hz` is an assumption. `RA_LIMIT_HZ`, `BASE_WEBER` and `SHARPNESS` are
fitted to the paper's results in RA mode, so simulated results in RA mode are not predictions.
Simulated results in PC mode are predictions.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ExperimentError
from smarttouch.emulator.drivers import Pulses
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.spikes import DeliveredSlots, SpikeModel, fire_all
from smarttouch.physiology.vibration_thresholds import best_hz, sensitivity
from smarttouch.profile import Profile


@dataclass(frozen=True, eq=False)
class Interval:
    """Pulses of one interval of a trial, as reported by the board."""

    time_s: NDArray[np.float64]  # (N,) float64, s: start of each slot within the interval
    width_us: NDArray[np.float32]  # (N,) float32, µs: duration of each slot
    current_ua: NDArray[np.int16]  # (N, E) int16, µA: positive is cathodic


Array = NDArray[np.float64]

BASE_WEBER = 0.125
"""Weber fraction, at 75 % correct answers, of a participant who perceives the true pulse rate. Our
choice keeps Weber fractions in RA mode below 20 % up to 45 Hz, as in the paper (III-C)."""
RA_LIMIT_HZ = 65.0
"""Highest frequency perceived without PC spikes. Our choice: in the paper, the bands of RA and PC
overlap from 60 to 70 Hz, and 65 Hz is the middle."""
SHARPNESS = 3.2
"""Exponent of the soft minimum in `perceived_hz`. Our choice: the simulated Weber fraction at 75
Hz in RA mode is then 0.68. The paper measured 0.7."""

FITTED = (
    "the simulated participant judges frequency with a model fitted to the paper's results in RA "
    f"mode (limit {RA_LIMIT_HZ:g} Hz, Weber fraction {BASE_WEBER:.1%}, exponent {SHARPNESS:g}). If "
    "no PC afferent fires, the simulated thresholds only repeat this fit and are not a result"
)
"""Warning for frequency judgments of a simulated participant."""


SPREAD = math.log1p(BASE_WEBER) / float(math.sqrt(2) * ndtri(0.75))
"""Standard deviation of the logarithm of a perceived frequency."""


@cache
def _learned() -> tuple[Array, Array]:
    """Return frequencies of vibration, Hz, and the ratio of PC to RA spikes at each frequency."""
    # End at PC's best frequency, 250 Hz: `np.interp` needs rising ratios, which fall above 300 Hz.
    hz = np.geomspace(RA_LIMIT_HZ, best_hz(Afferent.PC), 200)
    return hz, sensitivity(Afferent.PC, hz) / sensitivity(Afferent.RA, hz)


def believable_hz(ratio: float) -> float:
    """Return the highest frequency, Hz, that a person perceives from the ratio of PC to RA spikes.

    In mechanical vibration at this frequency, the sensitivity of PC divided by the sensitivity of
    RA equals the ratio (paper, Fig. 2). Without PC spikes, return `RA_LIMIT_HZ`.
    """
    hz, ratios = _learned()
    return float(np.interp(ratio, ratios, hz))


def perceived_hz(hz: float, ratio: float) -> float:
    """Return the frequency, Hz, perceived for a train of pulses at ``hz``, without noise.

    The result is the soft minimum of ``hz`` and ``believable_hz(ratio)``; see `Response.ratio`.
    """
    limit_hz = believable_hz(ratio)
    return float((hz**-SHARPNESS + limit_hz**-SHARPNESS) ** (-1 / SHARPNESS))


_LONGEST_US = 60_000  # longest simulated pause between slots, µs; longer pauses count as 60 ms


@dataclass(frozen=True, eq=False)
class Response:
    """Spikes that the pulses of an interval evoke."""

    finger: Finger
    fired: NDArray[np.bool_]  # (A, N) bool: whether each afferent fired in each slot
    time_s: NDArray[np.float64]  # (N,), s: start of each slot

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
        """Spike rate, Hz, of the RA afferent with most spikes. If no RA afferent fires twice, PC
        afferents count instead. If no afferent of either class fires twice, the rate is 0."""
        for afferent in (Afferent.RA, Afferent.PC):
            class_counts = np.where(self.finger.classes == afferent, self.counts, 0)
            if class_counts.max(initial=0) > 1:
                fired_s = self.time_s[self.fired[class_counts.argmax()]]
                apart_s = np.diff(fired_s)
                return float(1 / np.median(apart_s))
        return 0.0

    @property
    def ratio(self) -> float:
        """Ratio of PC to RA spikes, with each count divided by the density of its class.

        Infinite if only PC fires.
        """
        anatomy = self.finger.anatomy
        ra, pc = (
            float(
                self.counts[self.finger.classes == afferent].sum()
                / anatomy.of(afferent).density_per_cm2
            )
            for afferent in (Afferent.RA, Afferent.PC)
        )
        if ra == 0:
            return math.inf if pc else 0.0
        return pc / ra

    @property
    def center_mm(self) -> NDArray[np.float64]:
        """Mean position of the receptors, weighted by spikes, (2,) mm; NaN without spikes."""
        total = self.counts.sum()
        places = self.finger.receptor_mm.astype(np.float64)
        return np.asarray(self.counts @ places / (total or math.nan))


class Nerve:
    """Afferents of one finger, with random threshold noise from pulse to pulse."""

    def __init__(self, finger: Finger, seed: int = 0) -> None:
        self.finger: Finger = finger
        self._model = SpikeModel(finger, seed)

    def of(self, interval: Interval) -> Response:
        """Return the spikes that the pulses of an interval evoke."""
        width_us = interval.width_us.astype(np.uint16)
        apart_us = np.diff(interval.time_s * 1e6, append=math.inf) - width_us
        pause_us = np.clip(apart_us, 0, _LONGEST_US).astype(np.uint16)
        lasts_us = int(width_us.sum(dtype=np.int64) + pause_us.sum(dtype=np.int64))
        slots = DeliveredSlots(interval.current_ua, width_us, pause_us, lasts_us)
        (spikes,) = fire_all(self._model, [slots])
        return Response(self.finger, spikes.fired, interval.time_s)


GRATING_LIMIT_MM = 0.94
"""Width of the narrowest grooves whose direction a fingertip identifies (Van Boven and Johnson,
Neurology 44, 1994). We assume that two points at this distance are distinguished in 75 % of trials.
"""


class Observer(Protocol):
    """Simulated participant that answers trials instead of a person."""

    def respond(
        self, task: str, intervals: Sequence[Interval], alternatives: Sequence[str]
    ) -> str | None:
        """Return one of the alternatives, or None for no answer.

        Alternatives are 1 and 2 (intervals) for the tasks ``faster`` and ``softer``, y and n for
        ``felt``, l and r (left and right) for ``side``.
        """
        ...


@dataclass
class BlindObserver:
    """Observer that answers at random."""

    seed: int = 0

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)

    def respond(
        self, task: str, intervals: Sequence[Interval], alternatives: Sequence[str]
    ) -> str | None:
        return alternatives[int(self._random.integers(len(alternatives)))]


@dataclass
class SimulatedObserver:
    """Observer that judges the spikes of one finger."""

    finger: Finger
    seed: int = 0
    # Mean number of afferents that fire in a slot of a train that is felt in half of the trials.
    # We chose 0.5, one afferent in every second slot: a person can feel the spikes of a single RA
    # afferent (Vallbo et al. 1984).
    felt_afferents: float = 0.5
    slope: float = 0.1  # standard deviation of the noise added to log(afferents per slot)
    guess: float = 0.02  # share of trials without spikes that are answered *felt*
    lapse: float = 0.02  # share of trials whose answer does not depend on the spikes
    # standard deviation of a perceived position, mm
    place_mm: float = GRATING_LIMIT_MM / (math.sqrt(2) * float(ndtri(0.75)))

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)
        self._nerve = Nerve(self.finger, self.seed)

    def respond(
        self, task: str, intervals: Sequence[Interval], alternatives: Sequence[str]
    ) -> str | None:
        if task == "felt":
            return "y" if self._is_felt(intervals[0]) else "n"
        judges = {"faster": self._faster, "side": self._side, "softer": self._softer}
        if task not in judges:
            raise ExperimentError(
                f"the simulated observer cannot judge the task {task!r}: use one of the tasks "
                f"felt, {', '.join(judges)}, or give --simulate random"
            )
        judged = judges[task](intervals)
        if judged is None or self._random.random() < self.lapse:
            return alternatives[int(self._random.integers(len(alternatives)))]
        return judged

    def _is_felt(self, interval: Interval) -> bool:
        afferents = self._nerve.of(interval).per_slot
        above = math.log(afferents / self.felt_afferents) if afferents > 0 else -math.inf
        chance = self.guess + (1 - self.guess - self.lapse) * float(ndtr(above / self.slope))
        return bool(self._random.random() < chance)

    def _faster(self, intervals: Sequence[Interval]) -> str | None:
        felt = [self._nerve.of(interval) for interval in intervals]
        if any(response.hz == 0 for response in felt):
            return None
        perceived = np.log([perceived_hz(response.hz, response.ratio) for response in felt])
        return self._larger(perceived, SPREAD)

    def _side(self, intervals: Sequence[Interval]) -> str | None:
        """Return whether the second point is perceived left (l) or right (r) of the first point."""
        at_mm = [self._nerve.of(interval).center_mm[0] for interval in intervals]
        if any(math.isnan(x_mm) for x_mm in at_mm):
            return None
        return "l" if self._larger(np.array(at_mm), self.place_mm) == "1" else "r"

    def _softer(self, intervals: Sequence[Interval]) -> str | None:
        """Return the interval in which the pulse rate changes least (paper, III-B.2)."""
        if any(len(interval.time_s) < 2 for interval in intervals):
            return None
        changes = [float(np.ptp(np.diff(interval.time_s))) for interval in intervals]
        return None if math.isclose(*changes, abs_tol=1e-3) else str(1 + int(np.argmin(changes)))

    def _larger(self, values: NDArray[np.float64], spread: float) -> str:
        return str(1 + int((values + spread * self._random.standard_normal(len(values))).argmax()))


def make_observer(
    kind: str,
    profile: Profile,  # profile of the simulated finger
    seed: int,  # seed of the noise
    finger: int = 1,  # seed of the simulated finger
    anatomy: str | Path = "paper",  # anatomy of the simulated finger
) -> Observer:
    """Return an observer: ``model`` judges simulated spikes, ``random`` answers at random."""
    if kind != "model":
        return BlindObserver(seed)
    return SimulatedObserver(Finger(profile, finger, anatomy), seed)


Starts = dict[int, tuple[int, int]]
"""Sequences of an interval. Key: number of the sequence. Value: start of the sequence, ns, and
duration of the discharge after each slot, µs."""


def interval_of(pulses: Pulses, starts: Starts) -> Interval:
    """Select the pulses of one interval from the result of `take_pulses`."""
    number, width_us, current_ua = pulses
    mine = np.isin(number, list(starts))
    number, width_us, current_ua = number[mine], width_us[mine], current_ua[mine]
    begin_ns = min((time_ns for time_ns, _ in starts.values()), default=0)
    at = np.array(
        [starts[sequence_number] for sequence_number in number.tolist()], np.int64
    ).reshape(-1, 2)
    taken_us = width_us.astype(np.float64) + at[:, 1]
    before_us = np.cumsum(taken_us) - taken_us
    first = np.flatnonzero(np.diff(number.astype(np.int64), prepend=-1))
    within_us = before_us - np.repeat(before_us[first], np.diff(np.append(first, len(number))))
    return Interval((at[:, 0] - begin_ns) / 1e9 + within_us / 1e6, width_us, current_ua)
