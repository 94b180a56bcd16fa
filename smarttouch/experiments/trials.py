"""Trials of experiments: pulse trains, questions, and the options for both.

An experiment is a generator that yields a `Trial` and receives its `Answer`.
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
LONGEST_S = 60.0  # longest pulse train
STEP_S = 0.05  # time step of a `Course`

FIRST_OR_SECOND = {"1": "1", "2": "2", "left": "1", "right": "2"}
YES_OR_NO = {"y": "y", "n": "n"}
LEFT_OR_RIGHT = {"left": "l", "right": "r", "1": "l", "2": "r"}
_WHERE = ("", " first", " second")


@dataclass(frozen=True, eq=False)
class Train:
    """Train of pulses at one frequency."""

    # (3, E) float32, in [0, 1]: one row for each `Afferent`
    activation: NDArray[np.float32]
    period_us: int  # time from pulse to pulse
    pulses: int  # number of pulses; the train ends one period after the last pulse
    level: float = 1.0  # factor for the user's intensity, in [0, 1]
    is_blank: bool = False  # whether the train is silent
    softness: float = 1.0  # 1: constant rate; 0: the rate follows the finger's force

    @property
    def rate_hz(self) -> float:
        return 1e6 / self.period_us

    @property
    def seconds(self) -> float:
        return self.pulses * self.period_us / 1e6


Course = Generator[float, bool | None, Any]
"""Generator that sets the current of one electrode from key presses. Every `STEP_S` it yields a
current, mA, and receives whether a key was pressed. If the current was lost, it receives None, and
the current rises from zero again. Its return value becomes `Answer.found`. If this value is a
string, it also becomes the response."""


@dataclass(frozen=True, eq=False)
class Trial:
    """Stimuli and question of one trial."""

    condition: Condition
    intervals: tuple[Train, ...]  # presented one after another
    task: str  # kind of question for simulated participants, see `Observer.respond`
    question: str
    unit: str  # unit of the comparison
    _: KW_ONLY
    answers: Mapping[str, str] = field(default_factory=lambda: YES_OR_NO)  # response by key
    success: str = "y"  # response that counts as a success
    target: str = ""  # correct response; empty if there is none
    exact: bool = False  # whether current counts as lost if force or user intensity lowers it
    course: Course | None = None  # sets the current from key presses, in a trial with one interval

    @property
    def alternatives(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(self.answers.values()))

    @property
    def words(self) -> str:
        """Description of the stimulus, for the recording of the run."""
        condition, unit = self.condition, self.unit
        if math.isnan(condition.comparison):
            return "current rises"
        standard = f"standard {condition.standard:g} {unit}, " if condition.standard else ""
        where = _WHERE[condition.comparison_interval]
        return f"{standard}comparison {condition.comparison:g} {unit}{where}"


@dataclass(frozen=True)
class Answer:
    """Answer of a participant to a trial."""

    response: str  # empty if no answer came
    success: bool | None  # None if no answer came
    rt_s: float | None = None  # reaction time from the end of the last interval
    time_s: float = 0.0  # time in the run
    level: float = 1.0  # intensity chosen by the user, 0 to 1
    reached: float | None = None  # current at the answer, mA; None without `Trial.course`
    found: Any = None  # return value of `Trial.course`


Trials = Generator[Trial, Answer, None]


def ask(procedure: Procedure, trial: Callable[[Condition], Trial]) -> Trials:
    """Yield a trial for each condition of a procedure, and send the answers to the procedure."""
    success: bool | None = None
    while True:
        try:
            condition = procedure.send(success)
        except StopIteration:
            return
        success = (yield trial(condition)).success


@dataclass
class Setup:
    """Profile, class and options of an experiment. A setup makes the pulse trains.

    Raises ExperimentError if an option is out of range.
    """

    profile: Profile
    afferent: Afferent = Afferent.RA
    _: KW_ONLY
    procedure: str = ""  # empty: the experiment's default
    standards: str = ""  # standards, Hz, as in 15,30
    repetitions: int | None = None  # trials of each condition
    trials: int | None = None  # trials of each standard, for adaptive procedures
    site: int | None = None  # None: the middle of the array
    train_s: float | None = None  # None: the experiment's default
    gap_s: float = 0.5  # pause between two intervals
    answer_s: float = 10.0  # time limit for an answer; 0 for none
    rate_hz: float | None = None  # pulse rate; None: the rate of the profile
    seed: int = 0  # seed of the order of trials
    total: int | None = field(default=None, init=False)  # number of trials, if known
    notes: list[str] = field(default_factory=list, init=False)  # messages to the user

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
                f"{self.standards!r} is not a list of standards: give frequencies in Hz, as in "
                "15,30,45"
            )
        self.standards_hz: tuple[float, ...] = tuple(dict.fromkeys(standards))

    @property
    def place(self) -> int:
        """Site of the stimuli: by default the driven electrode nearest to the middle."""
        if self.site is not None:
            return self.site
        driven = self.profile.driven
        away_mm = np.hypot(*self.profile.electrodes.position_mm[driven].T).round(6)
        return int(driven[away_mm.argmin()])

    @property
    def pulse_hz(self) -> float:
        """Pulse rate, Hz; by default the rate of the profile."""
        return self.profile.pulse.rate_hz if self.rate_hz is None else self.rate_hz

    def train(self, where: Sequence[int] | NDArray[Any], rate_hz: float) -> Train:
        """Return a pulse train. ``where`` holds the numbers of sites, or the activation of each
        electrode, (E,) float or bool."""
        limit_hz = self.profile.limits.rate_hz
        words = f"a pulse rate of {rate_hz:g} Hz"
        require_within(ExperimentError, "rate_hz", rate_hz, 0, limit_hz, words, above=True)
        seconds = self.train_s or 0.5
        pulses = round(seconds * rate_hz)
        if pulses < FEWEST_PULSES:
            raise ExperimentError(
                f"{seconds:g} s at {rate_hz:g} Hz are {pulses} pulses, fewer than the "
                f"{FEWEST_PULSES} that define a frequency: give a longer train_s"
            )
        activation = np.zeros((len(Afferent), len(self.profile.electrodes)), np.float32)
        if isinstance(where, np.ndarray) and where.dtype.kind not in "iu":
            if where.shape != activation[0].shape:
                raise ExperimentError(
                    f"activation {where.shape} does not fit {activation.shape[1]} electrodes of "
                    f"{self.profile.name}: give one value for each electrode, or site numbers"
                )
            activation[self.afferent] = where
        else:
            activation[self.afferent, list(where)] = 1
        return Train(activation, round(1e6 / rate_hz), pulses)

    def constant(
        self, pairs: Sequence[tuple[float, float]], two_intervals: bool = True
    ) -> Procedure:
        """Return `constant_stimuli` with the options of this setup."""
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
    """Return a trial of two intervals, one with ``comparison_train`` and one with ``other``.

    By default the correct response is the number of the interval that presents the comparison.
    `Trial` describes ``task`` and ``unit``. ``more`` sets further fields of `Trial`.
    """
    at = condition.comparison_interval
    return Trial(
        condition, (comparison_train, other) if at == 1 else (other, comparison_train),
        task, f"{question} 1 or 2", unit,
        **{"answers": FIRST_OR_SECOND, "success": str(at), "target": str(at)} | more,
    )  # fmt: skip
