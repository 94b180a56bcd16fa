"""Procedure that repeats one trial, for experiments in which the answer is the measurement."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from smarttouch.errors import ExperimentError
from smarttouch.psychophysics.fitting.estimate import Estimate
from smarttouch.psychophysics.procedures.procedure import Condition


class Repeats:
    """Repeated trials whose comparison is not a number but the result of the trial."""

    def __init__(self, repetitions: int) -> None:
        if repetitions < 1:
            raise ExperimentError(
                f"{repetitions} repetitions are no experiment: give at least one",
                about="repetitions",
            )
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
            raise ExperimentError("all trials are done: there is no next one", about="trial")
        return Condition(0.0, math.nan, 0, repetition=self._answers, index=0)

    def answer(self, success: bool | None) -> None:
        """Count the trial; its measurement is in the rows."""
        self._answers += 1

    def estimate(self) -> Estimate | None:
        """Return None; the measurements are in the rows."""
        return None


def middle_and_spread(values: Sequence[float] | NDArray[np.float64]) -> tuple[float, float]:
    """Return the median, and a robust standard deviation: 1.4826 times the median deviation."""
    middle = float(np.median(values))
    return middle, 1.4826 * float(np.median(np.abs(np.asarray(values) - middle)))
