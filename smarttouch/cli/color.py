"""``smarttouch color``: a vibration as tactile primary colors."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from smarttouch.cli.option_groups import takes_options
from smarttouch.cli.run_options import RunOptions
from smarttouch.monitor.driving import drives_a_board

if TYPE_CHECKING:
    from smarttouch.afferent import Afferent
    from smarttouch.vibrotactile.split import Answer
    from smarttouch.vibrotactile.trace import Trace


@drives_a_board
@takes_options(scan="points")
def color(
    run: RunOptions,
    source: Annotated[
        str,
        typer.Argument(
            metavar="SPEC|CSV",
            help="What the skin is to feel, as in tone:30Hz,8um+press:0.5N (also noise:60-400Hz,3um"
            " and sweep:5-500Hz,5um, a part of the time as in tone:250Hz,2um@0.5-1), or a file "
            "with time_s and displacement_um or force_n, or frequency_hz and amplitude_um.",
        ),
    ],
    sites: Annotated[
        str | None,
        typer.Option(
            metavar="LIST",
            help="Electrodes that pulse, e.g. 27,28,35-36, or all.",
        ),
    ] = None,
    split_only: Annotated[
        bool, typer.Option("--split-only", help="Say what each class answers; no board.")
    ] = False,
    seed: Annotated[
        int, typer.Option(metavar="N", min=0, help="Of noise, and of phases a spectrum has not.")
    ] = 0,
    plot: Annotated[
        Path | None,
        typer.Option(metavar="PNG", help="Draw the trace, the answers and the pulses."),
    ] = None,
) -> None:
    """Split a vibration into what RA, SAI and PC answer, and let the finger feel it mixed again.

    It lasts 2 s, or as long as its file; intensity rises in the first half second.
    """
    from smarttouch.afferent import Afferent
    from smarttouch.files import require_folder
    from smarttouch.kernels.bank import load_bank
    from smarttouch.monitor.progress import bank_progress
    from smarttouch.reading.window import press_n
    from smarttouch.terminal import print_table
    from smarttouch.vibrotactile.crosstalk import pacinian_crosstalk
    from smarttouch.vibrotactile.mix import mix
    from smarttouch.vibrotactile.picture import picture
    from smarttouch.vibrotactile.report import as_figures, mixture_rows, notes
    from smarttouch.vibrotactile.sites import parse_places
    from smarttouch.vibrotactile.source import ColorSource
    from smarttouch.vibrotactile.spec import is_spec, open_trace
    from smarttouch.vibrotactile.split import split

    require_folder(plot)
    if plot is not None:
        from smarttouch.plotting import style

        style.require_drawable(plot)
    json_file = run.json_file
    trace = open_trace(source, 2.0 if run.seconds is None else run.seconds, seed)
    chosen = run.load_profile()
    answers = split(trace, sai_full_n=chosen.force.full_n, sai_rate_hz=chosen.pulse.sai_rate_hz)
    if split_only:
        _show_answers(run, trace, answers, source, plot)
        return
    with bank_progress(run.quiet) as progress:
        bank = load_bank(chosen, progress)
    places = parse_places(chosen, sites, None)
    shaken = run.vibrators is not None
    timing = run.display(chosen).board.timing
    mixture = mix(answers, trace.duration_s, chosen, bank, places, timing, shaken)
    seconds = None if is_spec(source) else run.seconds
    config = run.config(mixture.mode, seconds=seconds, seed=seed)
    vibration = ColorSource(source, chosen, mixture, press_n(chosen))
    vibration.url = source
    vibration.notes += notes(mixture, answers)
    crosstalk = None
    if mixture.pulses(Afferent.PC):
        crosstalk = pacinian_crosstalk(chosen, bank, mixture.sites)
        vibration.notes.append(str(crosstalk))
    run.start(vibration, chosen, config)
    if json_file is not None:
        _add(json_file, as_figures(answers, mixture, vibration, crosstalk))
    if plot is not None:
        style.save(picture(trace, answers, mixture), plot)
    if not run.quiet:
        print_table(
            mixture_rows(answers, mixture, vibration),
            ("class", "drive", "share", "fires at", "pulses", "at", "off by, ms"),
            title=f"{source}, at {len(mixture.sites)} sites",
            note="Pulses: sent to each site, and how many a second. Off by: from their own time, "
            "p50 / max.",
        )


def _show_answers(
    run: RunOptions,
    trace: "Trace",
    answers: "dict[Afferent, Answer]",
    source: str,
    plot: Path | None,
) -> None:
    """Draw, write and print the response of each class, as far as the options ask for it."""
    from smarttouch.files import write_json
    from smarttouch.plotting import style
    from smarttouch.terminal import print_table
    from smarttouch.vibrotactile.picture import picture
    from smarttouch.vibrotactile.report import answer_rows, as_figures

    if plot is not None:
        style.save(picture(trace, answers), plot)
    if run.json_file is not None:
        write_json(run.json_file, as_figures(answers))
    if not run.quiet:
        print_table(
            answer_rows(answers),
            ("class", "drive", "peak", "fires at", "share"),
            title=source,
            note="Drive: from threshold (0) to full (1), mean over the trace. Fires at: its "
            "afferents, while they do. Share: of the drive of all.",
        )


def _add(path: Path, figures: dict[str, object]) -> None:
    """Add the figures of the colors to those of the run."""
    from smarttouch.errors import SmartTouchError
    from smarttouch.files import parse_json, read_bytes, write_json

    write_json(path, parse_json(read_bytes(path, SmartTouchError)) | {"color": figures})
