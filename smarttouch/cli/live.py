"""``smarttouch live``: from a source to current in the skin."""

from typing import Annotated

import typer

from smarttouch.cli.option_groups import takes_options
from smarttouch.cli.options import ModeOption, RateOption
from smarttouch.cli.run_options import RunOptions
from smarttouch.cli.standard_input import or_standard_input
from smarttouch.monitor.driving import drives_a_board


@drives_a_board
@takes_options()
def live(
    run: RunOptions,
    source: Annotated[
        str | None,
        typer.Option(
            callback=or_standard_input,
            metavar="URL",
            help="page:, text:, camera:, video:, frames:, serial-array:, brltty:, draw:, osc: or "
            "recording: and a place; options follow: page:a.png?dpi=300&speed_mm_s=40",
        ),
    ] = None,
    mode: ModeOption = "RA",
    rate_hz: RateOption = None,
    seed: Annotated[
        int | None, typer.Option(metavar="N", min=0, help="Seed of all simulated noise.")
    ] = None,
    light_on_dark: Annotated[
        bool,
        typer.Option("--light-on-dark", show_default=False, help="Print is lighter than paper."),
    ] = False,
) -> None:
    """Show on the finger what a source sees, until it ends, a key or Ctrl-C."""
    from smarttouch.cli.choices import parse_mode
    from smarttouch.resources import data_folder
    from smarttouch.sources import open_source

    chosen = run.load_profile()
    config = run.config(
        parse_mode(mode), rate_hz=rate_hz, light_on_dark=light_on_dark, seed=seed or 0
    )
    url = source or f"page:{data_folder('sample_images') / 'page.png'}"
    with open_source(url, chosen, light_on_dark=light_on_dark, seed=seed) as opened:
        run.start(opened, chosen, config, keys=opened.keys, keys_help=opened.keys_help)
