"""What every procedure has in common: it names the next stimulus and takes the answer."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from smarttouch.errors import ExperimentError
from smarttouch.psychophysics.fitting.estimate import Estimate

PAIRS_IN_A_BLOCK = 4
"""Of every eight trials of an adaptive procedure the comparison comes first in four."""


@dataclass(frozen=True)
class Condition:
    """What one trial shows.

    Attributes
    ----------
    standard : float
        What is compared with; 0 where there is nothing.
    comparison : float
        What is tested, in the same unit.
    comparison_interval : int
        In which interval the comparison comes, 1 or 2; 0 where there are no two intervals.
    repetition, trial, index : int
        PsychoPy's thisRepN, thisTrialN and thisIndex: which repetition of all conditions, the
        how-manieth trial of it, and which of the conditions.
    """

    standard: float
    comparison: float
    comparison_interval: int
    repetition: int
    index: int
    trial: int = 0


class Procedure(Protocol):
    """Until `done`: show what `next` returns, then say by `answer` what came of it.

    The same arguments and answers lead to the same conditions: a session is resumed by
    answering anew what has been answered before.
    """

    @property
    def total(self) -> int | None:
        """Trials there will be, as far as is known now; None if that depends on the answers."""

    @property
    def done(self) -> bool:
        """Whether there is no next trial."""

    def next(self) -> Condition:
        """Return what the next trial shows; the same until it is answered."""

    def answer(self, success: bool | None) -> None:
        """Say what was answered: judged higher, felt, or correct; None if no answer came."""

    def estimate(self) -> Estimate | None:
        """Return the threshold; None if nothing can be told."""


class Interleaved:
    """Several procedures at once, their trials mixed at random.

    Parameters
    ----------
    procedures : sequence of Procedure
        One of each standard, for example.
    seed : int
        Of the order.
    """

    def __init__(self, procedures: Sequence[Procedure], seed: int = 0) -> None:
        if not procedures:
            raise ExperimentError(
                "there is no procedure to interleave: give at least one standard",
                about="--standards",
                problem="too few",
                value=0,
                allowed=1,
            )
        self.procedures = tuple(procedures)
        self._random = np.random.default_rng([seed, len(procedures)])
        self._chosen: int | None = None

    @property
    def total(self) -> int | None:
        """Trials of all, if all know."""
        totals = [each.total for each in self.procedures]
        known = [total for total in totals if total is not None]
        return sum(known) if len(known) == len(totals) else None

    @property
    def done(self) -> bool:
        """Whether all are."""
        return all(each.done for each in self.procedures)

    def next(self) -> Condition:
        """Return the next condition of one that is not done; its index says which."""
        if self._chosen is None:
            waiting = [i for i, each in enumerate(self.procedures) if not each.done]
            if not waiting:
                raise ExperimentError(
                    "all trials are done: there is no next one", about="trial", problem="gone"
                )
            self._chosen = int(self._random.choice(waiting))
        return replace(self.procedures[self._chosen].next(), index=self._chosen)

    def answer(self, success: bool | None) -> None:
        """Pass the answer to the one that asked."""
        self.next()
        assert self._chosen is not None
        self.procedures[self._chosen].answer(success)
        self._chosen = None

    def estimate(self) -> Estimate | None:
        """Return the only one's; None if there are several, whose thresholds are their own."""
        return self.procedures[0].estimate() if len(self.procedures) == 1 else None

    def estimates(self) -> list[Estimate | None]:
        """Return the threshold of each, in their order."""
        return [each.estimate() for each in self.procedures]


class IntervalOrder:
    """In which interval the comparison of an adaptive procedure comes: half the time in each."""

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
