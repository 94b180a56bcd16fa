"""Threshold estimate of a procedure."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Estimate:
    """Threshold that a procedure estimates from its own answers."""

    threshold: float  # in the unit of the comparison
    spread: float  # its standard deviation, in the same unit
    trials: int  # answered ones
