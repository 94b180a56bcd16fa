"""Trials: pulse trains, intervals, the question, the meaning of its answers, and the timing."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ExperimentError, require_within
from smarttouch.experiments.psychophysics.procedures import Condition
from smarttouch.profile import Profile

FEWEST_PULSES = 2  # fewest pulses that have a frequency
LONGEST_S = 60.0


@dataclass(frozen=True, eq=False)
class Train:
    """Train of pulses at one frequency."""

    # (3, E) float32, in [0, 1]: one row for each `Afferent`; all zero is a blank of the same length
    activation: NDArray[np.float32]
    period_us: int  # from pulse to pulse
    pulses: int  # it ends one period after the last
    # in [0, 1]: of the strongest comfortable current, on top of what the user wishes
    level: float = 1.0
    rises: bool = False  # whether it rises to that level evenly from nothing, over its whole length
    # (3, E) float32: activation of the train that this one is the blank of
    blanked: NDArray[np.float32] | None = None

    @property
    def rate_hz(self) -> float:
        return 1e6 / self.period_us

    def blank(self) -> "Train":
        """Return the same train without current."""
        # Its level stays where the train begins: without current none would rise.
        return replace(
            self,
            activation=np.zeros_like(self.activation),
            level=self.level_at(0),
            blanked=self.activation,
        )

    def level_at(self, pulse: int) -> float:
        """Return the level of a pulse, counted from 0."""
        return self.level * (pulse + 1) / self.pulses if self.rises else self.level


class Stimuli:
    """Factory of trains of one length for one class of afferents."""

    def __init__(self, profile: Profile, afferent: Afferent, train_s: float) -> None:
        words = f"a train of {train_s:g} s"
        require_within(ExperimentError, "train_s", train_s, 0, LONGEST_S, words, above=True)
        self.profile: Profile = profile
        self.afferent: Afferent = afferent
        self.train_s: float = train_s

    def train(self, where: Sequence[int] | NDArray[Any], rate_hz: float) -> Train:
        """Return a train on some sites, given as whole numbers, or with an activation of each, (E,)
        of numbers or bool."""
        limit_hz = self.profile.limits.rate_hz
        words = f"{rate_hz:g} Hz, where the profile allows {limit_hz:g} Hz,"
        require_within(ExperimentError, "rate_hz", rate_hz, 0, limit_hz, words, above=True)
        pulses = round(self.train_s * rate_hz)
        if pulses < FEWEST_PULSES:
            raise ExperimentError(
                f"{self.train_s:g} s at {rate_hz:g} Hz are {pulses} pulses, fewer than the "
                f"{FEWEST_PULSES} that define a frequency: make trains longer"
            )
        activation = np.zeros((len(Afferent), len(self.profile.electrodes)), np.float32)
        if isinstance(where, np.ndarray) and where.dtype.kind not in "iu":
            if where.shape != activation[0].shape:
                raise ExperimentError(
                    f"an activation of {where.shape} is not for the {activation.shape[1]} sites of "
                    f"{self.profile.name}: give one for each, or sites by their numbers"
                )
            activation[self.afferent] = where
        else:
            activation[self.afferent, list(where)] = 1
        return Train(activation, round(1e6 / rate_hz), pulses)

    @property
    def middle(self) -> int:
        """Driven site nearest to the middle of the array."""
        return self.nearest((0.0, 0.0))

    def nearest(self, place_mm: Sequence[float] | NDArray[np.float64]) -> int:
        """Return the driven site that is nearest to a place, (x, y) mm."""
        driven = self.profile.driven
        away_mm = self.profile.electrodes.position_mm[driven] - place_mm
        return int(driven[np.hypot(*away_mm.T).round(6).argmin()])

    def beside(self, site: int) -> dict[float, int]:
        """Return the other driven sites on the same row, by their offset to the right, mm."""
        place_mm = self.profile.electrodes.position_mm
        away_mm = place_mm[self.profile.driven] - place_mm[site]
        return {
            round(float(right), 3): int(other)
            for other, (right, down) in zip(self.profile.driven, away_mm, strict=True)
            if abs(down) < 1e-3 and abs(right) > 1e-3
        }


FIRST_OR_SECOND = {"1": "1", "2": "2", "left": "1", "right": "2"}
YES_OR_NO = {"y": "y", "n": "n"}
LEFT_OR_RIGHT = {"left": "l", "right": "r", "1": "l", "2": "r"}
ENOUGH = {"\n": "y", "\r": "y", "y": "y"}


class AdjustableLevel(Protocol):
    """Current of one electrode that follows the keys, step by step, until it is done."""

    @property
    def task(self) -> str:
        """Kind of question that the next key answers, for observers."""

    @property
    def done(self) -> bool:
        """Whether there is no next step."""

    def next(self) -> float:
        """Return the current of the next step, mA."""

    def answer(self, pressed: bool) -> None:
        """Take the answer: whether a key was pressed during the last step."""

    def restart(self) -> None:
        """Begin this rise again from zero: the current was interrupted."""


@dataclass(frozen=True, eq=False)
class Trial:
    """Stimuli and question of one trial."""

    condition: Condition  # of the procedure
    intervals: tuple[Train, ...]  # one after another
    task: str  # kind of question, for observers: faster, felt, two, side, which, enough
    question: str
    answers: Mapping[str, str]  # response by key
    target: str  # the response that is true; empty if none is
    success: str  # the response that is a success, see `TrialRow`
    words: str  # stimulus as text, for the report of the run
    unit: str  # of the condition
    compares: bool = False  # whether the condition has a standard
    exact: bool = False  # whether it counts in milliamperes, so that nothing may lower the current
    course: AdjustableLevel | None = (
        None  # sets the level of its only train; every key is an answer then
    )

    @property
    def alternatives(self) -> tuple[str, ...]:
        """All possible responses."""
        return tuple(dict.fromkeys(self.answers.values()))

    @property
    def rises(self) -> bool:
        """Whether the answer ends a rising current."""
        return self.course is not None or any(each.rises for each in self.intervals)


@dataclass(frozen=True)
class Answer:
    """Result of a trial."""

    response: str  # empty if none came
    rt_s: float | None  # from the end of the last interval
    time_s: float  # of the run
    level: float  # amplitude that the user had chosen, 0 to 1
    reached: float | None = None  # current at the answer, where it rises


class Task(Protocol):
    """Factory of trials from the conditions of a procedure."""

    def trial(self, condition: Condition) -> Trial:
        """Return the stimuli and the question of a condition."""


class Trials(Protocol):
    """Source of trials that takes their answers."""

    title: str

    @property
    def done(self) -> int:
        """Number of trials that are over."""

    @property
    def total(self) -> int | None:
        """Number of trials; None if it depends on the answers."""

    def next(self) -> Trial | None:
        """Return the next trial; None if there is none."""

    def record(self, trial: Trial, answer: Answer) -> None:
        """Keep an answer."""


@dataclass(frozen=True)
class TrialTiming:
    """Timing of a trial."""

    gap_s: float = 0.5  # between two intervals
    answer_s: float | None = 10.0  # time limit for an answer; no limit if None
    again: bool = True  # whether a participant may feel a trial once more
    # time limit for the current to reach its level before a trial; no limit if None
    patience_s: float | None = None
    # times that a trial is presented again because its current was lost; no limit if None
    most_spoiled: int | None = None

    def __post_init__(self) -> None:
        require_within(ExperimentError, "gap_s", self.gap_s, 0, 60)
        if self.answer_s is not None:
            require_within(ExperimentError, "answer_s", self.answer_s, 0, 3600, above=True)
