"""``smarttouch read``: text from a file under the finger, as letter shapes or as Braille."""

from typing import Annotated

import typer

from smarttouch.cli.driving import drives_a_board
from smarttouch.cli.options import (
    AsOption,
    CellsOption,
    LanguageOption,
    ModeOption,
    PagesOption,
    PasswordOption,
    RateOption,
    StyleOption,
    TableOption,
)
from smarttouch.cli.run_options import RunOptions, takes_run_options


@drives_a_board
@takes_run_options()
def read(
    run: RunOptions,
    source: Annotated[
        str,
        typer.Argument(
            metavar="FILE|text:WORDS",
            help="An image or PDF of a page, a .txt file, Braille (.brf, .pef, a photograph), or "
            "text: and words.",
        ),
    ],
    kind: AsOption = "shapes",
    style: StyleOption = "graded",
    table: TableOption = "en-1",
    cells: CellsOption = "line",
    lines: Annotated[int, typer.Option(help="Lines of Braille under the finger at once.")] = 1,
    embossed: Annotated[
        bool | None,
        typer.Option(
            "--embossed/--printed", help="Whether the image shows raised dots; found out if none."
        ),
    ] = None,
    light_from: Annotated[
        float | None,
        typer.Option(metavar="DEG", help="Where the light on raised dots comes from."),
    ] = None,
    language: LanguageOption = "eng",
    pages: PagesOption = None,
    dpi: Annotated[float | None, typer.Option(help="Resolution of the image.")] = None,
    page_width_mm: Annotated[float | None, typer.Option(help="Or the width of its page.")] = None,
    password: PasswordOption = None,
    light_on_dark: Annotated[
        bool | None,
        typer.Option(
            "--light-on-dark/--dark-on-light", help="How the print is; found out if none."
        ),
    ] = None,
    speed: Annotated[
        float | None,
        typer.Option(metavar="MM/S", help="Of the text under the finger; four pulses a pitch."),
    ] = None,
    pause: Annotated[float, typer.Option(metavar="S", help="After each line.")] = 1.0,
    wait: Annotated[
        bool, typer.Option("--wait", help="After each line, until the right arrow is pressed.")
    ] = False,
    follow: Annotated[
        str | None,
        typer.Option(metavar="URL", help="A sensor that tells where the finger is on the page."),
    ] = None,
    board: Annotated[
        str | None,
        typer.Option(
            metavar="URL",
            help="As for live; simulated: waits for nothing. With --frames that, else emulator:",
        ),
    ] = None,
    mode: ModeOption = "RA",
    rate: RateOption = None,
) -> None:
    """Read a page with a fingertip, line by line.

    Keys: right and left arrow for the next line and the one before, r for the line once more, space
    for a pause; and those of live.
    """
    import contextlib
    from dataclasses import replace

    from smarttouch.cli.files import parse_choice, parse_mode
    from smarttouch.cli.progress import first_line_awaited
    from smarttouch.cli.session import run_in_terminal
    from smarttouch.reading.braille import Braille, Presentation
    from smarttouch.reading.cursor import Cursor, FollowingCursor, SweepingCursor
    from smarttouch.reading.feed import LineFeed
    from smarttouch.reading.printed import HowToLook
    from smarttouch.reading.sensor import ReadingSensor
    from smarttouch.reading.shapes import Shapes, Style
    from smarttouch.reading.source import Source
    from smarttouch.reading.window import press_n, profile_for_reading
    from smarttouch.sources import open_sensor

    run = replace(run, board=board or (None if run.frames is None else "simulated:"))
    own = run.load_profile()
    chosen, outputs = profile_for_reading(own), run.outputs()
    wanted: Shapes | Braille
    if parse_choice("--as", kind, ("shapes", "braille")) == "shapes":
        wanted = Shapes(parse_choice("--style", style, Style))
    else:
        presentation = parse_choice("--cells", cells, Presentation)
        wanted = Braille(table, presentation, lines, embossed, light_from)
    motion = wanted.motion(chosen, speed, rate)
    look = HowToLook(
        pages, dpi, page_width_mm, password, light_on_dark, language, follow is not None
    )
    notes: list[str] = []
    text = Source(source, look, notes.append)
    config = run.config(parse_mode(mode), rate_hz=rate, tone=wanted.tone)
    with contextlib.ExitStack() as stack:
        feed = LineFeed(wanted.lines(text, chosen))
        stack.callback(feed.close)
        first_line_awaited(feed.start(), run.quiet)
        cursor: Cursor
        if follow is None:
            cursor = SweepingCursor(feed, motion, press_n(chosen), pause, wait)
        else:
            cursor = FollowingCursor(feed, stack.enter_context(open_sensor(follow, own)))
        sensor = ReadingSensor(text.title, chosen, feed, cursor)
        sensor.url, sensor.notes = source, notes
        force = run.open_force(chosen, stack)
        run_in_terminal(
            sensor,
            run.display(chosen),
            config,
            outputs,
            force=force,
            keys=sensor.keys,
            keys_help="← →  line    r  again    ",
        )
