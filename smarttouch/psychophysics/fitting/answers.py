"""Answers to be fitted: comparisons and the responses to them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.psychophysics.fitting.psychometric import MOST_LAPSES, Guess, Model, Shape

Array = NDArray[np.float64]


class Counts(NamedTuple):
    """Number of trials and successes at each comparison."""

    stimulus: Array  # (K,): rising
    # n, k: (K,), answers and successes
    n: Array
    k: Array


@dataclass(frozen=True, eq=False)
class Answers:
    """All trials of one standard, in their order."""

    standard: float  # standard of the comparison; 0 if there is none
    comparison: Array  # (N,): in the same unit
    success: Array  # (N,): 1 judged higher, felt, or right; 0 not; NaN no answer
    # (N,): of the comparison, 1 or 2; 0 where there are no two intervals
    interval: NDArray[np.int64]
    alternatives: int = 0  # number of alternatives; 0 if *yes* and *no*, or not known

    @property
    def presented(self) -> int:
        """Number of trials."""
        return len(self.success)

    @property
    def answered(self) -> int:
        """Number of trials with an answer."""
        return int(np.isfinite(self.success).sum())

    @property
    def chose_first(self) -> int:
        """Number of answers for the first interval."""
        chosen = np.where(self.success == 1, self.interval, 3 - self.interval)
        return int((chosen[self._two] == 1).sum())

    @property
    def compared(self) -> int:
        """Number of answers for one of two intervals."""
        return int(self._two.sum())

    def counts(self) -> Counts:
        """Return trials and successes at each comparison; trials without an answer are left out."""
        given = np.isfinite(self.success)
        stimulus, which = np.unique(self.comparison[given], return_inverse=True)
        n, k = np.zeros(len(stimulus)), np.zeros(len(stimulus))
        np.add.at(n, which, 1.0)
        np.add.at(k, which, self.success[given])
        return Counts(stimulus, n, k)

    @property
    def _two(self) -> NDArray[np.bool_]:
        return np.asarray(np.isfinite(self.success) & (self.interval > 0))


def usual_model(
    all_answers: Sequence[Answers],  # to all standards
    # shape, at, most_lapses: as for `Model`
    shape: Shape = Shape.NORMAL,
    # if None: with a standard, or comparisons on both sides of 0, *equal*; else one of the
    # alternatives; else of *felt*, free if some trials showed nothing, and 0 if none did
    guess: Guess | None = None,
    logarithmic: bool | None = None,  # if None: unless a comparison is negative
    at: float | None = None,
    most_lapses: float = MOST_LAPSES,
) -> Model:
    """Return the model that belongs to the answers of one experiment."""
    stimulus = np.concatenate([each.comparison for each in all_answers])
    signed = bool((stimulus < 0).any())
    if guess is None:
        alternatives = max(each.alternatives for each in all_answers)
        if signed or any(each.standard for each in all_answers):
            guess = "equal"
        elif alternatives:
            guess = 1 / alternatives
        else:
            guess = "free" if (stimulus == 0).any() else 0.0
    return Model(shape, not signed if logarithmic is None else logarithmic, guess, at, most_lapses)
