"""``smarttouch mouse``: a texture under a hand that moves."""

from typing import Annotated

import typer

from smarttouch.cli.driving import drives_a_board
from smarttouch.cli.option_groups import takes_options
from smarttouch.cli.run_options import RunOptions
from smarttouch.cli.saved import SavedSettings


@drives_a_board
@takes_options(scan="points")
def mouse(
    context: typer.Context,
    run: RunOptions,
    saved: SavedSettings,
    texture: Annotated[
        str,
        typer.Option(
            metavar="FILE|grating:PITCH|text:WORDS",
            help="What lies under the hand: an image (ink is high), a height map (16 bits or .npy: "
            "bright is high), grating:4mm,30deg, or letters of 12 mm.",
        ),
    ] = "grating:4mm",
    motion: Annotated[
        str,
        typer.Option(
            metavar="URL",
            help="How the hand moves: sweep: (a virtual one), sweep:ROUNDS, evdev:DEVICE (a "
            "mouse), window: (the pointer), path:CSV, or a sensor's pose, as camera:0.",
        ),
    ] = "sweep:",
    speed: Annotated[
        float | None, typer.Option(metavar="MM/S", help="Of the virtual hand; 40 if not given.")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Let the virtual hand tremble, always the same way.")
    ] = None,
    cpi: Annotated[
        float | None, typer.Option(help="Counts per inch of the mouse; 800 if not given.")
    ] = None,
    grab: Annotated[
        bool, typer.Option("--grab", help="Keep the mouse from all other programs.")
    ] = False,
    scale: Annotated[
        float, typer.Option(metavar="RATIO", help="Texture's millimeters for one of the hand.")
    ] = 1.0,
    dpi: Annotated[
        float | None, typer.Option(help="Resolution of a texture that does not say.")
    ] = None,
    width_mm: Annotated[float | None, typer.Option(help="Or its width.")] = None,
    grain_mm: Annotated[
        float | None,
        typer.Option(help="Way from pulse to pulse on wide high ground; measured if none."),
    ] = None,
    tiled: Annotated[bool, typer.Option("--tiled", help="Repeat the texture without end.")] = False,
    light_on_dark: Annotated[
        bool, typer.Option("--light-on-dark", help="Turn high and low.")
    ] = False,
    mode: Annotated[
        str, typer.Option("--mode", metavar="RA|SAI|PC", help="Which class feels the ridges.")
    ] = "RA",
    rate: Annotated[float, typer.Option(metavar="HZ", help="Frames a second.")] = 100.0,
    fastest: Annotated[
        float | None,
        typer.Option(
            metavar="HZ",
            help="Most pulses a second of an electrode; 100 if none, at most half the frames.",
        ),
    ] = None,
) -> None:
    """Feel a texture that stays where it is while the hand moves.

    Each electrode pulses when a ridge passes under it: spatial frequency times speed times a
    second, and nothing at rest.
    """
    import contextlib

    from smarttouch.cli.files import parse_mode
    from smarttouch.cli.session import run_in_terminal
    from smarttouch.reading.window import press_n, profile_for_reading
    from smarttouch.texture.source import MouseSource, open_motion_over
    from smarttouch.texture.textures import open_texture

    own = run.load_profile()
    chosen, outputs = profile_for_reading(own), run.outputs()
    config = run.config(parse_mode(mode), seed=seed or 0)
    surface = open_texture(
        texture,
        dpi=dpi,
        width_mm=width_mm,
        grain_mm=grain_mm,
        tiled=tiled,
        light_on_dark=light_on_dark,
    )
    with contextlib.ExitStack() as stack:
        moves = stack.enter_context(
            open_motion_over(
                surface, motion, own, speed_mm_s=speed, seed=seed, cpi=cpi, grab=grab or None
            )
        )
        sensor = MouseSource(
            surface,
            moves,
            chosen,
            parse_mode(mode),
            rate,
            fastest,
            scale,
            press_n(chosen) if run.pressed else None,
        )
        sensor.url = texture
        force = run.open_force(chosen, stack)
        saved.keep(context)
        run_in_terminal(sensor, run.display(chosen), config, outputs, force=force)
