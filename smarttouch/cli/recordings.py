"""``smarttouch recordings``: what is in a recording, see it, mend it, take it apart."""

from pathlib import Path
from typing import Annotated

import typer

from smarttouch.terminal import print_table

recordings = typer.Typer(
    help="Look into, view, repair and export what ``live --record`` kept.", no_args_is_help=True
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


@recordings.command()
def view(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE [OTHER]", help="One, or two side by side.")
    ],
    port: Annotated[
        int, typer.Option(metavar="N", help="Of the page; one that is free if none.")
    ] = 0,
    save: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write .png, .svg or .mp4, and show nothing."),
    ] = None,
    step: Annotated[
        int, typer.Option(metavar="N", min=0, help="Of the picture, or the film's first.")
    ] = 0,
) -> None:
    """Show recordings in a browser: time line, steps, slots, events (extra window)."""
    if save is None:
        from smarttouch.monitor.view import show_recordings

        show_recordings(files, port)
        return
    from smarttouch.errors import RecordingError
    from smarttouch.monitor.view import save_view

    if len(files) > 1:
        raise RecordingError(
            f"a view is saved of one recording, not of {len(files)}: give one", about="files"
        )
    save_view(files[0], save, step, None)
    print(save)
