"""``smarttouch experiment``: psychophysics with pulses, from a list of experiments or freely."""

from pathlib import Path
from typing import Annotated

import typer

from smarttouch.cli.option_groups import takes_options
from smarttouch.cli.run_command import RunCommand
from smarttouch.cli.run_options import RunOptions
from smarttouch.monitor.driving import drives_a_board

experiment = typer.Typer(
    help="Psychophysics: what a finger can tell of pulses (paper, Section III).",
    no_args_is_help=True,
)

_Mode = Annotated[str, typer.Option("--mode", metavar="CLASS", help="RA, SAI or PC.")]
_Site = Annotated[
    int | None, typer.Option("--site", metavar="N", help="Electrode; in the middle if none.")
]
_Overwrite = Annotated[bool, typer.Option("--overwrite", help="Begin the CSV file anew.")]
_Session = Annotated[str, typer.Option("--session", metavar="NAME", help="Which session.")]
_Output = Annotated[
    Path | None,
    typer.Option("--output", metavar="CSV", help="Answers; named by subject if none."),
]


@experiment.command("list")
def list_all() -> None:
    """Show which experiments there are."""
    from smarttouch.psychophysics.catalog import CATALOG

    for name, entry in CATALOG.items():
        typer.echo(f"{name:13} {entry.about} [{', '.join(entry.methods)}]")
    typer.echo(f"{'free':13} turn amplitude, rate and mode by hand: smarttouch experiment free")


@experiment.command("run", cls=RunCommand)
@drives_a_board
@takes_options(scan="points", anatomy="paper")
def run_listed(
    run: RunOptions,
    name: Annotated[str, typer.Argument(metavar="NAME", help="See smarttouch experiment list.")],
    mode: _Mode = "RA",
    procedure: Annotated[
        str | None,
        typer.Option(metavar="HOW", help="constant, staircase or questplus."),
    ] = None,
    standards: Annotated[
        str | None, typer.Option(metavar="LIST", help="Of frequency, Hz, as in 15,30,45.")
    ] = None,
    repetitions: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Of each condition (constant).")
    ] = None,
    trials: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Most of each standard (adaptive).")
    ] = None,
    letters: Annotated[
        str | None, typer.Option(metavar="LIST", help="Of letters, as in AEIOU; all if none.")
    ] = None,
    two_intervals: Annotated[
        bool, typer.Option("--two-intervals", help="Detection: in which of two.")
    ] = False,
    site: _Site = None,
    rate_hz: Annotated[
        float | None,
        typer.Option("--rate", metavar="HZ", help="Of pulses, where not asked about."),
    ] = None,
    train_s: Annotated[float | None, typer.Option(metavar="S", help="Length of trains.")] = None,
    gap_s: Annotated[float, typer.Option(metavar="S", help="Between two intervals.")] = 0.5,
    answer_s: Annotated[
        float, typer.Option(metavar="S", help="Longest wait for an answer; 0: no end.")
    ] = 10.0,
    session: _Session = "",
    seed: Annotated[
        int | None,
        typer.Option(metavar="N", help="Of orders; by subject if none."),
    ] = None,
    output: _Output = None,
    overwrite: _Overwrite = False,
    simulate: Annotated[
        str | None,
        typer.Option(
            metavar="WHO",
            help="model, random, first or silent, no person.",
        ),
    ] = None,
    board: Annotated[
        str | None,
        typer.Option(metavar="URL", help="As for live; with --simulate simulated:"),
    ] = None,
) -> None:
    """Run an experiment of the list; the same command again goes on where it was.

    Keys: the answers that the screen names, r for the trial once more, and those of live; q to
    go on another time.
    """
    from dataclasses import replace

    from smarttouch.cli.choices import parse_afferent, parse_choice, require_answers
    from smarttouch.cli.experiment_steps import sit
    from smarttouch.errors import ExperimentError
    from smarttouch.psychophysics.catalog import ExperimentOptions, design
    from smarttouch.psychophysics.rows import About
    from smarttouch.psychophysics.sitting import (
        numbered,
        open_sitting,
        parse_standards,
        usual_name,
    )
    from smarttouch.psychophysics.timing import TrialTiming

    if simulate is not None:
        simulate = parse_choice("simulate", simulate, ("model", "random", "first", "silent"))
    run = replace(run, board=board or (None if simulate is None else "simulated:"))
    require_answers(simulate is not None, run.board_url, ("simulated:",), ExperimentError)
    if simulate is None and run.board_url == "simulated:":
        raise ExperimentError(
            "nobody can answer as fast as simulated: goes: choose emulator:, or simulate",
            about="board",
            remedy="simulate",
        )
    chosen = run.load_profile()
    afferent = parse_afferent(mode)
    named = f"{name}-{afferent.name}"
    stem, order = usual_name(named, run.subject, session, seed)
    options = ExperimentOptions(
        afferent, procedure, parse_standards(standards), repetitions, trials, site, train_s,
        rate_hz, letters, two_intervals, order,
    )  # fmt: skip
    made = design(name, chosen, options)
    # Nobody is there who could press harder, or turn the intensity up.
    patience_s = None if simulate is None else 10.0
    timing = TrialTiming(gap_s, answer_s or None, made.again, patience_s)
    path = output or Path(f"{stem}.csv")
    about = About(named, made.method, run.subject, session, order)
    config = run.config(
        afferent.name,
        seed=order,
        note=run.note or session,
    )
    with open_sitting(made, chosen, timing, about, path, overwrite=overwrite) as sitting:
        if run.record is not None and sitting.session.resumed:
            run = replace(run, record=numbered(run.record))
        sit(sitting, run, config, simulate)


@experiment.command(cls=RunCommand)
@drives_a_board
@takes_options(scan="points")
def free(
    run: RunOptions,
    mode: _Mode = "RA",
    site: _Site = None,
    rate_hz: Annotated[
        float, typer.Option("--rate", metavar="HZ", help="Of pulses, 10 to 200.")
    ] = 50.0,
    knob: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Moved away from you: stronger. evdev:, window:, ..."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option(metavar="CSV", help="All changes; free.csv or the next number.")
    ] = None,
    profile: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="The paper's line array if not given.")
    ] = "line-8",
) -> None:
    """Turn the current by hand, from nothing to the device's own limit (paper, III-A).

    Keys: ↑ ↓ + − for the amplitude, ← → for the rate, m for the mode, [ ] for the site, 1 to 9 to
    mark what is felt; and those of live. Every change is a row of the CSV file.
    """
    from dataclasses import replace

    from smarttouch.cli.choices import parse_afferent
    from smarttouch.cli.experiment_steps import free_run

    run = replace(run, profile=profile)
    if run.intensity is None and not run.on_a_finger:
        # By hand from nothing here too.
        run = replace(run, intensity=0.0)
    free_run(run, run.load_profile(), parse_afferent(mode), site, rate_hz, knob, output)
