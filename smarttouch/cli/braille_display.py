"""``smarttouch braille-display``: the Braille display of the computer one already uses."""

from typing import Annotated, Any

import typer

from smarttouch.cli.option_groups import takes_options
from smarttouch.cli.options import ModeOption, RateOption
from smarttouch.cli.run_options import RunOptions
from smarttouch.monitor.driving import drives_a_board


@drives_a_board
@takes_options(scan="points")
def braille_display(
    run: RunOptions,
    address: Annotated[
        str,
        typer.Argument(
            metavar="[ADDRESS]",
            help="listen:PORT, where BRLTTY connects, or HOST:PORT, where it listens.",
        ),
    ] = "listen:35752",
    mode: ModeOption = "RA",
    rate_hz: RateOption = None,
    cells: Annotated[int, typer.Option(help="Width of the display.")] = 20,
    show: Annotated[
        str, typer.Option(metavar="HOW", help="line: cells move through; cell: one at a time.")
    ] = "line",
    speed_mm_s: Annotated[
        float | None, typer.Option("--speed", metavar="MM/S", help="Of the cells.")
    ] = None,
    pan: Annotated[
        bool, typer.Option("--pan", help="Go on by itself at the end of the window.")
    ] = False,
) -> None:
    """Be the Braille display of a running screen reader, by way of BRLTTY.

    Two commands, in two terminals:

        smarttouch braille-display

        sudo brltty -b vr -d client:

    The console is then under the finger, and through BrlAPI what Orca reads of a desktop.
    """
    from smarttouch.cli.choices import parse_mode
    from smarttouch.reading.window import profile_for_reading
    from smarttouch.sources import open_source

    chosen = profile_for_reading(run.load_profile())
    config = run.config(parse_mode(mode), rate_hz=rate_hz)
    options: dict[str, Any] = {
        "cells": cells,
        "show": show,
        "speed_mm_s": speed_mm_s,
        "pan": pan,
    }
    with open_source(f"brltty:{address}", chosen, **options) as source:
        run.start(source, chosen, config, keys=source.keys, keys_help=source.keys_help)
