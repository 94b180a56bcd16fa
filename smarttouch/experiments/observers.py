"""Simulated observers: by thresholds, by spikes, and some that ignore the stimulus."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ExperimentError
from smarttouch.emulator.emulated_boards import Pulses
from smarttouch.experiments.perceived_spikes import FrequencySense, Interval, Nerve
from smarttouch.kernels.bank import KernelBank, load_bank
from smarttouch.physiology.finger import Finger
from smarttouch.profile import Profile
from smarttouch.running.delivered import strength

__all__ = [
    "BlindObserver", "Interval", "KnownObserver", "Observer", "SimulatedObserver", "Starts",
    "Subject", "chance_of_yes", "interval_of", "make_observer",
]  # fmt: skip

_YES_OR_NO = ("felt", "enough")
GRATING_LIMIT_MM = 0.94
"""Finest grooves whose direction a fingertip identifies (Van Boven and Johnson, Neurology 44,
1994). Ours: places are discriminated as well as grooves, in 75 % of trials."""
_LOOK_S = 0.25  # interval of an observer's decisions while a current rises (our own choice)


class Observer(Protocol):
    """Observer that answers trials."""

    def respond(
        self, task: str, intervals: Sequence[Interval], alternatives: Sequence[str]
    ) -> str | None:
        """Return one of the alternatives, or None for no answer.

        Tasks are ``faster`` (which interval: 1 or 2), ``felt`` and ``enough`` (y or n), ``side``
        (of the second point: l or r).
        """
        ...


@dataclass
class KnownObserver:
    """Observer that reports whether a current is felt, or enough, by given thresholds."""

    profile: Profile
    # (E,) mA: threshold_ma, enough_ma: strongest electrode's current that is felt, or enough, in
    # half of the trials
    threshold_ma: NDArray[np.float32]
    enough_ma: NDArray[np.float32]
    seed: int = 0
    slope: float = 0.1  # standard deviation of both, in natural logarithms of current
    # guess, lapse: rate of false detections, and rate at which what is felt is not noticed
    guess: float = 0.02
    lapse: float = 0.02

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)
        self._middles_ma = {"felt": self.threshold_ma, "enough": self.enough_ma}

    def respond(
        self, task: str, intervals: Sequence[Interval], alternatives: Sequence[str]
    ) -> str | None:
        """Return y or n, to the task felt or enough."""
        return "y" if self._random.random() < self._chance_of(task, intervals) else "n"

    def chance_felt(self, current_ma: float, electrode: int, task: str = "felt") -> float:
        """Return the probability that a pulse is called felt, or with that task enough."""
        middle_ma = float(self._middles_ma[task][electrode])
        above = math.log(current_ma / middle_ma) if current_ma > 0 else -math.inf
        return chance_of_yes(above / self.slope, task, self.guess, self.lapse)

    def _chance_of(self, task: str, intervals: Sequence[Interval]) -> float:
        """Return the probability of a yes to the strongest pulse of all."""
        current_ua = np.concatenate([each.current_ua for each in intervals])
        if not len(current_ua):
            return self.chance_felt(0.0, 0, task)
        width_us = np.concatenate([each.width_us for each in intervals])
        magnitude = np.abs(current_ua) * strength(width_us, self.profile.pulse)[:, None]
        strongest = magnitude.argmax(axis=1)
        delivered_ma = magnitude[np.arange(len(magnitude)), strongest] / 1000
        most = int((delivered_ma / self._middles_ma[task][strongest]).argmax())
        return self.chance_felt(float(delivered_ma[most]), int(strongest[most]), task)


def chance_of_yes(above: float, task: str, guess: float, lapse: float) -> float:
    """Return the probability of a yes to a stimulus so many standard deviations above the middle.

    Nothing is never enough, but may be called felt.
    """
    guess = guess if task == "felt" else 0.0
    return guess + (1 - guess - lapse) * float(ndtr(above))


@dataclass
class BlindObserver:
    """Observer that answers whatever is delivered: at ``random``, always the ``first`` answer, or
    ``silent``, never."""

    kind: str
    seed: int = 0

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)

    def respond(
        self, task: str, intervals: Sequence[Interval], alternatives: Sequence[str]
    ) -> str | None:
        if self.kind == "silent":
            return None
        return alternatives[
            int(self._random.integers(len(alternatives))) if self.kind == "random" else 0
        ]


@dataclass
class SimulatedObserver:
    """Observer that judges the spikes of one finger, with noise and a criterion."""

    finger: Finger
    bank: KernelBank  # of the finger's profile
    seed: int = 0
    # model of the perceived frequency of trains
    frequency: FrequencySense = field(default_factory=FrequencySense)
    # afferents that fire in a slot, on average, where in half of the trials it is felt. Ours: one
    # that answers every second slot (spikes of a single RA afferent can be felt, Vallbo et al.
    # 1984).
    felt_afferents: float = 0.5
    # afferents where it is enough in half of the trials; if not given, as many as RA pulses of the
    # profile's strongest comfortable current fire at three of four sites
    enough_afferents: float | None = None
    slope: float = 0.1  # standard deviation of both, in natural logarithms of afferents
    # guess, lapse: rate of false detections, and rate at which the answer is not what was felt: of
    # two or more alternatives any one
    guess: float = 0.02
    lapse: float = 0.02
    # standard deviation of a felt place
    place_mm: float = GRATING_LIMIT_MM / (math.sqrt(2) * float(ndtri(0.75)))

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)
        self._nerve = Nerve(self.finger, self.seed)
        self._judges: dict[str, Callable[[Sequence[Interval]], str | None]] = {
            "faster": self._faster,
            "side": self._side,
        }

    def respond(
        self, task: str, intervals: Sequence[Interval], alternatives: Sequence[str]
    ) -> str | None:
        """Return the answer to a trial.

        If it was felt in both of two intervals or in none, a coin is tossed: so does a threshold
        that is either passed or not (high-threshold theory, Green and Swets, Signal Detection
        Theory and Psychophysics, 1966, chapter 5).
        """
        if task in _YES_OR_NO:
            yes = [self._random.random() < self._chance_of(task, each) for each in intervals]
            if len(yes) == 1:
                return "y" if yes[0] else "n"
            tossed = int(self._random.integers(len(yes)))
            return alternatives[yes.index(True) if sum(yes) == 1 else tossed]
        if task not in self._judges:
            raise ExperimentError(
                f"the simulated observer has no answer to {task!r}: it can answer "
                f"{', '.join((*self._judges, *_YES_OR_NO))}"
            )
        judged = self._judges[task](intervals)
        if judged is None or self._random.random() < self.lapse:
            return alternatives[int(self._random.integers(len(alternatives)))]
        return judged

    # -- the truth ---------------------------------------------------------

    def ratio(self, afferent: Afferent, site: int) -> float:
        """Return the ratio of PC to RA spikes that a mode's pulses evoke at a site, see
        `Response`."""
        return self._nerve.of(self._train(afferent, [site])).ratio

    def chance_higher(self, standard_hz: float, comparison_hz: float, ratio: float = 0.0) -> float:
        """Return the chance that a comparison is judged faster than a standard, lapses included."""
        chance = self.frequency.chance_higher(standard_hz, comparison_hz, ratio)
        return self.lapse / 2 + (1 - self.lapse) * chance

    def chance_felt(self, afferents: float, task: str = "felt") -> float:
        """Return the probability that so many afferents a slot are called felt, or enough."""
        middle = self.felt_afferents if task == "felt" else self._enough
        above = math.log(afferents / middle) if afferents > 0 else -math.inf
        return chance_of_yes(above / self.slope, task, self.guess, self.lapse)

    # -- the tasks ---------------------------------------------------------

    @cached_property
    def _enough(self) -> float:
        """Afferents where it is enough in half of the trials."""
        if self.enough_afferents is not None:
            return self.enough_afferents
        full = self._nerve.of(self._train(Afferent.RA, range(len(self.finger.profile.electrodes))))
        most = float(np.quantile(full.fired.sum(axis=0), 0.25))
        return max(most, 2 * self.felt_afferents)

    def _train(self, afferent: Afferent, sites: Sequence[int]) -> Interval:
        """Return a full pulse at each of these sites, or many at one, as an interval."""
        profile = self.finger.profile
        which = np.resize(sites, max(20, len(sites)))
        current_ua = 1000 * profile.full_ma[which, None] * self.bank.kernels(afferent)[which]
        return Interval(
            np.arange(len(which), dtype=np.float64) * 0.05,
            np.full(len(which), profile.pulse.width_us, np.float32),
            np.rint(current_ua).astype(np.int16),
        )

    def _chance_of(self, task: str, interval: Interval) -> float:
        """Return the probability of a yes to what fires so many afferents in a slot."""
        return self.chance_felt(self._nerve.of(interval).per_slot, task)

    def _faster(self, intervals: Sequence[Interval]) -> str | None:
        felt = [self._nerve.of(each) for each in intervals]
        if any(each.hz == 0 for each in felt):
            return None
        perceived = np.log([self.frequency.perceived_hz(each.hz, each.ratio) for each in felt])
        return self._larger(perceived, self.frequency.spread)

    def _side(self, intervals: Sequence[Interval]) -> str | None:
        """Return the side of the second point from the first."""
        at_mm = [self._nerve.of(each).center_mm[0] for each in intervals]
        if any(math.isnan(each) for each in at_mm):
            return None
        return "l" if self._larger(np.array(at_mm), self.place_mm) == "1" else "r"

    def _larger(self, values: NDArray[np.float64], spread: float) -> str:
        return str(1 + int((values + spread * self._random.standard_normal(len(values))).argmax()))


def make_observer(
    kind: str,
    profile: Profile,  # profile of the finger whose spikes the model judges
    seed: int,  # of its noise
    finger: int = 1,  # seed of the model's finger
    anatomy: str | Path = "paper",  # of the model's finger
) -> Observer:
    """Return the observer of a kind: ``model``; or ``random``, ``first`` or ``silent``, for
    checks."""
    if kind != "model":
        return BlindObserver(kind, seed)
    return SimulatedObserver(Finger(profile, finger, anatomy), load_bank(profile), seed)


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
    at = np.array([starts[each] for each in number.tolist()], np.int64).reshape(-1, 2)
    taken_us = width_us.astype(np.float64) + at[:, 1]
    before_us = np.cumsum(taken_us) - taken_us
    first = np.flatnonzero(np.diff(number.astype(np.int64), prepend=-1))
    within_us = before_us - np.repeat(before_us[first], np.diff(np.append(first, len(number))))
    return Interval((at[:, 0] - begin_ns) / 1e9 + within_us / 1e6, width_us, current_ua)


@dataclass
class Subject:
    """Subject who answers in place of a person."""

    observer: Observer
    look_s: float = _LOOK_S  # interval of its decisions while a current rises
    reaction_s: float = 0.0  # from such a decision to the key
    _look_at_s: float = field(default=0.0, init=False)
    _key_at_s: float | None = field(default=None, init=False)

    def presses(
        self, task: str, now_s: float, current_ma: float, felt: Callable[[], Interval]
    ) -> bool:
        """Return whether a key is pressed in a step of a rising current.

        ``felt`` returns what was delivered since its last call. Where nothing flows, what was felt
        before counts no more.
        """
        if current_ma == 0:
            felt()
            self._key_at_s, self._look_at_s = None, now_s + self.look_s
        elif self._key_at_s is None and now_s >= self._look_at_s:
            self._look_at_s = now_s + self.look_s
            if self.observer.respond(task, [felt()], ("y", "n")) == "y":
                self._key_at_s = now_s + self.reaction_s
        if self._key_at_s is None or now_s < self._key_at_s:
            return False
        felt()
        self._key_at_s, self._look_at_s = None, now_s + self.look_s
        return True
