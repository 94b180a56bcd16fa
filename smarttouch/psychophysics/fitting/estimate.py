"""Threshold estimate of a procedure."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Estimate:
    """Threshold that a procedure estimates from its own answers.

    Attributes
    ----------
    threshold : float
        In the unit of the comparison.
    spread : float
        Its standard deviation, in the same unit.
    trials : int
        Answered ones.
    """

    threshold: float
    spread: float
    trials: int
