"""``smarttouch mouse``: a texture under a hand that moves."""

from typing import Annotated

import typer

from smarttouch.cli.option_groups import takes_options
from smarttouch.cli.run_options import RunOptions
from smarttouch.monitor.driving import drives_a_board


@drives_a_board
@takes_options(scan="points")
def mouse(
    run: RunOptions,
    texture: Annotated[
        str,
        typer.Option(
            metavar="WHAT",
            help="grating:4mm,30deg, text:WORDS, or a file: an image (ink is high) or a height map "
            "(16 bits or .npy: bright is high). Options behind it: wood.png?dpi=300&tiled; "
            "width_mm, grain_mm, light_on_dark.",
        ),
    ] = "grating:4mm",
    motion: Annotated[
        str,
        typer.Option(
            metavar="URL",
            help="sweep: (a virtual hand), sweep:ROUNDS?speed_mm_s=40&seed=1, "
            "evdev:DEVICE?cpi=800&grab (a mouse), window: (the pointer), path:CSV, or a source's "
            "pose, as camera:0.",
        ),
    ] = "sweep:",
    speed_mm_s: Annotated[float | None, typer.Option("--speed", hidden=True)] = None,
    seed: Annotated[int | None, typer.Option(min=0, hidden=True)] = None,
    cpi: Annotated[float | None, typer.Option(hidden=True)] = None,
    grab: Annotated[bool, typer.Option("--grab", hidden=True)] = False,
    scale: Annotated[
        float, typer.Option(metavar="RATIO", help="Texture's millimeters for one of the hand.")
    ] = 1.0,
    dpi: Annotated[float | None, typer.Option(hidden=True)] = None,
    width_mm: Annotated[float | None, typer.Option(hidden=True)] = None,
    grain_mm: Annotated[float | None, typer.Option(hidden=True)] = None,
    tiled: Annotated[bool, typer.Option("--tiled", hidden=True)] = False,
    light_on_dark: Annotated[bool, typer.Option("--light-on-dark", hidden=True)] = False,
    mode: Annotated[
        str, typer.Option("--mode", metavar="CLASS", help="RA, SAI or PC feels the ridges.")
    ] = "RA",
    rate_hz: Annotated[
        float, typer.Option("--rate", metavar="HZ", help="Frames a second.")
    ] = 100.0,
    fastest_hz: Annotated[
        float | None,
        typer.Option(
            "--fastest",
            metavar="HZ",
            help="Most pulses a second; 100 if none, at most half the frames.",
        ),
    ] = None,
) -> None:
    """Feel a texture that stays where it is while the hand moves.

    Each electrode pulses when a ridge passes under it, and not at rest.
    """
    from smarttouch.cli.choices import parse_mode
    from smarttouch.reading.window import press_n, profile_for_reading
    from smarttouch.texture.source import MouseSource, open_motion_over
    from smarttouch.texture.textures import open_texture

    own = run.load_profile()
    chosen = profile_for_reading(own)
    config = run.config(parse_mode(mode), seed=seed or 0)
    surface = open_texture(
        texture,
        dpi=dpi,
        width_mm=width_mm,
        grain_mm=grain_mm,
        tiled=tiled,
        light_on_dark=light_on_dark,
    )
    options = {"speed_mm_s": speed_mm_s, "seed": seed, "cpi": cpi, "grab": grab or None}
    with open_motion_over(surface, motion, own, **options) as moves:
        source = MouseSource(
            surface,
            moves,
            chosen,
            parse_mode(mode),
            rate_hz,
            fastest_hz,
            scale,
            press_n(chosen),
        )
        source.url = texture
        run.start(source, chosen, config)
