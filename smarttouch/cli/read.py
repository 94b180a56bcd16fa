"""``smarttouch read``: text from a file under the finger, as letter shapes or as Braille."""

from typing import Annotated

import typer

from smarttouch.cli.option_groups import takes_options
from smarttouch.cli.options import ModeOption, RateOption
from smarttouch.cli.run_options import RunOptions
from smarttouch.cli.source_options import DocumentOptions, FormOptions
from smarttouch.cli.standard_input import or_standard_input
from smarttouch.monitor.driving import drives_a_board


@drives_a_board
@takes_options()
def read(
    feel: FormOptions,
    document: DocumentOptions,
    run: RunOptions,
    source: Annotated[
        str,
        typer.Argument(
            callback=or_standard_input,
            metavar="FILE",
            help="Page (image, PDF), .txt, Braille (.brf, .pef, photo), text:WORDS, - "
            "(standard input); ?dpi=300 and more.",
        ),
    ],
    lines: Annotated[int, typer.Option(help="Lines of Braille at once.")] = 1,
    pause_s: Annotated[float, typer.Option("--pause", metavar="S", help="After each line.")] = 1.0,
    wait: Annotated[bool, typer.Option("--wait", help="Go on at the right arrow only.")] = False,
    follow: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Source of finger positions."),
    ] = None,
    board: Annotated[
        str | None,
        typer.Option(metavar="URL", help="As for live."),
    ] = None,
    mode: ModeOption = "RA",
    rate_hz: RateOption = None,
) -> None:
    """Read a page with a fingertip, line by line.

    Keys: arrows for lines, r for once more, and those of live.
    """
    import contextlib
    from dataclasses import replace

    from smarttouch.cli.choices import parse_mode
    from smarttouch.monitor.progress import first_line_awaited
    from smarttouch.reading.cursor import Cursor, FollowingCursor, SweepingCursor
    from smarttouch.reading.feed import LineFeed
    from smarttouch.reading.line_source import ReadingSource
    from smarttouch.reading.source import Source
    from smarttouch.reading.window import press_n, profile_for_reading
    from smarttouch.sources import open_source

    run = replace(run, board=board or (None if run.frames is None else "simulated:"))
    own = run.load_profile()
    chosen = profile_for_reading(own)
    presentation = feel.presentation(own.defaults.read_as, lines, document.languages)
    motion = presentation.motion(chosen, feel.speed_mm_s, rate_hz)
    notes: list[str] = []
    text = Source(*document.recognition(source, scale_matters=follow is not None), notes.append)
    config = run.config(parse_mode(mode), rate_hz=rate_hz, tone=presentation.tone)
    with contextlib.ExitStack() as stack:
        feed = LineFeed(presentation.lines(text, chosen))
        stack.callback(feed.close)
        feed.start()
        first_line_awaited(lambda: feed.wait_for(0), run.quiet)
        cursor: Cursor
        if follow is None:
            cursor = SweepingCursor(feed, motion, press_n(chosen), pause_s, wait)
        else:
            cursor = FollowingCursor(feed, stack.enter_context(open_source(follow, own)))
        reading = ReadingSource(text.title, chosen, feed, cursor)
        reading.url, reading.notes = source, notes
        keys_help = "← → line    r again    "
        run.start(reading, chosen, config, keys=reading.keys, keys_help=keys_help)
