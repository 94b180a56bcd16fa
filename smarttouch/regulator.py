"""Closes the loop from what the board measured to what it is sent next."""

from dataclasses import dataclass, replace

from smarttouch.boards.board import Board
from smarttouch.pipeline import Step
from smarttouch.scan.adaptation import Adaptation
from smarttouch.scan.ledger import ChargeLedger


@dataclass
class Regulator:
    """Closes the loop from what the board measured to what it is sent next.

    Parameters
    ----------
    adaptation : Adaptation, optional
        Holds charge or energy against drifting impedance.
    ledger : ChargeLedger, optional
        Turns the polarity of a sequence where that brings net charge to zero.
    """

    adaptation: Adaptation | None = None
    ledger: ChargeLedger | None = None

    def regulate(self, step: Step, board: Board) -> Step:
        """Return the step with its sequence as it is to be sent."""
        if observed := tuple(board.take_volts()):
            step = replace(step, observed=observed)
        if self.adaptation is not None:
            for sequence, volts in step.observed:
                self.adaptation.observe(sequence, volts)
            step = replace(step, sequence=self.adaptation.apply(step.sequence))
        if self.ledger is not None:
            step = replace(step, sequence=self.ledger.balancing(step.sequence))
            self.ledger.add(step.sequence)
        return step

    def notes(self) -> list[str]:
        """Return what a user should know after the run."""
        limited = () if self.adaptation is None else self.adaptation.limited
        if not limited:
            return []
        return [f"charge could not be held at {len(limited)} sites: pulses are at their longest"]
