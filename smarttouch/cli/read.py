"""``smarttouch read``, ``braille`` and ``braille-display``: text under a finger."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from smarttouch.base import terminal
from smarttouch.base.command_options import argument, option
from smarttouch.cli.options import MORE, ModeOption, RateOption, takes_options
from smarttouch.cli.run_options import RunOptionGroup
from smarttouch.cli.source_options import (
    DocumentOptions,
    FormOptions,
    TableOption,
    or_standard_input,
    table_of,
)
from smarttouch.views.keys_and_signals import drives_a_board

if TYPE_CHECKING:
    from smarttouch.braille.cell_pages import Loaded


@drives_a_board
@takes_options()
def read(
    feel: FormOptions,
    document: DocumentOptions,
    run: RunOptionGroup,
    source: Annotated[
        str,
        argument(
            "A page (image, PDF), a text, Braille (.brf, .pef, photo), words, or - for "
            "standard input. Options follow: 'book.pdf?pages=3-5&dpi=300'.",
            "FILE",
            callback=or_standard_input,
        ),
    ],
    pause_s: Annotated[
        float, option("Rest this long after each line; inf waits for a key.", "S", "--pause")
    ] = 1.0,
    follow: Annotated[
        str | None, option("Take the position of the finger from this source.", "URL", panel=MORE)
    ] = None,
    board: Annotated[
        str | None, option("Drive this board; smarttouch live --help names them.", "URL")
    ] = None,
    mode: ModeOption = "RA",
    rate_hz: RateOption = None,
) -> None:
    """Read a page with a fingertip, line by line.

    Keys: arrows choose a line, r repeats it, and those of live.
    """
    import contextlib
    from dataclasses import replace

    from smarttouch.cli.options import parse_mode
    from smarttouch.imaging.array_window import profile_for_reading, reading_force_n
    from smarttouch.reading.line_feed import LineFeed
    from smarttouch.reading.line_source import (
        Cursor,
        FollowingCursor,
        ReadingSource,
        SweepingCursor,
    )
    from smarttouch.reading.material import ReadingMaterial
    from smarttouch.sources import open_source
    from smarttouch.views.progress import first_line_awaited

    run = replace(run, board=board)
    own = run.load_profile()
    chosen = profile_for_reading(own)
    usual = own.defaults.plain or not (run.quiet or terminal.draws())
    plain = usual if run.plain is None else run.plain
    presentation, speed_mm_s = feel.presentation(
        own.defaults.read_as, document.languages, named=plain
    )
    motion = presentation.motion(chosen, speed_mm_s, rate_hz)
    wait = pause_s == math.inf
    notes: list[str] = []
    text = ReadingMaterial(
        *document.recognition(source, scale_matters=follow is not None), notes.append
    )
    config = run.config(parse_mode(mode), rate_hz=rate_hz, tone=presentation.tone)
    with contextlib.ExitStack() as stack:
        feed = LineFeed(presentation.lines(text, chosen))
        stack.callback(feed.close)
        feed.start()
        first_line_awaited(lambda: feed.wait_for(0), run.quiet)
        cursor: Cursor
        if follow is None:
            cursor = SweepingCursor(
                feed, motion, reading_force_n(chosen), 0.0 if wait else pause_s, wait
            )
        else:
            cursor = FollowingCursor(feed, stack.enter_context(open_source(follow, own)))
        reading = ReadingSource(text.title, chosen, feed, cursor)
        reading.url, reading.notes = source, notes
        keys_help = "← → line    r again    "
        run.start(
            reading, chosen, run.at_level(config, own), keys=reading.keys, keys_help=keys_help
        )


@takes_options()
def braille(
    document: DocumentOptions,
    source: Annotated[
        str | None,
        argument(
            "A file of text (HTML, EPUB, DOCX …), cells (.brf, .pef), print or Braille (image, "
            "PDF); a text, or text:WORDS where it could be a file; - for standard input.",
            "TEXT|FILE|-",
            callback=or_standard_input,
        ),
    ] = None,
    table: TableOption = None,
    back: Annotated[bool, option("Translate cells back into text.", None, "--back")] = False,
    output: Annotated[
        Path | None, option("Write a .brf, .pef or .txt file instead of printing.", "FILE")
    ] = None,
    columns: Annotated[
        int | None, option("Set the number of cells in a line, usually 40.", "N")
    ] = None,
    rows: Annotated[
        int | None, option("Set the number of lines on a page, usually 25.", "N")
    ] = None,
    leave_out: Annotated[
        bool, option("Leave out characters that the table has no cells for.", None, "--leave-out")
    ] = False,
    tables: Annotated[bool, option("List the Braille tables.", None, "--tables")] = False,
) -> None:
    """Translate text into Braille, or Braille into text."""
    from smarttouch.base.errors import BrailleError
    from smarttouch.base.files import require_folder, write_bytes
    from smarttouch.braille.cell_pages import (
        COLUMNS,
        INDENT,
        ROWS,
        lay_out,
        lay_out_blocks,
        load_cells,
        write_cells,
    )
    from smarttouch.braille.code_tables import open_table

    if tables:
        _print_tables()
        return
    if source is None:
        message = "nothing to read is given: give a text or a file, or list the tables"
        raise BrailleError(message, about="text", remedy="tables")
    require_folder(output)
    named = table_of(table, document.languages)
    code = open_table(named)
    seen = _seen(source, named, document, output)
    loaded = seen or load_cells(source, code, leave_out)
    for note in loaded.notes:
        typer.echo(note, err=True)
    if back:
        text = code.to_text("\n".join(loaded.paragraphs)) + "\n"
        if output is None:
            print(text, end="")
            return
        if output.suffix.lower() != ".txt":
            message = f"cannot write a text as {output}: give a name that ends in .txt"
            raise BrailleError(message, about="file")
        write_bytes(output, text.encode(), BrailleError)
        _forget_pages(seen, output)
        print(output)
        return
    pages = loaded.pages
    if loaded.shaped is not None and output is not None:
        wide = COLUMNS if columns is None else columns
        pages = lay_out_blocks(loaded.shaped, wide, ROWS if rows is None else rows)
    elif pages is None or columns is not None or rows is not None:
        # What is shown is not printed: there, paragraphs need no indent.
        indent = 0 if output is None else INDENT
        wide = COLUMNS if columns is None else columns
        pages = lay_out(loaded.paragraphs, wide, ROWS if rows is None else rows, indent)
    if output is None:
        print("\n".join(line for page in pages for line in page))
        return
    write_cells(output, pages, loaded.shaped.document if loaded.shaped else None)
    _forget_pages(seen, output)
    print(f"{output}: pages {len(pages)}, lines {sum(map(len, pages))}")


def _seen(
    source: str, table: str, document: DocumentOptions, output: Path | None
) -> "Loaded | None":
    """Return the cells of an image or a PDF; None for anything else."""
    from smarttouch.braille.cell_pages import Loaded, file_of
    from smarttouch.braille.cells import FileKind, file_kind
    from smarttouch.reading.braille_lines import Braille
    from smarttouch.reading.document_cells import document_cells
    from smarttouch.reading.material import ReadingMaterial

    place, options = document.recognition(source)
    file = file_of(place)
    if file is None or file_kind(file) is not FileKind.PAGES:
        return None
    notes: list[str] = []
    shown = ReadingMaterial(place, options, notes.append)
    found = document_cells(Braille(table), shown, lambda words: typer.echo(words, err=True), output)
    return Loaded(found, None, notes)


def _forget_pages(seen: "Loaded | None", output: Path) -> None:
    """Remove the pages that were kept for an output, which has them now."""
    if seen is not None:
        from smarttouch.reading.document_cells import forget_pages

        forget_pages(output)


def _print_tables() -> None:
    from smarttouch.base.terminal import print_table
    from smarttouch.braille import louis
    from smarttouch.braille.code_tables import DEFAULT_TABLE, known_tables

    version = louis.version()
    known = known_tables()
    print_table(
        [
            *(
                (name + " (default)" * (name == DEFAULT_TABLE), name.partition("-")[0], title)
                for name, title in known.items()
            ),
            *louis.table_files(),
        ],
        ("name", "language", "what it is"),
        note=f"Or any other file of liblouis {version}, or the tag of a language."
        if version
        else f"liblouis is not here: of these only en-1 and ja work. For all: {louis.INSTALL}",
        left=3,
    )


@drives_a_board
@takes_options()
def braille_display(
    run: RunOptionGroup,
    address: Annotated[
        str,
        argument(
            "listen:PORT, where BRLTTY connects, or HOST:PORT, where it listens. Options "
            "follow: 'listen:35752?cells=10&show=cell&speed_mm_s=60&pan'.",
            "[ADDRESS]",
        ),
    ] = "listen:35752",
    mode: ModeOption = "RA",
    rate_hz: RateOption = None,
) -> None:
    """Be the Braille display of a running screen reader, through BRLTTY.

    Two commands, in two terminals:

        smarttouch braille-display

        sudo brltty -b vr -d client:

    The finger then reads the console and, through BrlAPI, what Orca reads on a desktop.
    """
    from smarttouch.cli.options import parse_mode
    from smarttouch.imaging.array_window import profile_for_reading
    from smarttouch.sources import open_source

    chosen = profile_for_reading(run.load_profile())
    config = run.config(parse_mode(mode), rate_hz=rate_hz, scan="points")
    with open_source(f"brltty:{address}", chosen) as source:
        run.start(source, chosen, config, keys=source.keys, keys_help=source.keys_help)
