"""Regulation of a run by the board's own measurements."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from smarttouch.base.errors import BoardError
from smarttouch.boards.board import Board
from smarttouch.profile import Profile
from smarttouch.running.config import RunConfig
from smarttouch.running.step import Measured, Step
from smarttouch.stimulation.adaptation import RESERVED, Adaptation
from smarttouch.stimulation.recharge import ChargeBalance, RechargeRules, add_recharge
from smarttouch.stimulation.scan_sequence import ScanSequence

_WAITING_UC = 0.02  # charge that whole µA of the longest recharge phase may leave


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
    _waited: int = 0

    def is_idle(self, board: Board) -> bool:
        """Whether no measurement of a board is requested or used."""
        return not board.capabilities.measures and self.adaptation is None and self.ledger is None

    def observe(self, observed: Iterable[Measured]) -> tuple[Measured, ...]:
        """Learn from what the board has measured, and return it; planning comes after it."""
        observed = tuple(observed)
        if self.adaptation is not None:
            for sequence, volts in observed:
                self.adaptation.observe(sequence, volts)
        return observed

    def regulate(self, step: Step, observed: tuple[Measured, ...]) -> Step:
        """Return the step with its sequence as it is to be sent, and what was observed before."""
        if observed:
            step = replace(step, observed=observed)
        if self.ledger is not None:
            step = replace(step, sequence=self._balanced(step.sequence, self.ledger))
        return step

    def _balanced(self, sequence: ScanSequence, ledger: ChargeBalance) -> ScanSequence:
        if self.recharge is None:
            balanced = ledger.balancing(sequence)
            self._reversed += balanced is not sequence
        else:
            balanced = add_recharge(sequence, ledger.charge_pc, self.recharge)
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
        """Return notes for the user after the run."""
        notes = []
        limited = () if self.adaptation is None else self.adaptation.limited
        if limited and self.adaptation is not None:
            what, end = ("energy", "strongest") if self.adaptation.holds == "energy" else (
                "charge", "longest")  # fmt: skip
            notes.append(
                f"{what} could not be held at {len(limited)} sites: pulses are at their {end}"
            )
        if self._reversed:
            notes.append(
                f"{self._reversed} of {self._scans} scans were reversed for the balance of charge: "
                "they drove the other class, SAI where RA was meant and RA where SAI was"
            )
        if self.recharge is not None and self.ledger is not None and self._waited:
            notes.append(
                f"after {self._waited} of {self._scans} scans charge was left that no recharge "
                f"phase may take back at once; {self.ledger.worst_uc:.2f} µC are left at the end"
            )
        return notes


def make_regulator(
    board: Board, profile: Profile, config: RunConfig, note: Callable[[str], None]
) -> Regulator:
    """Return the regulator that ``hold`` and ``balance`` ask for on an open board.

    Each sentence that the user should know before the run goes to ``note``. Raises BoardError if
    the board cannot do it.
    """
    can = board.capabilities
    if can.time_to_zero_ms is None:
        note(
            "This board goes on with its last pattern if its line breaks: keep its switch within "
            "reach."
        )
    adaptation = ledger = recharge = None
    if config.hold is not None:
        if not can.measures or can.compliance_v is None:
            raise BoardError(
                "hold needs a board that measures the voltage of each slot, and this one does not"
            )
        if not board.driver.timing.own_widths and config.hold == "charge":
            raise BoardError(
                "hold charge needs a pulse width of its own for each slot, and this board has "
                "one for all: choose energy"
            )
        if config.hold == "energy":
            note(
                f"Energy is held from {RESERVED:.0%} of the current on, so that it can rise where "
                "skin becomes wet: raise the intensity until it is as strong as you want."
            )
        adaptation = Adaptation(profile, config.hold, can.compliance_v, board.driver.timing)
    if config.balance:
        if can.recharges:
            recharge = RechargeRules.of(profile, board.driver.timing)
        elif len(can.polarities) < 2:
            raise BoardError(
                f"balance needs both polarities, and this board is {can.polarities[0]} only"
            )
        else:
            note(
                "This board makes no recharge phase: to balance, whole scans are reversed, and "
                "those drive the other class, SAI where RA is meant and RA where SAI is."
            )
        ledger = ChargeBalance(can.electrodes)
        ledger.charge_pc[:] = board.net_charge_pc
    return Regulator(adaptation, ledger, recharge)
