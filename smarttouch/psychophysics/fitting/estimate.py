"""A threshold, as a procedure itself finds it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Estimate:
    """What a procedure itself makes of the answers.

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
