"""``smarttouch legibility``: how much of a text can still be read from what the skin got."""

from pathlib import Path
from typing import Annotated

import typer

from smarttouch.cli.option_groups import takes_options
from smarttouch.cli.options import (
    AnatomyOption,
    ArrayOption,
    ClusterOption,
    JsonOption,
    QuietOption,
    ScanOption,
)
from smarttouch.cli.source_options import DocumentOptions, FormOptions
from smarttouch.cli.standard_input import or_standard_input


@takes_options()
def legibility(
    feel: FormOptions,
    document: DocumentOptions,
    source: Annotated[
        str,
        typer.Argument(
            callback=or_standard_input,
            metavar="FILE",
            help="As for smarttouch read.",
        ),
    ],
    profile: ArrayOption = "electric-mouse",
    truth: Annotated[
        Path | None,
        typer.Option(metavar="FILE.txt", help="What the page says; what Tesseract reads if none."),
    ] = None,
    mode: Annotated[str, typer.Option(metavar="RA|SAI", help="Whose receptors.")] = "RA",
    fingers: Annotated[
        int, typer.Option(min=0, max=1000, metavar="N", help="Simulated fingers that feel it, too.")
    ] = 0,
    anatomy: AnatomyOption = "branched",
    json_file: JsonOption = None,
    scan: ScanOption = "auto",
    cluster: ClusterOption = None,
    quiet: QuietOption = False,
) -> None:
    """Measure it: the whole chain to a simulated board, and Tesseract on what the skin got."""
    from smarttouch.cli.choices import parse_choice, parse_mode
    from smarttouch.cluster import on_cluster
    from smarttouch.files import require_folder, write_json
    from smarttouch.kernels.bank import load_bank
    from smarttouch.monitor.progress import bank_progress, lines_progress
    from smarttouch.profile import load_profile
    from smarttouch.reading.deliver import Reading
    from smarttouch.reading.legibility import measure_legibility
    from smarttouch.reading.source import Source
    from smarttouch.reading.window import profile_for_reading
    from smarttouch.running.config import SCANS, RunConfig
    from smarttouch.terminal import print_table

    require_folder(json_file)
    chosen = profile_for_reading(load_profile(profile))
    notes: list[str] = []
    text = Source(*document.recognition(source), notes.append)
    presentation = feel.presentation(chosen.defaults.read_as)
    motion = presentation.motion(chosen, feel.speed_mm_s)
    with bank_progress(quiet) as progress:
        bank = load_bank(chosen, progress)
    sharing = RunConfig(scan=parse_choice("scan", scan, SCANS)).sharing(chosen)
    reading = Reading(chosen, bank, presentation.tone, motion, parse_mode(mode), sharing)
    with on_cluster(cluster), lines_progress(quiet) as advance:
        found = measure_legibility(text, reading, presentation, truth, advance, fingers, anatomy)
    figures = {"source": source, "profile": chosen.name, "notes": notes, **found.figures}
    if json_file is not None:
        write_json(json_file, figures)
    if not quiet:
        print_table(found.rows, left=2)
        typer.echo(f"\nWhat was read from the delivered pulses:\n{found.text}")
        for note in notes:
            typer.echo(note, err=True)
