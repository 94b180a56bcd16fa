"""Questions of the calibrations to someone at a terminal."""

import sys
from collections.abc import Iterator, Sequence

import typer

from smarttouch.calibrate.force_curve import parse_grams
from smarttouch.errors import CalibrationError


def missing(about: str, message: str) -> CalibrationError:
    """Return the error that nothing is given to measure with, which a simulation can stand for."""
    return CalibrationError(message, about=about, problem="missing", remedy="simulate")


def require_subject(simulate: bool, board_url: str) -> None:
    """Raise unless somebody can feel what a board does, and answer."""
    if simulate and not board_url.startswith(("emulator:", "simulated:", "memory:")):
        raise CalibrationError(
            f"a simulation answers for nobody: no current of its flows through {board_url!r}, only "
            "through emulator:",
            about="board",
            problem="conflict",
            value=board_url,
            allowed=("emulator:",),
        )
    if not simulate and not sys.stdin.isatty():
        raise missing("keyboard", "there is no keyboard to answer on: use a terminal, or simulate")


def ask(what: str, yes: bool) -> None:
    """Wait until something is in place."""
    if yes:
        return
    try:
        typer.prompt(f"{what} Then press Enter", default="", show_default=False)
    except typer.Abort:
        message = "nobody answered, nothing was written: use a terminal, or ask nothing"
        raise CalibrationError(message, about="answer", problem="missing", remedy="yes") from None


def weights_laid(listed: Sequence[float] | None, yes: bool) -> Iterator[float]:
    """Yield the grams that someone lays on a load cell: what is listed, or what is asked for."""
    for grams in listed or ():
        ask(f"{grams:g} g on the cell, at rest.", yes)
        yield grams
    while listed is None:
        try:
            answer = typer.prompt(
                "Grams on the cell, at rest (Enter: no more)", default="", show_default=False
            )
        except typer.Abort:
            message = "nobody answered, nothing was written: use a terminal, or give weights"
            raise CalibrationError(
                message, about="answer", problem="missing", remedy="weights"
            ) from None
        if not answer:
            return
        yield parse_grams(answer)[0]
