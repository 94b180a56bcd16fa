"""Options that several commands take."""

from pathlib import Path
from typing import Annotated

import typer

BOARD = "The board"
FINGER = "The finger"
KEPT = "What is kept"

ProfileOption = Annotated[
    str | None,
    typer.Option("--profile", metavar="NAME|FILE", help="Device and finger; else the board's."),
]
ArrayOption = Annotated[
    str,
    typer.Option("--profile", metavar="NAME|FILE", help="Device and finger; see 'profiles'."),
]
ModeOption = Annotated[str, typer.Option("--mode", metavar="CLASS", help="RA, SAI, PC or natural.")]
RateOption = Annotated[
    float | None, typer.Option("--rate", metavar="HZ", help="Scan sequences per second.")
]
JsonOption = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", rich_help_panel=KEPT, help="Write the results as JSON."),
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
        help="Seed of the simulated finger.",
    ),
]
ForceOption = Annotated[
    str | None,
    typer.Option(
        "--force",
        metavar="URL",
        rich_help_panel=FINGER,
        help="hx711:PORT, loadcell:PORT, or stated: fixed:N.",
    ),
]
AnatomyOption = Annotated[
    str,
    typer.Option(
        "--anatomy",
        metavar="NAME|FILE",
        show_default=False,
        help="Simulated fingers: branched or paper.",
    ),
]
ClusterOption = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Dask scheduler to compute on: tcp://HOST:8786."),
]
QuietOption = Annotated[bool, typer.Option("--quiet", help="Print errors only.")]
ScanOption = Annotated[
    str,
    typer.Option(
        "--scan",
        metavar="HOW",
        rich_help_panel=BOARD,
        help="Points in a slot: points, frame, auto.",
    ),
]
