"""``smarttouch profiles``: what is shipped, and profiles of one's own."""

from pathlib import Path
from typing import Annotated

import typer

from smarttouch.terminal import print_table

profiles = typer.Typer(
    help="List the shipped profiles, show what one says, and make your own.",
    invoke_without_command=True,
)

_Name = Annotated[str, typer.Argument(metavar="NAME|FILE", help="A shipped profile, or a file.")]
_File = Annotated[Path, typer.Argument(metavar="FILE.toml", help="The profile.")]


@profiles.callback()
def list_profiles(context: typer.Context) -> None:
    if context.invoked_subcommand is not None:
        return
    from smarttouch.profile import DEFAULT_PROFILE, list_profiles, load_profile

    rows = []
    for name in list_profiles():
        profile = load_profile(name)
        star = " (default)" if name == DEFAULT_PROFILE else ""
        pulse = profile.pulse
        board = f"{profile.output.kind}, {pulse.width_us} µs, {pulse.rate_hz:g} Hz"
        rows.append((name + star, profile.title, board))
    print_table(
        rows,
        ("name", "what it is", "board"),
        note="Make your own with 'smarttouch profiles copy NAME FILE', and give its file to "
        "--profile.",
        left=3,
    )


@profiles.command()
def show(name: _Name) -> None:
    """Print all that a profile says, defaults included, and what calibrations measured."""
    from smarttouch.profile import load_profile
    from smarttouch.profile.written import as_toml

    typer.echo(as_toml(load_profile(name)), nl=False)


@profiles.command()
def copy(
    name: _Name,
    file: _File,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="The file may be there already.")
    ] = False,
) -> None:
    """Write a copy of a profile, with its comments, to be edited."""
    from smarttouch.calibrate.profile_file import ProfileFile

    copied = ProfileFile(name, file, overwrite)
    copied.write()
    typer.echo(f"written: {copied.output}")


@profiles.command()
def keys() -> None:
    """Print every key a profile may have: type, unit, default, limits and meaning."""
    from smarttouch.profile.keys import key_reference

    typer.echo(key_reference(), nl=False)
