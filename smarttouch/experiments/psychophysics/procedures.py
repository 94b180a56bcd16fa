"""Procedures that choose the next stimulus: their interface, repeats, and constant stimuli."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import ExperimentError
from smarttouch.experiments.fitting.answers import Answers
from smarttouch.experiments.fitting.findings import estimate
from smarttouch.experiments.fitting.psychometric import Estimate

PAIRS_IN_A_BLOCK = 4  # trials, of every eight of an adaptive procedure, with the comparison first


@dataclass(frozen=True)
class Condition:
    """Stimulus of one trial."""

    standard: float  # standard; 0 if there is none
    comparison: float
    # in which interval the comparison comes, 1 or 2; 0 where there are no two intervals
    comparison_interval: int
    # repetition, trial, index: PsychoPy's thisRepN, thisTrialN and thisIndex: which repetition of
    # all conditions, which trial of it, and which of the conditions
    repetition: int
    index: int
    trial: int = 0


class Procedure(Protocol):
    """Procedure: until `done`, show the condition of `next`, then pass its result to `answer`.

    The same arguments and answers lead to the same conditions: a session is resumed by
    giving it the same answers again.
    """

    @property
    def total(self) -> int | None:
        """Number of trials, as far as it is known; None if it depends on the answers."""
        return None

    @property
    def done(self) -> bool:
        """Whether there is no next trial."""

    def next(self) -> Condition:
        """Return the condition of the next trial; the same until it is answered."""

    def answer(self, success: bool | None) -> None:
        """Accept the result: judged higher, felt, or correct; None if there was no answer."""

    def estimate(self) -> Estimate | None:
        """Return the threshold; None if it is not determined, or is not what was asked."""
        return None


class Interleaved:
    """Several procedures at once, one of each standard for example, with trials mixed at random."""

    def __init__(self, procedures: Sequence[Procedure], seed: int = 0) -> None:
        if not procedures:
            raise ExperimentError("there is no procedure to interleave: give at least one standard")
        self.procedures: tuple[Procedure, ...] = tuple(procedures)
        self._random = np.random.default_rng([seed, len(procedures)])
        self._chosen: int | None = None

    @property
    def total(self) -> int | None:
        """Number of trials of all; None if that of one is unknown."""
        totals = [each.total for each in self.procedures]
        known = [total for total in totals if total is not None]
        return sum(known) if len(known) == len(totals) else None

    @property
    def done(self) -> bool:
        """Whether all procedures are done."""
        return all(each.done for each in self.procedures)

    def next(self) -> Condition:
        """Return the next condition of a procedure that is not done, with its index."""
        if self._chosen is None:
            waiting = [i for i, each in enumerate(self.procedures) if not each.done]
            if not waiting:
                raise ExperimentError("all trials are done: there is no next one")
            self._chosen = int(self._random.choice(waiting))
        return replace(self.procedures[self._chosen].next(), index=self._chosen)

    def answer(self, success: bool | None) -> None:
        """Pass the answer to the procedure of the last condition."""
        self.next()
        assert self._chosen is not None
        self.procedures[self._chosen].answer(success)
        self._chosen = None

    def estimate(self) -> Estimate | None:
        """Return the only procedure's threshold; None if there are several: see `estimates`."""
        return self.procedures[0].estimate() if len(self.procedures) == 1 else None

    def estimates(self) -> list[Estimate | None]:
        """Return the threshold of each procedure, in their order."""
        return [each.estimate() for each in self.procedures]


class IntervalOrder:
    """Balanced order of intervals: the comparison of an adaptive procedure is in each half the
    time.
    """

    def __init__(self, two_intervals: bool, seed: int) -> None:
        self._two = two_intervals
        self._random = np.random.default_rng([seed, 2])
        self._block: list[int] = []

    def next(self) -> int:
        """Return 1 or 2; 0 where there are no two intervals."""
        if not self._two:
            return 0
        if not self._block:
            block = [1] * PAIRS_IN_A_BLOCK + [2] * PAIRS_IN_A_BLOCK
            self._block = [int(each) for each in self._random.permutation(block)]
        return self._block.pop()


class Repeats(Procedure):
    """Repeated trials whose comparison is not a number but the result of the trial."""

    def __init__(self, repetitions: int) -> None:
        if repetitions < 1:
            raise ExperimentError(f"{repetitions} repetitions are no experiment: give at least one")
        self._count, self._answers = repetitions, 0

    @property
    def total(self) -> int:
        """Number of repetitions."""
        return self._count

    @property
    def done(self) -> bool:
        """Whether all repetitions are over."""
        return self._answers >= self._count

    def next(self) -> Condition:
        """Return the same condition, with the next number."""
        if self.done:
            raise ExperimentError("all trials are done: there is no next one")
        return Condition(0.0, math.nan, 0, repetition=self._answers, index=0)

    def answer(self, success: bool | None) -> None:
        """Count the trial; its measurement is in the rows."""
        self._answers += 1


def middle_and_spread(values: Sequence[float] | NDArray[np.float64]) -> tuple[float, float]:
    """Return the median, and a robust standard deviation: 1.4826 times the median deviation."""
    middle = float(np.median(values))
    return middle, 1.4826 * float(np.median(np.abs(np.asarray(values) - middle)))


STANDARDS_HZ = (15.0, 30.0, 45.0, 60.0, 75.0)
"""Standards of the paper's frequency discrimination (Section III.C)."""
WIDEST_RATIO = 2.0  # comparisons reach from a half to twice the standard (Section III.C)
RATIOS = tuple(WIDEST_RATIO ** (step / 9) for step in range(-9, 10, 2))
"""Ten steps alike in logarithms and symmetric. 1.0 is not among them: nobody can be right about
two equal frequencies, and the curve at 1.0 follows from its neighbors on both sides."""
REPETITIONS = 10  # repetitions of each pair (Section III.C)


def ratio_pairs(
    # standards, ratios: each standard is paired with its product with each ratio
    standards: Sequence[float] = STANDARDS_HZ,
    ratios: Sequence[float] = RATIOS,
    highest: float = math.inf,  # largest comparison, in the unit of the standards
) -> list[tuple[float, float]]:
    """Return standards with their comparisons, to a thousandth; none above `highest`."""
    pairs = [
        (float(standard), round(standard * ratio, 3))
        for standard in standards
        for ratio in ratios
        if max(standard, standard * ratio) <= highest
    ]
    if not pairs:
        raise ExperimentError(
            f"no standard and comparison is at or below {highest:g}: give lower standards"
        )
    return pairs


class ConstantStimuli:
    """Procedure that shows each pair a fixed number of times, in a new random order each time.

    In two intervals the comparison comes first in half the trials of each pair, so that who
    always answers *the first* is right half the time. A trial without an answer comes again at the
    end, once.
    """

    def __init__(
        self,
        # standards and comparisons; the standard is 0 where there is none
        pairs: Sequence[tuple[float, float]],
        repetitions: int = REPETITIONS,  # of each pair
        two_intervals: bool = True,  # whether standard and comparison come one after the other
        seed: int = 0,  # of all orders
    ) -> None:
        if not pairs or repetitions < 1:
            raise ExperimentError(
                f"{len(pairs)} conditions and {repetitions} repetitions are no experiment: give at "
                "least one of each"
            )
        random = np.random.default_rng([seed, len(pairs), repetitions])
        first = _first_intervals(len(pairs), repetitions, random)
        self._plan = [
            Condition(
                standard=float(pairs[index][0]),
                comparison=float(pairs[index][1]),
                comparison_interval=int(first[index, repetition]) if two_intervals else 0,
                repetition=repetition,
                index=int(index),
                trial=trial,
            )
            for repetition in range(repetitions)
            for trial, index in enumerate(random.permutation(len(pairs)))
        ]
        self._once = len(self._plan)
        self._answers: list[bool | None] = []

    @property
    def total(self) -> int:
        """Number of trials, with the repeated ones."""
        return len(self._plan)

    @property
    def done(self) -> bool:
        """Whether each trial has an answer, or was repeated without one."""
        return len(self._answers) == len(self._plan)

    def next(self) -> Condition:
        """Return the next condition."""
        if self.done:
            raise ExperimentError("all trials are done: there is no next one")
        return self._plan[len(self._answers)]

    def answer(self, success: bool | None) -> None:
        """Take an answer; None repeats the trial at the end, once."""
        condition = self.next()
        if success is None and len(self._answers) < self._once:
            self._plan.append(condition)
        self._answers.append(success)

    def estimate(self) -> Estimate | None:
        """Return the median threshold of the posterior; None if there are several standards."""
        shown = self._plan[: len(self._answers)]
        if len({each.standard for each in shown}) != 1:
            return None
        success = np.array([math.nan if each is None else each for each in self._answers])
        comparison = np.array([each.comparison for each in shown])
        interval = np.array([each.comparison_interval for each in shown])
        two = 2 if interval.any() else 0
        return estimate(Answers(shown[0].standard, comparison, success, interval, two))


def _first_intervals(
    pairs: int, repetitions: int, random: np.random.Generator
) -> np.ndarray[tuple[int, int], np.dtype[np.int64]]:
    """Return the interval of each comparison, (P, R), 1 or 2, balanced in each row."""
    # The odd repetition, where there is one, is a first for every second pair.
    balanced = (np.arange(repetitions) + np.arange(pairs)[:, None]) % 2 + 1
    return np.asarray(random.permuted(balanced, axis=1))
