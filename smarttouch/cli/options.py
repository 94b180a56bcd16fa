"""Options that several commands take, each said once."""

from pathlib import Path
from typing import Annotated

import typer

BOARD = "The board"
FINGER = "The finger"
KEPT = "What is kept"

ProfileOption = Annotated[
    str | None,
    typer.Option("--profile", metavar="NAME|FILE", help="Device and finger; the usual if none."),
]
ArrayOption = Annotated[
    str,
    typer.Option("--profile", metavar="NAME|FILE", help="Device and finger; see: profiles."),
]
ModeOption = Annotated[str, typer.Option("--mode", metavar="CLASS", help="RA, SAI, PC or natural.")]
RateOption = Annotated[
    float | None,
    typer.Option("--rate", metavar="HZ", help="Sequences a second."),
]
JsonOption = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", rich_help_panel=KEPT, help="Figures of the run."),
]


def _seed(value: int) -> int:
    if value < 0:
        raise typer.BadParameter(f"the seed {value} must be 0 or more")
    return value


FingerOption = Annotated[
    int,
    typer.Option(
        "--finger",
        metavar="SEED",
        rich_help_panel=KEPT,
        callback=_seed,
        show_default=False,
        help="Whose afferents are drawn, or judge.",
    ),
]
ForceOption = Annotated[
    str | None,
    typer.Option(
        "--force",
        metavar="URL",
        rich_help_panel=FINGER,
        help="hx711:, loadcell:, or fixed:N where unmeasured.",
    ),
]
AnatomyOption = Annotated[
    str,
    typer.Option(
        "--anatomy",
        metavar="NAME|FILE",
        show_default=False,
        help="Of simulated fingers: branched or paper.",
    ),
]
ClusterOption = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Dask scheduler that does the work: tcp://HOST:8786."),
]
QuietOption = Annotated[bool, typer.Option("--quiet", help="Show nothing but errors.")]
ScanOption = Annotated[
    str,
    typer.Option(
        "--scan",
        metavar="HOW",
        rich_help_panel=BOARD,
        help="Slots: points, frame or auto.",
    ),
]
