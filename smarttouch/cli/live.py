"""``smarttouch live``: from a sensor to current in the skin."""

from pathlib import Path
from typing import Annotated

import typer

from smarttouch.cli.driving import drives_a_board
from smarttouch.cli.options import ModeOption, RateOption
from smarttouch.cli.run_options import RunOptions, takes_run_options
from smarttouch.cli.saved import SaveOption, UseOption, keep, used_tone


@drives_a_board
@takes_run_options()
def live(
    run: RunOptions,
    sensor: Annotated[
        str | None,
        typer.Option(
            metavar="URL",
            help="page:FILE, text:STRING, camera:N, video:FILE, frames:FOLDER, serial-array:PORT, "
            "recording:FILE; a sample page if not given.",
        ),
    ] = None,
    mode: ModeOption = "RA",
    rate: RateOption = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Of the virtual finger's and sensor's noise.")
    ] = None,
    dpi: Annotated[
        float | None, typer.Option(help="Resolution of a page file that does not say.")
    ] = None,
    page_width_mm: Annotated[float | None, typer.Option(help="Or the width of its page.")] = None,
    speed: Annotated[
        float | None,
        typer.Option(metavar="MM/S", help="Of the virtual finger along a line; 40 if not given."),
    ] = None,
    path: Annotated[
        Path | None,
        typer.Option(metavar="CSV", help="A recorded path: time_s,x_mm,y_mm,angle_deg,force_n"),
    ] = None,
    size: Annotated[
        str | None, typer.Option(metavar="WxH", help="Of a camera's frames, 640x480.")
    ] = None,
    exposure: Annotated[
        float | None, typer.Option(help="Of a camera, in its driver's own unit.")
    ] = None,
    fps: Annotated[
        float | None, typer.Option(metavar="HZ", help="Of a camera, or of a folder of frames.")
    ] = None,
    unpaced: Annotated[
        bool, typer.Option("--unpaced", help="Every frame of a file, none passed over.")
    ] = False,
    baud: Annotated[int | None, typer.Option(help="Of a serial array.")] = None,
    light_on_dark: Annotated[bool, typer.Option(help="Print is lighter than paper.")] = False,
    save: SaveOption = None,
    settings: UseOption = None,
) -> None:
    """Let a finger feel what a sensor sees, until the page ends, a key or Ctrl-C."""
    import contextlib

    from smarttouch.cli.files import parse_mode, parse_size
    from smarttouch.cli.session import run_in_terminal
    from smarttouch.resources import data_folder
    from smarttouch.sources import open_sensor

    chosen, outputs = run.load_profile(), run.outputs()
    options = {
        "seed": seed,
        "dpi": dpi,
        "page_width_mm": page_width_mm,
        "speed_mm_s": speed,
        "path": path,
        "size": parse_size(size),
        "exposure": exposure,
        "fps": fps,
        "unpaced": unpaced or None,
        "baud": baud,
    }
    config = run.config(
        parse_mode(mode),
        rate_hz=rate,
        light_on_dark=light_on_dark,
        seed=seed or 0,
        tone=used_tone(settings),
    )
    with contextlib.ExitStack() as stack:
        source = stack.enter_context(
            open_sensor(
                sensor or f"page:{data_folder('sample_images') / 'page.png'}",
                chosen,
                light_on_dark=light_on_dark,
                **options,
            )
        )
        force = run.open_force(chosen, stack)
        display = run.display(chosen)
        # All that is kept has been opened once.
        keep(save, settings, run, config, sensor, options)
        run_in_terminal(source, display, config, outputs, force=force)
