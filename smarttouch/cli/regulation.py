"""What ``smarttouch live`` does with a board's own measurements."""

import typer

from smarttouch.boards.board import Board
from smarttouch.errors import BoardError, SmartTouchError
from smarttouch.profile import Profile
from smarttouch.regulator import Regulator
from smarttouch.stimulation.adaptation import Adaptation
from smarttouch.stimulation.ledger import ChargeLedger
from smarttouch.stimulation.recharge import RechargeRules


def masked_where_broken(board: Board, profile: Profile, quiet: bool) -> Profile:
    """Measure an open board; return the profile without its open and shorted electrodes.

    Raises
    ------
    BoardError
        If nothing touches the electrodes.
    """
    found = board.measure()
    if found.lifted:
        raise BoardError("no electrode touches anything: put the finger on the array first")
    broken = sorted({*profile.output.masked, *found.broken})
    if not quiet:
        good, unsure = (found.condition.count(each) for each in ("good", "unsure"))
        typer.echo(
            f"{good} of {len(found.kohm)} electrodes are good"
            + (f", of {unsure} this board's readings cannot tell" if unsure else "")
            + (f"; planned without {broken}" if broken else "")
        )
    output = profile.output.model_dump() | {"masked": broken}
    return Profile.model_validate({**profile.model_dump(), "output": output})


def make_regulator(
    board: Board, profile: Profile, hold: str | None, balance: bool, quiet: bool
) -> Regulator:
    """Return what ``--hold`` and ``--balance`` ask for on an open board.

    Raises
    ------
    SmartTouchError
        If the board cannot do it.
    """
    can = board.capabilities
    if can.time_to_zero_ms is None and not quiet:
        typer.echo(
            "This board goes on with its last pattern if its line breaks: keep its switch within "
            "reach.",
            err=True,
        )
    adaptation = ledger = recharge = None
    if hold is not None:
        if hold not in ("charge", "energy"):
            raise SmartTouchError(f"--hold {hold!r} is not offered: choose charge or energy")
        if not can.measures or can.compliance_v is None:
            raise BoardError(
                "--hold needs a board that tells the voltage of each slot, and this one does not"
            )
        if not board.timing.own_widths and hold == "charge":
            raise BoardError(
                "--hold charge needs a pulse width of its own for each slot, and this board has "
                "one for all: choose --hold energy"
            )
        adaptation = Adaptation(
            profile, "charge" if hold == "charge" else "energy", can.compliance_v, board.timing
        )
    if balance:
        if can.recharges:
            recharge = RechargeRules.of(profile, board.timing)
        elif len(can.polarities) < 2:
            raise BoardError(
                f"--balance needs both polarities, and this board is {can.polarities[0]} only"
            )
        elif not quiet:
            typer.echo(
                "This board makes no recharge phase: --balance reverses whole scans, and those "
                "drive the other class, SAI where RA is meant and RA where SAI is.",
                err=True,
            )
        ledger = ChargeLedger(can.electrodes)
    return Regulator(adaptation, ledger, recharge)
