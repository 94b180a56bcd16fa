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
            help="grating:4mm,30deg, text:WORDS, an image (ink is high) or a height map (16 bits "
            "or .npy: bright is high). Options follow: wood.png?dpi=300&tiled; also width_mm, "
            "grain_mm, light_on_dark.",
        ),
    ] = "grating:4mm",
    motion: Annotated[
        str,
        typer.Option(
            metavar="URL",
            help="sweep: (a virtual hand), sweep:ROUNDS?speed_mm_s=40&seed=1, "
            "evdev:DEVICE?cpi=800&grab (a mouse), window: (the pointer), path:CSV, or a source "
            "that knows its pose, e.g. camera:0.",
        ),
    ] = "sweep:",
    mode: Annotated[
        str, typer.Option("--mode", metavar="CLASS", help="Class that answers: RA, SAI or PC.")
    ] = "RA",
    rate_hz: Annotated[
        float, typer.Option("--rate", metavar="HZ", help="Frames per second.")
    ] = 100.0,
) -> None:
    """Feel a texture that stays in place while the hand moves.

    Each electrode pulses when a ridge passes under it, and not at rest.
    """
    from smarttouch.cli.choices import parse_mode
    from smarttouch.reading.window import press_n, profile_for_reading
    from smarttouch.texture.source import MouseSource, open_motion_over
    from smarttouch.texture.textures import open_texture

    own, driven = run.load_profile(), parse_mode(mode)
    chosen = profile_for_reading(own)
    surface = open_texture(texture)
    with open_motion_over(surface, motion, own) as moves:
        source = MouseSource(surface, moves, chosen, driven, rate_hz, press_n=press_n(chosen))
        source.url = texture
        run.start(source, chosen, run.config(driven))
