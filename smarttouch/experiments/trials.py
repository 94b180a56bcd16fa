"""Trials of experiments: trains of pulses, the question, and the setup that makes them.

An experiment is a generator: it yields a `Trial`, gets its `Answer`, and chooses the next.
"""

import math
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ExperimentError, require_within
from smarttouch.experiments.procedures import (
    REPETITIONS,
    Condition,
    Procedure,
    constant_stimuli,
)
from smarttouch.profile import Profile
from smarttouch.profile.profile import require_driven

FEWEST_PULSES = 2  # fewest pulses that have a frequency
LONGEST_S = 60.0
STEP_S = 0.05  # one step of a current that follows the keys

FIRST_OR_SECOND = {"1": "1", "2": "2", "left": "1", "right": "2"}
YES_OR_NO = {"y": "y", "n": "n"}
LEFT_OR_RIGHT = {"left": "l", "right": "r", "1": "l", "2": "r"}
_WHERE = ("", " first", " second")


@dataclass(frozen=True, eq=False)
class Train:
    """Train of pulses at one frequency."""

    # (3, E) float32, in [0, 1]: one row for each `Afferent`
    activation: NDArray[np.float32]
    period_us: int  # from pulse to pulse
    pulses: int  # it ends one period after the last
    # in [0, 1]: of the strongest comfortable current, on top of what the user wishes
    level: float = 1.0
    is_blank: bool = False  # whether no current flows, for as long as in the same train
    softness: float = 1.0  # 1: the rate is constant; 0: it follows the finger's force

    @property
    def rate_hz(self) -> float:
        return 1e6 / self.period_us

    @property
    def seconds(self) -> float:
        return self.pulses * self.period_us / 1e6


Course = Generator[float, bool | None, Any]
"""Current of one electrode that follows the keys: for each `STEP_S` it yields the current, mA; it
gets whether a key was pressed meanwhile, or None where current was lost and it begins to rise from
zero again; and returns the response or another result."""


@dataclass(frozen=True, eq=False)
class Trial:
    """Stimuli and question of one trial."""

    condition: Condition
    intervals: tuple[Train, ...]  # one after another
    task: str  # kind of question, for observers: faster, felt, side …
    question: str
    unit: str  # of the condition
    _: KW_ONLY
    answers: Mapping[str, str] = field(default_factory=lambda: YES_OR_NO)  # response by key
    success: str = "y"  # the response that is a success: judged higher, felt, or right
    target: str = ""  # the response that is true; empty if none is
    exact: bool = False  # whether it counts in milliamperes: nothing may lower it, it comes once
    course: Course | None = None  # sets the level of its only train; every key is an answer then

    @property
    def alternatives(self) -> tuple[str, ...]:
        """All possible responses."""
        return tuple(dict.fromkeys(self.answers.values()))

    @property
    def words(self) -> str:
        """Stimulus as text, for the report of the run."""
        condition, unit = self.condition, self.unit
        if math.isnan(condition.comparison):
            return "current rises"
        standard = f"standard {condition.standard:g} {unit}, " if condition.standard else ""
        where = _WHERE[condition.comparison_interval]
        return f"{standard}comparison {condition.comparison:g} {unit}{where}"


@dataclass(frozen=True)
class Answer:
    """Answer to a trial."""

    response: str  # empty if none came
    success: bool | None  # None if no answer came
    rt_s: float | None = None  # from the end of the last interval
    time_s: float = 0.0  # of the run
    level: float = 1.0  # amplitude that the user had chosen, 0 to 1
    reached: float | None = None  # current at the answer, where it followed the keys
    found: Any = None  # what the course of the trial returned


Trials = Generator[Trial, Answer, None]


def ask(procedure: Procedure, trial: Callable[[Condition], Trial]) -> Trials:
    """Yield the trial of each condition that a procedure chooses."""
    success: bool | None = None
    while True:
        try:
            condition = procedure.send(success)
        except StopIteration:
            return
        success = (yield trial(condition)).success


@dataclass
class Setup:
    """What an experiment is made for: profile, class and the user's options; it makes trains.

    Raises an ExperimentError where an option is out of range.
    """

    profile: Profile
    afferent: Afferent = Afferent.RA
    _: KW_ONLY
    procedure: str = ""  # empty: the first that the experiment has
    standards: str = ""  # frequencies of standards, Hz, as in 15,30
    repetitions: int | None = None  # of each condition
    trials: int | None = None  # of each standard, where answers choose the next
    site: int | None = None  # the middle one if None
    train_s: float | None = None  # the experiment's own if None
    gap_s: float = 0.5  # between two intervals
    answer_s: float = 10.0  # time limit for an answer; 0 for none
    rate_hz: float | None = None  # of pulses, where the experiment does not set it
    seed: int = 0  # of the order of trials
    total: int | None = field(default=None, init=False)  # trials; None if answers decide it
    notes: list[str] = field(default_factory=list, init=False)  # for the user

    def __post_init__(self) -> None:
        for name in ("repetitions", "trials"):
            if (value := getattr(self, name)) is not None:
                require_within(ExperimentError, name, value, 1, math.inf)
        if self.train_s is not None:
            words = f"a train of {self.train_s:g} s"
            require_within(ExperimentError, "train_s", self.train_s, 0, LONGEST_S, words,
                           above=True)  # fmt: skip
        require_within(ExperimentError, "gap_s", self.gap_s, 0, 60)
        require_within(ExperimentError, "answer_s", self.answer_s, 0, 3600)
        if self.site is not None:
            require_driven(self.profile, [self.site], ExperimentError, "site")
        try:
            standards = [
                float(standard) for standard in self.standards.split(",") if self.standards
            ]
        except ValueError:
            standards = [math.nan]
        if not all(0 < standard < 1e6 for standard in standards):
            raise ExperimentError(
                f"standards {self.standards!r} are not understood: give frequencies in Hz, as in "
                "15,30,45"
            )
        self.standards_hz: tuple[float, ...] = tuple(dict.fromkeys(standards))

    @property
    def place(self) -> int:
        """Site of the stimuli: that given, or the driven one nearest to the middle."""
        if self.site is not None:
            return self.site
        driven = self.profile.driven
        away_mm = np.hypot(*self.profile.electrodes.position_mm[driven].T).round(6)
        return int(driven[away_mm.argmin()])

    @property
    def pulse_hz(self) -> float:
        """Rate of pulses: that given, or the profile's."""
        return self.profile.pulse.rate_hz if self.rate_hz is None else self.rate_hz

    def train(self, where: Sequence[int] | NDArray[Any], rate_hz: float) -> Train:
        """Return a train on some sites, given as whole numbers, or with an activation of each, (E,)
        of numbers or bool."""
        limit_hz = self.profile.limits.rate_hz
        words = f"{rate_hz:g} Hz, where the profile allows {limit_hz:g} Hz,"
        require_within(ExperimentError, "rate_hz", rate_hz, 0, limit_hz, words, above=True)
        seconds = self.train_s or 0.5
        pulses = round(seconds * rate_hz)
        if pulses < FEWEST_PULSES:
            raise ExperimentError(
                f"{seconds:g} s at {rate_hz:g} Hz are {pulses} pulses, fewer than the "
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

    def constant(
        self, pairs: Sequence[tuple[float, float]], two_intervals: bool = True
    ) -> Procedure:
        """Return `constant_stimuli`, as often and in the order that was asked for."""
        repetitions = self.repetitions or REPETITIONS
        self.total = len(pairs) * repetitions
        return constant_stimuli(pairs, repetitions, two_intervals, self.seed)


def in_two_intervals(
    condition: Condition,
    comparison_train: Train,
    other: Train,
    task: str,
    question: str,
    unit: str,
    **more: Any,
) -> Trial:
    """Return a trial of two intervals: ``own`` is in that of the comparison, which is right.

    ``task`` is the kind of question for simulated observers, and ``unit`` that of the comparison;
    ``more`` are other fields of a `Trial`.
    """
    at = condition.comparison_interval
    return Trial(
        condition, (comparison_train, other) if at == 1 else (other, comparison_train),
        task, f"{question} 1 or 2", unit,
        **{"answers": FIRST_OR_SECOND, "success": str(at), "target": str(at)} | more,
    )  # fmt: skip
