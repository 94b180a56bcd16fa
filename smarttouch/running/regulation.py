"""Regulation of a run by the board's own measurements, as its configuration asks."""

from collections.abc import Callable

from smarttouch.boards.board import Board
from smarttouch.errors import BoardError
from smarttouch.profile import Profile
from smarttouch.running.config import RunConfig
from smarttouch.running.regulator import Regulator
from smarttouch.stimulation.adaptation import Adaptation, Hold
from smarttouch.stimulation.ledger import ChargeBalance
from smarttouch.stimulation.recharge import RechargeRules


def masked_where_broken(board: Board, profile: Profile, note: Callable[[str], None]) -> Profile:
    """Measure an open board; return the profile without its open and shorted electrodes.

    Raises BoardError if nothing touches the electrodes.
    """
    found = board.measure()
    if found.lifted:
        raise BoardError(
            "no electrode touches anything: put the finger on the array first", about="finger"
        )
    broken = sorted({*profile.output.masked, *found.broken})
    good, unsure = (found.condition.count(each) for each in ("good", "unsure"))
    note(
        f"{good} of {len(found.kohm)} electrodes are good"
        + (f", of {unsure} this board's readings cannot tell" if unsure else "")
        + (f"; planned without {broken}" if broken else "")
    )
    output = profile.output.model_dump() | {"masked": broken}
    return Profile.model_validate({**profile.model_dump(), "output": output})


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
                "hold needs a board that tells the voltage of each slot, and this one does not",
                about="hold",
            )
        if not board.timing.own_widths and config.hold == "charge":
            raise BoardError(
                "hold charge needs a pulse width of its own for each slot, and this board has "
                "one for all: choose energy",
                about="hold",
            )
        hold: Hold = "charge" if config.hold == "charge" else "energy"
        adaptation = Adaptation(profile, hold, can.compliance_v, board.timing)
    if config.balance:
        if can.recharges:
            recharge = RechargeRules.of(profile, board.timing)
        elif len(can.polarities) < 2:
            raise BoardError(
                f"balance needs both polarities, and this board is {can.polarities[0]} only",
                about="balance",
            )
        else:
            note(
                "This board makes no recharge phase: to balance, whole scans are reversed, and "
                "those drive the other class, SAI where RA is meant and RA where SAI is."
            )
        ledger = ChargeBalance(can.electrodes)
        ledger.charge_pc[:] = board.net_charge_pc
    return Regulator(adaptation, ledger, recharge)
