"""Interface of procedures: choose the next stimulus, take the answer."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from smarttouch.errors import ExperimentError
from smarttouch.psychophysics.fitting.estimate import Estimate

PAIRS_IN_A_BLOCK = 4
"""Trials, of every eight of an adaptive procedure, with the comparison first."""


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

    @property
    def done(self) -> bool:
        """Whether there is no next trial."""

    def next(self) -> Condition:
        """Return the condition of the next trial; the same until it is answered."""

    def answer(self, success: bool | None) -> None:
        """Accept the result: judged higher, felt, or correct; None if there was no answer."""

    def estimate(self) -> Estimate | None:
        """Return the threshold; None if it is not determined."""


class Interleaved:
    """Several procedures at once, one of each standard for example, with trials mixed at random."""

    def __init__(self, procedures: Sequence[Procedure], seed: int = 0) -> None:
        if not procedures:
            raise ExperimentError(
                "there is no procedure to interleave: give at least one standard", about="standards"
            )
        self.procedures = tuple(procedures)
        self._random = np.random.default_rng([seed, len(procedures)])
        self._chosen: int | None = None

    @property
    def total(self) -> int | None:
        """Number of trials of all; None if one does not know its own."""
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
                raise ExperimentError("all trials are done: there is no next one", about="trial")
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
