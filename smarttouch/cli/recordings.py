"""``smarttouch recordings``: what is in a recording, mend one, take one apart."""

from pathlib import Path
from typing import Annotated

import typer

from smarttouch.terminal import print_table

recordings = typer.Typer(
    help="Look into, repair and export what ``live --record`` kept.", no_args_is_help=True
)

_File = Annotated[Path, typer.Argument(metavar="FILE", help="A recording, whole or cut.")]


@recordings.command()
def info(file: _File) -> None:
    """Tell what was delivered to whom and when, and how much of it is kept."""
    from smarttouch.recording.account import describe

    print_table(describe(file), left=2)


@recordings.command()
def repair(
    file: _File,
    output: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The new file; one beside it if none.")
    ] = None,
) -> None:
    """Write a valid file of all that can be read; the old one stays as it is."""
    from smarttouch.recording.repair import is_sound
    from smarttouch.recording.repair import repair as write_anew

    if output is None and is_sound(file):
        print(f"{file} is whole: there is nothing to repair")
        return
    done = write_anew(file, output)
    damaged = f"; {done.damaged_chunks} damaged pieces left out" if done.damaged_chunks else ""
    print(f"{done.path}: {done.steps:,} sequences, {done.seconds:.1f} s{damaged}")


@recordings.command()
def export(
    file: _File,
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="A new or an empty one.")],
) -> None:
    """Write images as PNG, tables as CSV, and tactile images and sequences as NPZ."""
    from smarttouch.recording.export import export as write_out

    for path in write_out(file, folder):
        print(path)
