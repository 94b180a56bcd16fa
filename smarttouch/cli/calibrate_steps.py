"""Options of every calibration, its questions to someone at a terminal, and its end."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from smarttouch.cli.option_groups import OptionGroup
from smarttouch.errors import CalibrationError

if TYPE_CHECKING:
    from smarttouch.calibrate.profile_file import ProfileFile


@dataclass(frozen=True, kw_only=True)
class CalibrationOptions(OptionGroup):
    """Options of every calibration."""

    output: Annotated[
        Path | None, typer.Option(metavar="FILE.toml", help="The profile to write.")
    ] = None
    profile: Annotated[
        str | None, typer.Option(metavar="NAME|FILE", help="What a new --output starts from.")
    ] = None
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Measure what --output has already.")
    ] = False

    def start(self, board_url: str) -> str:
        """Return the profile to start from; a board's usual one if none was given."""
        from smarttouch.boards.open import default_profile

        return self.profile or default_profile(board_url)

    def begun(self) -> str:
        """Return the profile to start from: that given, or the output if it exists."""
        from smarttouch.profile import DEFAULT_PROFILE

        there = self.output is not None and self.output.exists()
        return self.profile or (str(self.output) if there else DEFAULT_PROFILE)

    def file(self, part: str, simulated: bool, board_url: str | None = None) -> "ProfileFile":
        """Return the profile file that a calibration reads and writes."""
        from smarttouch.boards.open import default_profile
        from smarttouch.calibrate.profile_file import file_to_calibrate
        from smarttouch.profile import DEFAULT_PROFILE

        if self.output is None:
            raise CalibrationError("give a file FILE.toml for what is measured", about="output")
        usual = DEFAULT_PROFILE if board_url is None else default_profile(board_url)
        return file_to_calibrate(
            part, self.profile, usual, self.output, self.overwrite, simulated=simulated
        )


def missing(about: str, message: str) -> CalibrationError:
    """Return the error that nothing is given to measure with but could be simulated."""
    return CalibrationError(message, about=about, remedy="simulate")


def ask(what: str, yes: bool) -> None:
    """Wait until the user has put something in place."""
    if not yes:
        _answer(f"{what} Then press Enter", "yes")


def weights_laid(listed: Sequence[float] | None, yes: bool) -> Iterator[float]:
    """Yield the grams that a user lays on a load cell: those listed, or those typed in."""
    from smarttouch.calibrate.force_curve import parse_grams

    for grams in listed or ():
        ask(f"{grams:g} g on the cell, at rest.", yes)
        yield grams
    while listed is None:
        answer = _answer("Grams on the cell, at rest (Enter: no more)", "weights")
        if not answer:
            return
        yield parse_grams(answer)[0]


def _answer(question: str, remedy: str) -> str:
    try:
        return str(typer.prompt(question, default="", show_default=False))
    except typer.Abort:
        message = "nobody answered, nothing was written: use a terminal, or give it beforehand"
        raise CalibrationError(message, about="answer", remedy=remedy) from None


def finish(
    file: "ProfileFile",
    what: str,
    found: str,
    simulated: bool,
    others: dict[Path, bytes] | None = None,
) -> None:
    """Write the profile; print what was found and the paths."""
    told = f"simulated: {found}" if simulated else found
    file.note(what, told)
    file.write(others)
    typer.echo(told)
    typer.echo("written: " + ", ".join(str(each) for each in (*(others or {}), file.output)))
