"""``smarttouch experiment fit``: psychometric functions through answers, and what they say."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from smarttouch import terminal
from smarttouch.cli.options import JsonOption, QuietOption

if TYPE_CHECKING:
    from smarttouch.psychophysics.fitting.psychometric import Guess
    from smarttouch.psychophysics.fitting.table import Table
    from smarttouch.psychophysics.fitting.verdict import Finding


def fit(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE...", help="CSV files of answers, one of each condition."),
    ],
    x: Annotated[str, typer.Option("--x", metavar="COLUMN", help="What was shown.")] = "comparison",
    y: Annotated[
        str, typer.Option("--y", metavar="COLUMN", help="What was answered: 1, 0 or nothing.")
    ] = "success",
    standard: Annotated[
        str, typer.Option(metavar="COLUMN", help="What it was compared with, if anything.")
    ] = "standard",
    function: Annotated[
        str, typer.Option(metavar="normal|logistic|weibull", help="Shape of the curve.")
    ] = "normal",
    linear: Annotated[
        bool | None,
        typer.Option("--linear/--log", help="Its axis; found out from the comparisons if none."),
    ] = None,
    guess: Annotated[
        str | None,
        typer.Option(
            metavar="0..1|equal|free",
            help="Successes where nothing is known: 0.5 of two intervals; equal to the lapses; "
            "free; found out if none.",
        ),
    ] = None,
    lapse: Annotated[float, typer.Option(metavar="0..1", help="Most lapses.")] = 0.1,
    at: Annotated[
        float | None,
        typer.Option(
            metavar="0..1",
            help="Share of answers at the threshold; 0.75, or halfway from the guess.",
        ),
    ] = None,
    samples: Annotated[int, typer.Option(metavar="N", help="Of the bootstrap.")] = 1000,
    seed: Annotated[int, typer.Option(metavar="N", help="Of the bootstrap.")] = 0,
    plot: Annotated[
        Path | None, typer.Option(metavar="PNG|PDF|SVG", help="Draw shares and thresholds.")
    ] = None,
    json_file: JsonOption = None,
    quiet: QuietOption = False,
) -> None:
    """Fit answers: thresholds with intervals, or why there are none.

    Several files, of RA and PC mode for example, come into one table and one picture, under their
    names.
    """
    from dataclasses import replace

    from smarttouch.cli.choices import parse_choice
    from smarttouch.errors import ExperimentError, require_within
    from smarttouch.files import require_folder, write_json
    from smarttouch.plotting import style
    from smarttouch.plotting.discrimination import discrimination_figure
    from smarttouch.psychophysics.fitting.answers import usual_model
    from smarttouch.psychophysics.fitting.fit import BootstrapOptions
    from smarttouch.psychophysics.fitting.psychometric import Shape
    from smarttouch.psychophysics.fitting.report import as_figures, as_series
    from smarttouch.psychophysics.fitting.table import read_table
    from smarttouch.psychophysics.fitting.verdict import judge

    require_folder(json_file)
    require_folder(plot)
    if plot is not None:
        style.require_drawable(plot)
    require_within(ExperimentError, "samples", samples, 100, 100_000)
    require_within(ExperimentError, "seed", seed, 0, math.inf)
    bootstrap = BootstrapOptions(samples, seed)
    shape, guessed = parse_choice("function", function, Shape), _parse_guess(guess)
    found: list[tuple[Table, list[Finding]]] = []
    for path in files:
        table = read_table(path, x, y, standard)
        if sum(each.stem == path.stem for each in files) > 1:
            table = replace(table, name=str(path))
        axis = None if linear is None else not linear
        model = usual_model(table.answers, shape, guessed, axis, at, lapse)
        found.append((table, [judge(each, model, bootstrap) for each in table.answers]))
    if not quiet:
        _print(found)
    if json_file is not None:
        write_json(json_file, {table.name: as_figures(findings) for table, findings in found})
    if plot is not None:
        style.save(discrimination_figure([as_series(*each) for each in found]), plot)


def _parse_guess(text: str | None) -> "Guess | None":
    from smarttouch.errors import ExperimentError

    if text is None:
        return None
    if text == "equal":
        return "equal"
    if text == "free":
        return "free"
    try:
        return float(text)
    except ValueError:
        message = f"guess {text!r} is not offered: give a share such as 0.5, equal or free"
        raise ExperimentError(message, about="guess") from None


def _print(found: Sequence[tuple["Table", list["Finding"]]]) -> None:
    from smarttouch.psychophysics.fitting.report import threshold_rows
    from smarttouch.terminal import print_table

    console = terminal.console(highlight=False)
    for table, findings in found:
        console.print(f"{table.name}{', ' * bool(table.unit)}{table.unit}", style="bold")
        compares = any(each.answers.standard for each in findings)
        heading, *rows = threshold_rows([each for each in findings if not each.verdict], compares)
        if rows:
            print_table(rows, heading, left=0)
        for each in findings:
            about = f"{each.answers.standard:g}: " if compares else ""
            if each.verdict is not None:
                console.print(f"{about}no threshold: {each.verdict}", soft_wrap=True)
            for note in each.notes:
                console.print(f"{about}{note}", style="dim", soft_wrap=True)
