"""The same trial again and again: for what the answer itself measures."""

import math

import numpy as np

from smarttouch.errors import ExperimentError
from smarttouch.psychophysics.fitting.estimate import Estimate
from smarttouch.psychophysics.procedures.procedure import Condition


class Repeats:
    """So many trials whose comparison is not a number: the answer will say it.

    Parameters
    ----------
    repetitions : int
        How many.

    Raises
    ------
    ExperimentError
        If there are none.
    """

    def __init__(self, repetitions: int) -> None:
        if repetitions < 1:
            raise ExperimentError(
                f"{repetitions} repetitions are no experiment: give at least one",
                about="repetitions",
                problem="too few",
                value=repetitions,
                allowed=1,
            )
        self._count, self._answers = repetitions, 0

    @property
    def total(self) -> int:
        """All repetitions."""
        return self._count

    @property
    def done(self) -> bool:
        """Whether all have been."""
        return self._answers >= self._count

    def next(self) -> Condition:
        """Return the same condition, with the next number."""
        if self.done:
            raise ExperimentError(
                "all trials are done: there is no next one", about="trial", problem="gone"
            )
        return Condition(0.0, math.nan, 0, repetition=self._answers, index=0)

    def answer(self, success: bool | None) -> None:
        """Count it; what was measured is with who asked."""
        self._answers += 1

    def estimate(self) -> Estimate | None:
        """Nothing: see the rows."""
        return None


def middle_and_spread(values: list[float]) -> tuple[float, float]:
    """Return the median, and the standard deviation by the median deviation."""
    middle = float(np.median(values))
    return middle, 1.4826 * float(np.median(np.abs(np.array(values) - middle)))
