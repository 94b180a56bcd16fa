"""``smarttouch simulate``: pages on a simulated board, and studies of simulated fingers."""

from pathlib import Path
from typing import Annotated

import typer

from smarttouch.cli.options import (
    ArrayOption,
    Commands,
    JsonOption,
    ModeOption,
    argument,
    option,
    or_standard_input,
    parse_mode,
    takes_options,
)
from smarttouch.cli.read import DocumentOptions

simulate: Commands = Commands(
    help="Run a page on a simulated board, or a study on simulated fingers.",
    no_args_is_help=True,
)


@simulate.command("page")
@takes_options
def simulate_page(
    document: DocumentOptions,
    source: Annotated[
        str,
        argument(
            "A page, a text file or words, as for smarttouch read.",
            "FILE",
            callback=or_standard_input,
        ),
    ],
    profile: ArrayOption = "electric-mouse",
    truth: Annotated[
        Path | None,
        option("Compare with this text (default: read the page with Tesseract).", "FILE.txt"),
    ] = None,
    mode: ModeOption = "RA",
    json_file: JsonOption = None,
) -> None:
    """Run a page on a simulated board and read the result with Tesseract."""
    from smarttouch.base.files import write_json
    from smarttouch.imaging.reading_profile import profile_for_reading, rows_of
    from smarttouch.kernels.bank import load_bank
    from smarttouch.pages.text_documents import read_plain_text
    from smarttouch.profile import load_profile
    from smarttouch.reading.legibility import LineDelivery, legibility_of_shapes
    from smarttouch.reading.letter_shapes import Shapes
    from smarttouch.reading.reading_material import ReadingMaterial
    from smarttouch.running.config import RunConfig
    from smarttouch.views.printable_output import print_table
    from smarttouch.views.progress import bank_progress, progress

    chosen = profile_for_reading(load_profile(profile))
    notes: list[str] = []
    text = ReadingMaterial(*document.recognition(source), notes.append)
    shapes = Shapes()
    with bank_progress() as advance:
        bank = load_bank(chosen, advance)
    reading = LineDelivery(
        chosen, bank, shapes.tone, shapes.motion(chosen), parse_mode(mode),
        RunConfig().sharing(chosen),
    )  # fmt: skip
    true_text = text.words if truth is None else read_plain_text(truth)
    with progress() as advance:
        legibility = legibility_of_shapes(text, reading, true_text, advance)
    if json_file is not None:
        about = {"source": source, "profile": chosen.name, "rows": rows_of(chosen), "notes": notes}
        write_json(json_file, about | vars(legibility))
    print_table([
        ("characters", str(len(legibility.truth))), ("lines", str(legibility.lines)),
        ("error rate, page", "-" if true_text is None else f"{legibility.page_error_rate:.3f}"),
        ("error rate, delivered", f"{legibility.character_error_rate:.3f}"),
    ], left=2)  # fmt: skip
    typer.echo(f"\nText recognized from the delivered pulses:\n{legibility.text}")
    for note in notes:
        typer.echo(note, err=True)


@simulate.command()
def study(
    plan: Annotated[Path, argument("Plan of the study.", "STUDY.toml")],
    output: Annotated[Path, option("Write to this folder, or continue the study there.", "DIR")],
    cluster: Annotated[
        str | None,
        option("Compute on the Dask cluster with this scheduler, tcp://HOST:8786.", "ADDRESS"),
    ] = None,
) -> None:
    """Run or continue a study that varies fingers, profiles, modes, scans and letters."""
    from smarttouch.experiments.simulated_study import (
        ROWS_FILE,
        TABLE_NOTE,
        load_study,
        on_cluster,
        run_study,
        study_sums,
        study_table,
    )
    from smarttouch.views.printable_output import print_table
    from smarttouch.views.progress import bank_progress, progress

    asked = load_study(plan)
    with (
        on_cluster(cluster),
        bank_progress() as designing,
        progress("Fingers") as advance,
    ):
        rows = run_study(asked, plan.parent, output, designing, advance)
    heading, lines = study_table(study_sums(rows))
    print(asked.title)
    print_table(lines, heading, left=2)
    print(TABLE_NOTE)
    print(output / ROWS_FILE)
