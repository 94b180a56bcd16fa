"""One trial: its intervals, its question, and the meaning of its answers."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from smarttouch.psychophysics.procedures.procedure import Condition
from smarttouch.psychophysics.stimuli import Train

FIRST_OR_SECOND = {"1": "1", "2": "2", "left": "1", "right": "2"}
YES_OR_NO = {"y": "y", "n": "n"}
LEFT_OR_RIGHT = {"left": "l", "right": "r", "1": "l", "2": "r"}
ENOUGH = {"\n": "y", "\r": "y", "y": "y"}


class Course(Protocol):
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
    course: Course | None = None  # sets the level of its only train; every key is an answer then

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
