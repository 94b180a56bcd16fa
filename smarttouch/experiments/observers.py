"""Simulated observers: by spikes, and at random.

The paper's own explanation of its thresholds (Section III-C) as a model. Pulses fire RA
and, if they reach deep enough, PC. RA's pulses carry the frequency; but a person who has learned
from mechanical vibration what a frequency feels like expects ever more PC with it. A train
with too little PC for its frequency is taken for a slower one.

What follows: where no PC fires nothing above `ALONE_HZ` is believed; where some do, as in PC
mode, something above. What is assumed: the form of the soft minimum, and three numbers that fit
the paper's RA mode, `ALONE_HZ`, `BASE_WEBER` and `SHARPNESS`. That RA mode gives out near 65 Hz is
put in by the first, and explains nothing.
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
from smarttouch.emulator.emulated_boards import Pulses
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.spikes import DeliveredSlots, SpikeModel, fire_all
from smarttouch.physiology.vibration_thresholds import best_hz, sensitivity
from smarttouch.profile import Profile


@dataclass(frozen=True, eq=False)
class Interval:
    """Pulses delivered in one interval of a trial, as the board reports them."""

    time_s: NDArray[np.float64]  # (N,) float64, s: of each slot, since the interval began
    width_us: NDArray[np.float32]  # (N,) float32, µs: duration of each slot
    current_ua: NDArray[np.int16]  # (N, E) int16, µA: current of each electrode, positive cathodic


Array = NDArray[np.float64]

BASE_WEBER = 0.125
"""75 % discrimination threshold where nothing contradicts the pulses' own frequency. Ours: with
it thresholds stay below the 20 % of the paper up to 45 Hz (Section III-C)."""
ALONE_HZ = 65.0
"""Highest frequency believed without any PC. Ours: between 60 and 70 Hz, where the paper lets PC
come in and RA end. On the fingertip both are alike at 40 Hz."""
SHARPNESS = 3.2
"""Steepness of the limit of perceived frequency. Ours: with it the threshold at 75 Hz in RA mode
is 0.68, where the paper has 0.7."""

FITTED = (
    "the simulated participant's sense of frequency was fitted to the paper's RA mode "
    f"({ALONE_HZ:g} Hz, {BASE_WEBER:.1%}, steepness {SHARPNESS:g}): where no PC fires, its "
    "thresholds are no result"
)
"""What to know of a modeled participant's answers to frequencies."""


SPREAD = math.log1p(BASE_WEBER) / float(math.sqrt(2) * ndtri(0.75))
"""Standard deviation of the logarithm of one perceived frequency."""


@cache
def _learned() -> tuple[Array, Array]:
    """Return frequencies of vibration, and the ratio of PC to RA at each."""
    # Up to the best frequency of PC: beyond it the ratio falls again.
    hz = np.geomspace(ALONE_HZ, best_hz(Afferent.PC), 200)
    return hz, sensitivity(Afferent.PC, hz) / sensitivity(Afferent.RA, hz)


def believable_hz(ratio: float) -> float:
    """Return the highest frequency perceived at a ratio of PC to RA, Hz.

    It is the frequency of a mechanical vibration to which PC and RA, each of what it answers at its
    best, answer in that ratio (paper, Fig. 2). No PC at all means that the vibration lies where
    only RA answers: below `ALONE_HZ`.
    """
    hz, ratios = _learned()
    return float(np.interp(ratio, ratios, hz))


def perceived_hz(hz: float, ratio: float) -> float:
    """Return the perceived frequency of a train at a ratio of PC to RA, without noise, Hz.

    It is the soft minimum of the pulses' frequency and of the highest that is believed.
    """
    limit_hz = believable_hz(ratio)
    return float((hz**-SHARPNESS + limit_hz**-SHARPNESS) ** (-1 / SHARPNESS))


_LONGEST_US = 60_000  # longest pause that counts in full: refractory times are shorter


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
            class_counts = np.where(self.finger.classes == afferent, self.counts, 0)
            if class_counts.max(initial=0) > 1:
                fired_s = self.time_s[self.fired[class_counts.argmax()]]
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
        """Middle of the receptors that fire, (2,) mm; NaN where none does."""
        total = self.counts.sum()
        places = self.finger.receptor_mm.astype(np.float64)
        return np.asarray(self.counts @ places / (total or math.nan))


class Nerve:
    """Afferents of one finger that respond to the intervals of trials; the seed is of the noise
    from pulse to pulse."""

    def __init__(self, finger: Finger, seed: int = 0) -> None:
        self.finger: Finger = finger
        self._model = SpikeModel(finger, seed)

    def of(self, interval: Interval) -> Response:
        """Return the spikes of an interval."""
        width_us = interval.width_us.astype(np.uint16)
        apart_us = np.diff(interval.time_s * 1e6, append=math.inf) - width_us
        pause_us = np.clip(apart_us, 0, _LONGEST_US).astype(np.uint16)
        lasts_us = int(width_us.sum(dtype=np.int64) + pause_us.sum(dtype=np.int64))
        slots = DeliveredSlots(interval.current_ua, width_us, pause_us, lasts_us)
        (spikes,) = fire_all(self._model, [slots])
        return Response(self.finger, spikes.fired, interval.time_s)


GRATING_LIMIT_MM = 0.94
"""Finest grooves whose direction a fingertip identifies (Van Boven and Johnson, Neurology 44,
1994). Ours: places are discriminated as well as grooves, in 75 % of trials."""


class Observer(Protocol):
    """Observer that answers trials."""

    def respond(
        self, task: str, intervals: Sequence[Interval], alternatives: Sequence[str]
    ) -> str | None:
        """Return one of the alternatives, or None for no answer.

        Tasks are ``faster`` and ``softer`` (which interval: 1 or 2), ``felt`` (y or n) and
        ``side`` (of the second point: l or r).
        """
        ...


@dataclass
class BlindObserver:
    """Observer that answers at random, whatever is delivered."""

    seed: int = 0

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)

    def respond(
        self, task: str, intervals: Sequence[Interval], alternatives: Sequence[str]
    ) -> str | None:
        """Return any of the alternatives."""
        return alternatives[int(self._random.integers(len(alternatives)))]


@dataclass
class SimulatedObserver:
    """Observer that judges the spikes of one finger, with noise and a criterion."""

    finger: Finger
    seed: int = 0
    # afferents that fire in a slot, on average, where in half of the trials it is felt. Ours: one
    # that answers every second slot (spikes of a single RA afferent can be felt, Vallbo et al.
    # 1984).
    felt_afferents: float = 0.5
    slope: float = 0.1  # its standard deviation, in natural logarithms of afferents
    # guess, lapse: rate of false detections, and rate at which the answer is not what was felt: of
    # two or more alternatives any one
    guess: float = 0.02
    lapse: float = 0.02
    # standard deviation of a felt place
    place_mm: float = GRATING_LIMIT_MM / (math.sqrt(2) * float(ndtri(0.75)))

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)
        self._nerve = Nerve(self.finger, self.seed)

    def respond(
        self, task: str, intervals: Sequence[Interval], alternatives: Sequence[str]
    ) -> str | None:
        """Return the answer to a trial."""
        if task == "felt":
            return "y" if self._is_felt(intervals[0]) else "n"
        judges = {"faster": self._faster, "side": self._side, "softer": self._softer}
        if task not in judges:
            raise ExperimentError(
                f"the simulated observer has no answer to {task!r}: it can answer felt, "
                f"{', '.join(judges)}"
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
        """Return the side of the second point from the first."""
        at_mm = [self._nerve.of(interval).center_mm[0] for interval in intervals]
        if any(math.isnan(x_mm) for x_mm in at_mm):
            return None
        return "l" if self._larger(np.array(at_mm), self.place_mm) == "1" else "r"

    def _softer(self, intervals: Sequence[Interval]) -> str | None:
        """Return where the rate changes least while the finger moves (paper, Section III-B.2)."""
        changes = [float(np.ptp(np.diff(interval.time_s))) for interval in intervals]
        return None if math.isclose(*changes, abs_tol=1e-3) else str(1 + int(np.argmin(changes)))

    def _larger(self, values: NDArray[np.float64], spread: float) -> str:
        return str(1 + int((values + spread * self._random.standard_normal(len(values))).argmax()))


def make_observer(
    kind: str,
    profile: Profile,  # profile of the finger whose spikes the model judges
    seed: int,  # of its noise
    finger: int = 1,  # seed of the model's finger
    anatomy: str | Path = "paper",  # of the model's finger
) -> Observer:
    """Return the observer of a kind: ``model``; or ``random``, for checks."""
    if kind != "model":
        return BlindObserver(seed)
    return SimulatedObserver(Finger(profile, finger, anatomy), seed)


Starts = dict[int, tuple[int, int]]
"""When each sequence of an interval began, ns, and the discharge after each of its slots, µs; by
its number."""


def interval_of(pulses: Pulses, starts: Starts) -> Interval:
    """Return the pulses that the sequences of one interval delivered, from
    `SimulatedDriver.take_pulses`."""
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
