"""``smarttouch sensor``: one sensor or load cell, looked at or played."""

from pathlib import Path
from typing import Annotated

import typer

from smarttouch.cli.options import ProfileOption
from smarttouch.emulator.commands import emulate_sensor
from smarttouch.terminal import print_table

sensor = typer.Typer(help="Look at one sensor or load cell, or play one.", no_args_is_help=True)
sensor.command("emulate")(emulate_sensor)


@sensor.command()
def show(
    url: Annotated[
        str,
        typer.Argument(
            metavar="URL",
            help="camera:N, video:FILE, serial-array:PORT, ...; with --force hx711:PORT, ...",
        ),
    ],
    seconds: Annotated[float, typer.Option(metavar="S", help="How long to look.")] = 2.0,
    force: Annotated[
        bool, typer.Option("--force", help="It is a source of finger force, not of frames.")
    ] = False,
    save: Annotated[Path | None, typer.Option(metavar="PNG", help="Keep the last frame.")] = None,
    profile: ProfileOption = None,
) -> None:
    """Say what comes from a sensor: frames, rate, size, force, and what went wrong."""
    import cv2

    from smarttouch.errors import SmartTouchError, require_within
    from smarttouch.files import require_folder, write_bytes
    from smarttouch.profile import DEFAULT_PROFILE, load_profile
    from smarttouch.sources import open_source
    from smarttouch.sources.forces.force import open_force
    from smarttouch.sources.look import look_at_force, look_at_frames

    require_within(SmartTouchError, "seconds", seconds, 0, 3600, above=True)
    require_folder(save)
    chosen = load_profile(profile or DEFAULT_PROFILE)
    if force:
        if save is not None:
            raise SmartTouchError("save is for frames: leave out force, or this", about="force")
        with open_force(url, chosen) as pressed:
            rows = look_at_force(pressed, seconds)
        print_table([*rows, *(("note", note) for note in pressed.notes)], left=2)
        return
    with open_source(url, chosen) as source:
        look = look_at_frames(source, seconds)
    notes = [("note", note) for note in source.notes]
    print_table([*look.rows(source), *notes], left=2)
    if save is not None and look.last is not None and look.last.image is not None:
        write_bytes(save, cv2.imencode(".png", look.last.image)[1].tobytes())
        typer.echo(f"The last frame is in {save}.")
