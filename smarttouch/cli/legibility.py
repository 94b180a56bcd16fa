"""``smarttouch legibility``: how much of a text can still be read from what the skin got."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from smarttouch import terminal
from smarttouch.cli.options import (
    AsOption,
    CellsOption,
    JsonOption,
    LanguageOption,
    PagesOption,
    PasswordOption,
    QuietOption,
    ScanOption,
    StyleOption,
    TableOption,
)

if TYPE_CHECKING:
    from smarttouch.reading.braille import Braille
    from smarttouch.reading.deliver import Reading
    from smarttouch.reading.shapes import Shapes
    from smarttouch.reading.source import Source

Figures = dict[str, Any]


def legibility(
    source: Annotated[
        str, typer.Argument(metavar="FILE|text:WORDS", help="As for smarttouch read.")
    ],
    profile: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="Device and finger.")
    ] = "electric-mouse",
    truth: Annotated[
        Path | None,
        typer.Option(metavar="FILE.txt", help="What the page says; what Tesseract reads if none."),
    ] = None,
    kind: AsOption = "shapes",
    style: StyleOption = "graded",
    table: TableOption = "en-1",
    cells: CellsOption = "line",
    language: LanguageOption = "eng",
    pages: PagesOption = None,
    password: PasswordOption = None,
    mode: Annotated[str, typer.Option(metavar="RA|SAI", help="Whose receptors.")] = "RA",
    speed: Annotated[
        float | None, typer.Option(metavar="MM/S", help="Of the text under the finger.")
    ] = None,
    json_file: JsonOption = None,
    scan: ScanOption = "auto",
    quiet: QuietOption = False,
) -> None:
    """Measure it: the whole chain to a simulated board, and Tesseract on what the skin got."""
    from smarttouch.cli.files import (
        parse_choice,
        parse_mode,
        require_folder,
        write_json,
    )
    from smarttouch.cli.progress import bank_progress
    from smarttouch.kernels.bank import load_bank
    from smarttouch.profile import load_profile
    from smarttouch.reading.braille import Braille, Presentation
    from smarttouch.reading.deliver import Reading
    from smarttouch.reading.printed import HowToLook
    from smarttouch.reading.shapes import Shapes, Style
    from smarttouch.reading.source import Source
    from smarttouch.reading.window import profile_for_reading
    from smarttouch.running.config import SCANS, RunConfig

    require_folder(json_file)
    chosen = profile_for_reading(load_profile(profile))
    notes: list[str] = []
    text = Source(source, HowToLook(pages, password=password, languages=language), notes.append)
    as_shapes = parse_choice("--as", kind, ("shapes", "braille")) == "shapes"
    shapes = Shapes(parse_choice("--style", style, Style))
    braille = Braille(table, parse_choice("--cells", cells, Presentation))
    wanted = shapes if as_shapes else braille
    motion = wanted.motion(chosen, speed)
    with bank_progress(quiet) as progress:
        bank = load_bank(chosen, progress)
    sharing = RunConfig(scan=parse_choice("--scan", scan, SCANS)).sharing(chosen)
    reading = Reading(chosen, bank, wanted.tone, motion, parse_mode(mode), sharing)
    if as_shapes:
        figures = _of_shapes(text, shapes, reading, truth, quiet)
    else:
        figures = _of_braille(text, braille, reading, quiet)
    figures = {"source": source, "profile": chosen.name, "notes": notes, **figures}
    if json_file is not None:
        write_json(json_file, figures)
    if not quiet:
        for note in notes:
            typer.echo(note, err=True)


def _of_shapes(
    text: "Source", shapes: "Shapes", reading: "Reading", truth: Path | None, quiet: bool
) -> Figures:
    from dataclasses import asdict

    from smarttouch.braille.files import read_text
    from smarttouch.cli.progress import lines_progress
    from smarttouch.reading.legibility import legibility_of_shapes
    from smarttouch.reading.window import require_rows, rows_of

    require_rows(reading.profile, text.note)
    said = text.words if truth is None else read_text(truth)
    with lines_progress(quiet) as progress:
        found = legibility_of_shapes(text, reading, shapes, said, progress)
    if not quiet:
        page = "-" if found.page_error_rate is None else f"{found.page_error_rate:.3f}"
        rows = (
            ("characters", len(found.truth)),
            ("lines", found.lines),
            ("error rate, page", page),
            ("error rate, sampling limit", f"{found.sampling_limit:.3f}"),
            ("error rate, felt", f"{found.character_error_rate:.3f}"),
        )
        _print(rows, found.text)
    return {
        "as": "shapes",
        "style": shapes.style.value,
        "rows": rows_of(reading.profile),
        "speed_mm_s": reading.motion.speed_mm_s,
        **asdict(found),
    }


def _of_braille(text: "Source", braille: "Braille", reading: "Reading", quiet: bool) -> Figures:
    from dataclasses import asdict

    from smarttouch.cli.progress import lines_progress
    from smarttouch.reading.legibility import legibility_of_braille

    with lines_progress(quiet) as progress:
        found = legibility_of_braille(text, reading, braille, progress)
    if not quiet:
        rows = (
            ("cells", found.cells),
            ("lines", found.lines),
            ("error rate, felt", f"{found.cell_error_rate:.3f}"),
        )
        _print(rows, found.delivered if found.text is None else found.text)
    return {
        "as": "braille",
        "table": braille.table,
        "cells_as": braille.presentation.value,
        "speed_mm_s": reading.motion.speed_mm_s,
        **asdict(found),
    }


def _print(rows: tuple[tuple[str, object], ...], text: str) -> None:
    from rich.table import Table

    table = Table.grid(padding=(0, 2))
    for name, value in rows:
        table.add_row(name, str(value))
    console = terminal.console()
    console.print(table)
    console.print("\nWhat was read from the delivered pulses:", style="dim")
    console.print(text, highlight=False)
