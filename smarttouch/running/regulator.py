"""Closes the loop from what the board measured to what it is sent next."""

from dataclasses import dataclass, replace

from smarttouch.boards.board import Board
from smarttouch.running.step import Step
from smarttouch.stimulation.adaptation import Adaptation
from smarttouch.stimulation.ledger import ChargeBalance
from smarttouch.stimulation.recharge import RechargeRules, add_recharge
from smarttouch.stimulation.sequence import ScanSequence

_WAITING_UC = 0.02
"""Charge that whole µA of the longest recharge phase may leave."""


@dataclass
class Regulator:
    """Closes the loop from what the board measured to what it is sent next.

    The adaptation holds charge or energy against drifting impedance; the ledger has the net charge
    of every electrode, which a recharge phase within its rules, or else the polarity of whole
    scans, brings to zero.
    """

    adaptation: Adaptation | None = None
    ledger: ChargeBalance | None = None
    recharge: RechargeRules | None = None
    _scans: int = 0
    _reversed: int = 0
    _longer: int = 0
    _waited: int = 0
    _longest_us: int = 0

    def is_idle(self, board: Board) -> bool:
        """Whether nothing that a board measures is asked for or used."""
        measures = getattr(board.take_volts, "__func__", None) is not Board.take_volts
        return not measures and self.adaptation is None and self.ledger is None

    def regulate(self, step: Step, board: Board) -> Step:
        """Return the step with its sequence as it is to be sent."""
        if observed := tuple(board.take_volts()):
            step = replace(step, observed=observed)
        if self.adaptation is not None:
            for sequence, volts in step.observed:
                self.adaptation.observe(sequence, volts)
            step = replace(step, sequence=self.adaptation.apply(step.sequence))
        if self.ledger is not None:
            step = replace(step, sequence=self._balanced(step.sequence, self.ledger))
        return step

    def _balanced(self, sequence: ScanSequence, ledger: ChargeBalance) -> ScanSequence:
        if self.recharge is None:
            balanced = ledger.balancing(sequence)
            self._reversed += balanced is not sequence
        else:
            balanced = add_recharge(sequence, ledger.charge_pc, self.recharge)
            if balanced.period_us > sequence.period_us:
                self._longer += 1
                self._longest_us = max(self._longest_us, balanced.period_us)
        ledger.add(balanced)
        if balanced.slots:
            self._scans += 1
            self._waited += ledger.worst_uc > _WAITING_UC
        return balanced

    def lost(self, sequence: ScanSequence) -> None:
        """Take back a sequence that did not reach the board."""
        if self.ledger is not None:
            self.ledger.add(sequence, -1)

    def notes(self) -> list[str]:
        """Return what a user should know after the run."""
        notes = []
        limited = () if self.adaptation is None else self.adaptation.limited
        if limited:
            notes.append(
                f"charge could not be held at {len(limited)} sites: pulses are at their longest"
            )
        if self._reversed:
            notes.append(
                f"{self._reversed} of {self._scans} scans were reversed for the balance of charge: "
                "they drove the other class, SAI where RA was meant and RA where SAI was"
            )
        if self._longer:
            notes.append(
                f"the recharge phase made {self._longer} of {self._scans} scans longer than asked "
                f"for, at most to {self._longest_us / 1000:.1f} ms"
            )
        if self.recharge is not None and self.ledger is not None and self._waited:
            notes.append(
                f"after {self._waited} of {self._scans} scans charge was left that no recharge "
                f"phase may take back at once; {self.ledger.worst_uc:.2f} µC are left at the end"
            )
        return notes
