"""The method of constant stimuli: each condition a fixed number of times, in random order."""

import math
from collections.abc import Sequence

import numpy as np

from smarttouch.errors import ExperimentError
from smarttouch.psychophysics.fitting.answers import Answers
from smarttouch.psychophysics.fitting.estimate import Estimate
from smarttouch.psychophysics.fitting.verdict import estimate
from smarttouch.psychophysics.procedures.procedure import Condition

STANDARDS_HZ = (15.0, 30.0, 45.0, 60.0, 75.0)
"""Standards of the paper's frequency discrimination (Section III.C)."""
WIDEST_RATIO = 2.0
"""Comparisons reach from a half to twice the standard (Section III.C)."""
RATIOS = tuple(WIDEST_RATIO ** (step / 9) for step in range(-9, 10, 2))
"""Ten steps alike in logarithms and symmetric. 1.0 is not among them: nobody can be right about
two equal frequencies, and the curve at 1.0 follows from its neighbors on both sides."""
REPETITIONS = 10
"""Repetitions of each pair (Section III.C)."""


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
            f"no standard and comparison is at or below {highest:g}: give lower standards",
            about="standards",
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
                "least one of each",
                about="repetitions" if pairs else "conditions",
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
            raise ExperimentError("all trials are done: there is no next one", about="trial")
        return self._plan[len(self._answers)]

    def answer(self, success: bool | None) -> None:
        """Take an answer; None repeats the trial at the end, once."""
        condition = self.next()
        if success is None and len(self._answers) < self._once:
            self._plan.append(condition)
        self._answers.append(success)

    def estimate(self) -> Estimate | None:
        """Return the threshold by maximum likelihood; None if there are several standards."""
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
