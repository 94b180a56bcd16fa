"""``smarttouch color``: a vibration as tactile primary colors."""

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from smarttouch import terminal
from smarttouch.cli.driving import drives_a_board
from smarttouch.cli.run_options import RunOptions, takes_run_options

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from smarttouch.primary import Primary
    from smarttouch.profile import Profile
    from smarttouch.vibrotactile.mix import Mixture
    from smarttouch.vibrotactile.sensor import ColorSensor
    from smarttouch.vibrotactile.split import Answer
    from smarttouch.vibrotactile.trace import Trace

    Answers = dict[Primary, Answer]


@drives_a_board
@takes_run_options(scan="points")
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
        typer.Option(metavar="LIST", help="Electrodes that pulse, as in 27,28,35-36, or all."),
    ] = None,
    radius_mm: Annotated[
        float | None,
        typer.Option(metavar="MM", help="Or those so near to the middle; one pitch if none."),
    ] = None,
    split_only: Annotated[
        bool, typer.Option("--split-only", help="Say what each class answers; no board.")
    ] = False,
    seed: Annotated[
        int, typer.Option(min=0, help="Of noise, and of phases a spectrum has not.")
    ] = 0,
    plot: Annotated[
        Path | None,
        typer.Option(metavar="PNG", help="Draw the trace, the answers and the pulses."),
    ] = None,
) -> None:
    """Split a vibration into what RA, SAI and PC answer, and let the finger feel it mixed again.

    It lasts 2 s, or as long as its file. The first half second is weaker: intensity rises as in
    every run.
    """
    import contextlib

    from smarttouch.cli.files import require_folder, write_json
    from smarttouch.cli.progress import bank_progress
    from smarttouch.cli.session import run_in_terminal
    from smarttouch.kernels.bank import load_bank
    from smarttouch.primary import Primary
    from smarttouch.reading.window import press_n
    from smarttouch.vibrotactile.mix import mix
    from smarttouch.vibrotactile.price import pacinian_price
    from smarttouch.vibrotactile.report import as_figures, notes
    from smarttouch.vibrotactile.sensor import ColorSensor
    from smarttouch.vibrotactile.spec import is_spec, open_trace
    from smarttouch.vibrotactile.split import split

    require_folder(plot)
    if plot is not None:
        from smarttouch.plotting import style

        style.require_drawable(plot)
    outputs, json_file = run.outputs(), run.json_file
    trace = open_trace(source, 2.0 if run.seconds is None else run.seconds, seed)
    chosen = run.load_profile()
    answers = split(trace, sai_full_n=chosen.force.full_n, sai_rate_hz=chosen.pulse.sai_rate_hz)
    if split_only:
        if plot is not None:
            _draw(plot, trace, answers)
        if json_file is not None:
            write_json(json_file, as_figures(answers))
        if not run.quiet:
            _print_answers(source, answers)
        return
    with bank_progress(run.quiet) as progress:
        bank = load_bank(chosen, progress)
    display = run.display(chosen)
    places = _places(chosen, sites, radius_mm)
    shaken = run.vibrators is not None
    timing = display.board.timing
    mixture = mix(answers, trace.duration_s, chosen, bank, places, timing, shaken)
    seconds = None if is_spec(source) else run.seconds
    config = run.config(mixture.mode, seconds=seconds, seed=seed)
    sensor = ColorSensor(source, chosen, mixture, press_n(chosen) if run.pressed else math.nan)
    sensor.url = source
    sensor.notes += notes(mixture, answers)
    price = None
    if mixture.pulses(Primary.PC):
        price = pacinian_price(chosen, bank, mixture.sites)
        sensor.notes.append(str(price))
    with contextlib.ExitStack() as stack:
        force = run.open_force(chosen, stack)
        run_in_terminal(sensor, display, config, outputs, force=force)
    if json_file is not None:
        _add(json_file, as_figures(answers, mixture, sensor, price))
    if plot is not None:
        _draw(plot, trace, answers, mixture)
    if not run.quiet:
        _print_mixture(source, answers, mixture, sensor)


def _places(
    profile: "Profile", sites: str | None, radius_mm: float | None
) -> "NDArray[np.intp] | list[int]":
    from smarttouch.errors import SmartTouchError
    from smarttouch.vibrotactile.sites import disc

    if sites is not None and radius_mm is not None:
        message = "--sites and --radius-mm both say what pulses: give one of them"
        raise SmartTouchError(
            message, about="--sites", problem="conflict", value=("--sites", "--radius-mm")
        )
    if radius_mm is not None and not radius_mm >= 0:
        message = f"--radius-mm {radius_mm:g} is not possible: give 0 or more"
        raise SmartTouchError(message, about="--radius-mm", value=radius_mm, allowed=0)
    if sites is None:
        return disc(profile, radius_mm)
    if sites == "all":
        return profile.driven
    named: list[int] = []
    for part in sites.split(","):
        found = re.fullmatch("([0-9]{1,6})(?:-([0-9]{1,6}))?", part.strip())
        if found is None:
            message = f"--sites {sites!r} is no list: write 27,28,35-36, or all"
            raise SmartTouchError(message, about="--sites", problem="malformed", value=sites)
        low, high = int(found[1]), int(found[2] or found[1])
        # The first site that there is not is refused; those after it need no room.
        named += range(low, min(high, max(low, len(profile.electrodes))) + 1)
    return named


def _add(path: Path, figures: dict[str, object]) -> None:
    """Put what is known of the colors beside the figures of the run."""
    from smarttouch.cli.files import write_json
    from smarttouch.errors import SmartTouchError
    from smarttouch.files import parse_json, read_bytes

    write_json(path, parse_json(read_bytes(path, SmartTouchError)) | {"color": figures})


def _draw(path: Path, trace: "Trace", answers: "Answers", mixture: "Mixture | None" = None) -> None:
    import numpy as np

    from smarttouch.plotting.colors import ClassRow, color_figure
    from smarttouch.plotting.style import save
    from smarttouch.primary import Primary

    rows = {}
    for primary, answer in answers.items():
        which = np.empty(0, np.intp)
        shaken = mixture is not None and mixture.vibrated and primary is Primary.PC
        if mixture is not None:
            everything = np.arange(len(mixture.time_us))
            which = everything if shaken else mixture.carried.get(primary, which)
            pulse_s, drive = mixture.time_us[which] / 1e6, mixture.drive[which, primary]
        else:
            pulse_s = drive = np.empty(0)
        rows[primary] = ClassRow(answer.drive, pulse_s, drive.astype(np.float64), shaken)
    figure = color_figure(trace.time_s, trace.displacement_um, trace.force_n, rows, trace.title)
    save(figure, path)


def _print_answers(source: str, answers: "Answers") -> None:
    from smarttouch.vibrotactile.report import answered

    _print_table(
        source,
        ("class", "drive", "peak", "fires at", "share"),
        [
            (
                primary.name,
                f"{row.mean_drive:.2f}",
                f"{row.peak_drive:.2f}",
                f"{row.rate_hz:.1f} Hz" if row.rate_hz else "–",
                f"{row.share:.0%}",
            )
            for primary, row in answered(answers).items()
        ],
        "Drive: from threshold (0) to full (1), mean over the trace. Fires at: its afferents, "
        "while they do. Share: of the drive of all.",
    )


def _print_mixture(
    source: str, answers: "Answers", mixture: "Mixture", sensor: "ColorSensor"
) -> None:
    from smarttouch.vibrotactile.report import answered, sent_out

    sent = sent_out(mixture, sensor)
    rows = []
    for primary, row in answered(answers).items():
        cells = ["–", "–", "–"]
        if primary in sent:
            out = sent[primary]
            off = f"{out.off_p50_us / 1000:.2f} / {out.off_max_us / 1000:.2f}"
            cells = [f"{out.pulses}", f"{out.rate_hz:.1f} Hz", off]
        elif mixture.vibrated and row.share:
            cells[0] = "vibrated"
        fires = f"{row.rate_hz:.1f} Hz" if row.rate_hz else "–"
        rows.append((primary.name, f"{row.mean_drive:.2f}", f"{row.share:.0%}", fires, *cells))
    _print_table(
        f"{source}, at {len(mixture.sites)} sites",
        ("class", "drive", "share", "fires at", "pulses", "at", "off by, ms"),
        rows,
        "Pulses: sent to each site, and how many a second. Off by: from their own time, p50 / max.",
    )


def _print_table(
    title: str, heading: tuple[str, ...], rows: list[tuple[str, ...]], note: str
) -> None:
    from rich.table import Table

    table = Table(*heading, title=title, title_justify="left", box=None, pad_edge=False)
    for column in table.columns[1:]:
        column.justify = "right"
    for row in rows:
        table.add_row(*row)
    console = terminal.console()
    console.print(table)
    console.print(note, style="dim")
