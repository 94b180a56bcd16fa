"""``smarttouch simulate``: letters and pages on simulated fingers, and choices compared."""

from pathlib import Path
from typing import Annotated

import typer

from smarttouch.base.command_options import argument, option
from smarttouch.cli.options import (
    AnatomyOption,
    ArrayOption,
    ClassOption,
    ClusterOption,
    Commands,
    JsonOption,
    ModeOption,
    QuietOption,
    ScanOption,
    takes_options,
)
from smarttouch.cli.source_options import DocumentOptions, FormOptions, or_standard_input

_NAMES = {
    "silent_points": "silent points",
    "wrong_class": "spikes of another class",
    "misplaced": "misplaced spikes",
    "median": "error rate at the nerve, median",
    "worst_tenth": "error rate at the nerve, worst tenth",
    "nociceptive": "current over full comfort at which a pain fiber fires (a rough model)",
}


simulate: Commands = Commands(
    help="Put letters, pages or a whole study on simulated fingers.", no_args_is_help=True
)


@simulate.command("letters")
def simulate_letters(
    letters: Annotated[str | None, argument("The letters; A to Z otherwise.", "LETTERS")] = None,
    profile: ArrayOption = "electric-mouse",
    mode: ClassOption = "RA",
    anatomy: AnatomyOption = "branched",
    fingers: Annotated[
        int, option("Simulate this many fingers, with seeds from 1 on.", "N", min=1, max=1000)
    ] = 10,
    plot_file: Annotated[
        str | None, option("Draw the first letter on finger 1.", "PNG", "--plot")
    ] = None,
    json_file: JsonOption = None,
    quiet: QuietOption = False,
) -> None:
    """Put letters on simulated fingers; show which afferents fire and what is recognized."""
    from smarttouch.base.afferent import Mode
    from smarttouch.base.files import require_folder, write_json
    from smarttouch.base.terminal import print_table
    from smarttouch.cli.options import parse_afferent
    from smarttouch.kernels.bank import load_bank
    from smarttouch.physiology.finger import Finger
    from smarttouch.physiology.response import middle_90
    from smarttouch.profile import load_profile
    from smarttouch.reading import letter_responses
    from smarttouch.reading.letter_responses import bystander_margins
    from smarttouch.reading.letter_shapes import parse_letters
    from smarttouch.views.progress import lines_progress

    chosen, driven = load_profile(profile), Mode(parse_afferent(mode).name)
    drawn = parse_letters(letters, 1)
    picture = None if plot_file is None else Path(plot_file)
    for output in (json_file, picture):
        require_folder(output)
    bank = load_bank(chosen)
    with lines_progress(quiet, "Feeling letters") as progress:
        found = letter_responses.respond_to_letters(
            chosen, bank, driven, anatomy, range(1, fingers + 1), drawn, progress
        )
    figures = letter_responses.summary(found)
    at_board = letter_responses.error_at_board(chosen, bank, driven, drawn)
    by_finger = letter_responses.finger_means(found)
    middle = {name: middle_90(each)[1:] for name, each in by_finger.items()}
    margin = bystander_margins(chosen, bank, driven, anatomy, range(1, fingers + 1), drawn)
    figures["nociceptive"] = margin["nociceptive"]
    if json_file is not None:
        at_nerve = {each: figures.pop(each) for each in ("median", "worst_tenth")}
        write_json(
            json_file,
            {
                "profile": chosen.name, "mode": driven.value, "anatomy": anatomy,
                "fingers": fingers, "letters": drawn,
                "fired": letter_responses.fired(found),
                **figures, "at_board": at_board, "at_nerve": at_nerve, "middle_90": middle,
            },
        )  # fmt: skip
        figures |= at_nerve
    if picture is not None:
        from smarttouch.views.figure_style import save
        from smarttouch.views.kernel_figures import letter_figure

        sequence, active = letter_responses.letter_sequence(drawn[0], chosen, bank, driven)
        save(letter_figure(Finger(chosen, 1, anatomy), sequence, active), picture)
    if not quiet:
        rows = [("error rate at the board", f"{at_board:.3f}")]
        for name, value in figures.items():
            spread = " ({:.3f} to {:.3f})".format(*middle[name]) if name in middle else ""
            rows.append((_NAMES[name], f"{value:.3f}{spread}"))
        print_table(rows, left=1, note="In brackets: middle 90 % of the fingers.")


@simulate.command("page")
@takes_options()
def simulate_page(
    feel: FormOptions,
    document: DocumentOptions,
    source: Annotated[
        str,
        argument(
            "A page, a text, Braille or words, as for smarttouch read.",
            "FILE",
            callback=or_standard_input,
        ),
    ],
    profile: ArrayOption = "electric-mouse",
    truth: Annotated[
        Path | None,
        option(
            "Compare with this text; with what Tesseract reads on the page otherwise.", "FILE.txt"
        ),
    ] = None,
    mode: ModeOption = "RA",
    fingers: Annotated[
        int, option("Let this many simulated fingers read it, too.", "N", min=0, max=1000)
    ] = 0,
    anatomy: AnatomyOption = "branched",
    json_file: JsonOption = None,
    scan: ScanOption = None,
    cluster: ClusterOption = None,
    quiet: QuietOption = False,
) -> None:
    """Run a page on a simulated board and read the result with Tesseract."""
    from smarttouch.base.errors import choice_of
    from smarttouch.base.files import require_folder, write_json
    from smarttouch.base.lazy_names import on_cluster
    from smarttouch.base.terminal import print_table
    from smarttouch.cli.options import parse_mode
    from smarttouch.imaging.array_window import profile_for_reading
    from smarttouch.kernels.bank import load_bank
    from smarttouch.profile import load_profile
    from smarttouch.reading.delivered_lines import LineDelivery
    from smarttouch.reading.legibility import measure_legibility
    from smarttouch.reading.material import ReadingMaterial
    from smarttouch.running.config import SCANS, RunConfig
    from smarttouch.views.progress import bank_progress, lines_progress

    require_folder(json_file)
    chosen = profile_for_reading(load_profile(profile))
    notes: list[str] = []
    text = ReadingMaterial(*document.recognition(source), notes.append)
    presentation, speed_mm_s = feel.presentation(chosen.defaults.read_as)
    motion = presentation.motion(chosen, speed_mm_s)
    with bank_progress(quiet) as progress:
        bank = load_bank(chosen, progress)
    sharing = RunConfig(scan=choice_of("scan", scan or "auto", SCANS)).sharing(chosen)
    reading = LineDelivery(chosen, bank, presentation.tone, motion, parse_mode(mode), sharing)
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


@simulate.command()
def study(
    plan: Annotated[
        Path, argument("The plan: what is compared, and on which fingers.", "STUDY.toml")
    ],
    output: Annotated[
        Path, option("Write to this folder; a study that is there continues.", "DIR")
    ],
    cluster: ClusterOption = None,
    quiet: QuietOption = False,
) -> None:
    """Run a grid of fingers, profiles, modes, scans, letters and pages, or continue one."""
    from importlib.util import find_spec

    from smarttouch.base.lazy_names import on_cluster
    from smarttouch.base.terminal import print_table
    from smarttouch.experiments.study_plan import load_study
    from smarttouch.experiments.study_run import (
        ROWS_FILE,
        STUDY_NAMES,
        TABLE_NOTE,
        run_study,
        study_figure,
        study_sums,
        study_table,
    )
    from smarttouch.views import figure_style
    from smarttouch.views.progress import bank_progress, lines_progress

    asked = load_study(plan)
    with (
        on_cluster(cluster),
        bank_progress(quiet) as designing,
        lines_progress(quiet, "Fingers") as progress,
    ):
        rows = run_study(asked, plan.parent, output, designing, progress)
    sums, made = study_sums(rows), [output / ROWS_FILE]
    if find_spec("matplotlib"):
        made.append(output / "study.png")
        figure_style.save(study_figure(sums, STUDY_NAMES, asked.title), made[-1])
    if not quiet:
        heading, lines = study_table(sums)
        print_table(lines, heading, title=asked.title, note=TABLE_NOTE, ruled=True, left=2)
        print(*made, sep="\n")
