"""``smarttouch read``: text from a file under the finger, as letter shapes or as Braille."""

from typing import Annotated

import typer

from smarttouch.cli.driving import drives_a_board
from smarttouch.cli.options import (
    AsOption,
    CellsOption,
    FeltOption,
    ForceOption,
    FramesOption,
    IntensityOption,
    JsonOption,
    LanguageOption,
    MarkersOption,
    ModeOption,
    PagesOption,
    PasswordOption,
    ProfileOption,
    QuietOption,
    RateOption,
    RecordOption,
    ScanOption,
    SecondsOption,
    StyleOption,
    TableOption,
)


@drives_a_board
def read(
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
    profile: ProfileOption = None,
    mode: ModeOption = "RA",
    scan: ScanOption = "auto",
    force: ForceOption = None,
    intensity: IntensityOption = None,
    rate: RateOption = None,
    seconds: SecondsOption = None,
    frames: FramesOption = None,
    felt: FeltOption = None,
    record: RecordOption = None,
    markers: MarkersOption = False,
    json_file: JsonOption = None,
    quiet: QuietOption = False,
) -> None:
    """Read a page with a fingertip, line by line.

    Keys: right and left arrow for the next line and the one before, r for the line once more, space
    for a pause; and those of live.
    """
    import contextlib

    from smarttouch.boards.board import usual_profile
    from smarttouch.cli.files import parse_choice, parse_mode
    from smarttouch.cli.plan import Plan
    from smarttouch.cli.progress import first_line_awaited
    from smarttouch.cli.session import play
    from smarttouch.cli.sharing import parse_scan
    from smarttouch.profile import load_profile
    from smarttouch.reading.braille import Braille, Presentation
    from smarttouch.reading.cursor import Cursor, FollowingCursor, SweepingCursor
    from smarttouch.reading.feed import LineFeed
    from smarttouch.reading.printed import HowToLook
    from smarttouch.reading.sensor import ReadingSensor
    from smarttouch.reading.shapes import Shapes, Style
    from smarttouch.reading.source import Source
    from smarttouch.reading.window import press_n, profile_for_reading
    from smarttouch.sources import open_sensor
    from smarttouch.sources.forces.force import open_force

    board = board or ("emulator:" if frames is None else "simulated:")
    own = load_profile(profile or usual_profile(board))
    chosen = profile_for_reading(own)
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
    plan = Plan(
        sensor_url=source,
        board_url=board,
        mode=parse_mode(mode),
        sharing=parse_scan(scan, chosen),
        rate_hz=rate,
        seconds=seconds,
        level=intensity,
        force_url=force,
        tone=wanted.tone,
        frames=frames,
        felt=felt,
        record=record,
        markers=markers,
        json_file=json_file,
        quiet=quiet,
    )
    with contextlib.ExitStack() as stack:
        feed = LineFeed(wanted.lines(text, chosen))
        stack.callback(feed.close)
        first_line_awaited(feed.start(), quiet)
        cursor: Cursor
        if follow is None:
            cursor = SweepingCursor(feed, motion, press_n(chosen), pause, wait)
        else:
            cursor = FollowingCursor(feed, stack.enter_context(open_sensor(follow, own)))
        sensor = ReadingSensor(text.title, chosen, feed, cursor)
        sensor.notes = notes
        pressing = None if force is None else stack.enter_context(open_force(force, chosen))
        play(plan, sensor, pressing, chosen)
