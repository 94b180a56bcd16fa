"""``smarttouch experiment``: psychophysical experiments with pulses, and fits of their answers."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from smarttouch.base.errors import ExperimentError, choice_of
from smarttouch.cli.options import (
    ClassOption,
    Commands,
    JsonOption,
    OptionGroup,
    RunOptions,
    argument,
    option,
    output_file,
    parse_afferent,
    read_form,
    takes_options,
)
from smarttouch.views import printable_output
from smarttouch.views.keys_and_signals import drives_a_board

if TYPE_CHECKING:
    from smarttouch.experiments.answer_file import AnswerTable
    from smarttouch.experiments.findings import Finding

_ANATOMY = "paper"
_FINGER = 2  # seed; with seed 1, pulses of profile "concentric" do not reach any RA afferent
_FREE_HZ = 50.0  # initial pulse rate of free stimulation


experiment: Commands = Commands(
    help="Run psychophysical experiments, and fit the answers.", no_args_is_help=True
)


@dataclass(frozen=True, kw_only=True)
class _Participant(OptionGroup):
    """Options of an experiment: participant, session and file of answers."""

    subject: Annotated[str, option("Name the participant.", "NAME")] = ""
    session: Annotated[str, option("Name the session.", "NAME")] = ""
    output: Annotated[
        Path | None,
        option("Write the answers to this file (default: named by participant and session)."),
    ] = None
    simulate: Annotated[
        str | None,
        option("Let a simulated participant answer: model judges spikes, random guesses.", "WHO"),
    ] = None

    @property
    def name(self) -> str:
        """Participant's name in the file of answers, marked if the participant is simulated."""
        who = self.simulate and f"simulated-{self.simulate}"
        return "-".join(filter(None, (self.subject, who)))


@experiment.command("run")
@drives_a_board
@takes_options
def run_listed(
    run: RunOptions,
    who: _Participant,
    text: Annotated[
        str | None,
        argument(
            "Name of an experiment, the word free, or your own file (default: list all). Options "
            "follow a ?, as in 'frequency?standards=15,30&repetitions=5'. More options: procedure, "
            "site, trials, train_s, gap_s, answer_s; also rate_hz, unless rates are compared.",
            "NAME|FILE.py",
        ),
    ] = None,
    mode: ClassOption = "RA",
) -> None:
    """Run an experiment; repeat the command to continue it.

    The screen names the keys for answers. The keys of smarttouch live also work; q ends the
    session. With free: ↑ ↓ change the amplitude, ← → the rate, [ ] the site, 1 to 9 mark percepts;
    the recording contains each change as an event.
    """
    if text is None:
        _list_all()
        return
    from smarttouch.experiments.trials import Setup

    name, options = read_form(Setup, text, ExperimentError, but=("seed",))
    if name == "free":
        _run_free(run, who, mode, options)
    else:
        _run_trials(run, who, name, mode, options)


def _list_all() -> None:
    from smarttouch.experiments.standard_experiments import CATALOG

    for name, entry in CATALOG.items():
        typer.echo(f"{name:13} {entry.about} [{', '.join(entry.procedures)}]")
    typer.echo(f"{'free':13} set amplitude, rate and mode by hand")


def _run_trials(
    run: RunOptions, who: _Participant, name: str, mode: str, options: dict[str, Any]
) -> None:
    """Run the remaining trials of an experiment."""
    from smarttouch.base.afferent import Afferent
    from smarttouch.experiments import experiment_session as sessions
    from smarttouch.experiments.observers import make_observer
    from smarttouch.experiments.trials import Setup
    from smarttouch.profile import DEFAULT_PROFILE
    from smarttouch.views.terminal_screen import BlindScreen

    simulate, observer = who.simulate, None
    if simulate is None:
        if not sys.stdin.isatty():
            message = "there is no keyboard for answers: use a terminal, or add --simulate"
            raise ExperimentError(message)
    else:
        choice_of("simulate", simulate, ("model", "random"))
        if not run.board_url.startswith("simulated:"):
            raise ExperimentError(
                f"a simulated participant cannot use {run.board_url!r}, because a finger may "
                "be on this board: use --board simulated:"
            )
    afferent = parse_afferent(mode)
    is_default = run.profile is None and run.load_profile().name == DEFAULT_PROFILE
    if name == "frequency" and afferent is Afferent.RA and is_default:
        # Use the electrode of the paper's experiment (Section III-C).
        run = replace(run, profile="concentric")
    setup = Setup(run.load_profile(), afferent, **options)
    stem, setup.seed = sessions.session_name(
        sessions.experiment_name(name, setup), who.subject, who.session
    )
    path = who.output or Path(f"{stem}.csv")
    config = run.config(
        afferent.name, scan="points", seed=setup.seed, subject=who.subject, note=who.session,
        paced=simulate is None,
    )  # fmt: skip
    with sessions.open_experiment(name, setup, path, who.name, who.session) as sitting:
        if run.record is not None and sitting.resumed:
            run = replace(run, record=sessions.numbered(run.record))
        for line in sitting.before(simulate == "model"):
            typer.echo(line)
        try:
            if not sitting.over:
                if simulate is not None:
                    anatomy, finger = run.finger(_ANATOMY, _FINGER)
                    seed = setup.seed + sitting.resumed
                    observer = make_observer(simulate, setup.profile, seed, finger, anatomy)
                source = sitting.source(observer)
                run.start(source, setup.profile, config, screen=BlindScreen, keys=source.keys)
        finally:
            for line in sitting.after():
                typer.echo(line)


def _run_free(run: RunOptions, who: _Participant, mode: str, options: dict[str, Any]) -> None:
    """Let a user set the current by hand, up to the device's limit (paper, Section III-A)."""
    from smarttouch.base.afferent import Mode
    from smarttouch.experiments.experiment_session import numbered
    from smarttouch.experiments.free_stimulation import FreeSource, raise_to_device_limits
    from smarttouch.experiments.trials import Setup
    from smarttouch.imaging.reading_profile import reading_force_n
    from smarttouch.kernels.bank import load_bank
    from smarttouch.views.progress import bank_progress

    if who.simulate is not None or who.output is not None:
        raise ExperimentError(
            "free stimulation has no answers and no simulated participant: leave out --simulate "
            "and --output, and use --record"
        )
    if not sys.stdin.isatty() and run.seconds is None:
        message = "there is no keyboard to end the run: use a terminal, or add --seconds"
        raise ExperimentError(message)
    record = run.record or numbered(Path("free.mcap"))
    run = replace(run, profile=run.profile or "line-8", record=record)
    if run.intensity is None and not run.on_a_finger:
        # Start at zero intensity on simulated boards, as on real boards.
        run = replace(run, intensity=0.0)
    profile = raise_to_device_limits(run.load_profile())
    with bank_progress() as progress:
        offered = sorted(load_bank(profile, progress).weights)
    first = choice_of("mode", mode, [offered_mode.name for offered_mode in offered])
    classes = sorted(offered, key=lambda offered_mode: offered_mode.name != first)
    setup = Setup(profile, classes[0], **{"rate_hz": _FREE_HZ} | options)
    source = FreeSource(profile, classes, setup.place, setup.pulse_hz, reading_force_n(profile))
    source.url = "experiment:free"
    config = run.config(Mode.COLOR, scan="points")
    run.start(source, profile, config, keys=source.keys, keys_help=source.keys_help)
    typer.echo(f"{run.record} contains every change as an event")


@experiment.command()
def fit(
    files: Annotated[
        list[Path], argument("CSV files of answers, one file for each condition.", "FILE...")
    ],
    x: Annotated[str, option("Column of comparison stimuli.", "COLUMN")] = "comparison",
    y: Annotated[str, option("Column of answers: 1, 0 or empty.", "COLUMN")] = "success",
    at: Annotated[
        float | None,
        option("Share of successes at the threshold (default: halfway from chance to 1).", "0..1"),
    ] = None,
    plot: Annotated[Path | None, output_file("Draw answers and thresholds.", "PNG|PDF|SVG")] = None,
    json_file: JsonOption = None,
) -> None:
    """Fit thresholds with credible intervals to answers.

    Several files, for example of RA and PC mode, are shown in one table and one picture.
    """
    from smarttouch.base.files import write_json
    from smarttouch.experiments.answer_file import read_table, usual_model
    from smarttouch.experiments.findings import as_json, discrimination_figure, judge_answers
    from smarttouch.views import figure_style

    if plot is not None:
        figure_style.require_drawable(plot)
    fitted: list[tuple[AnswerTable, list[Finding]]] = []
    for path in files:
        table = read_table(path, x, y)
        if sum(each.stem == path.stem for each in files) > 1:
            table = replace(table, name=str(path))
        model = usual_model(table.answers, at=at)
        fitted.append((table, [judge_answers(each, model) for each in table.answers]))
    _print(fitted)
    if json_file is not None:
        write_json(json_file, {table.name: as_json(findings) for table, findings in fitted})
    if plot is not None:
        figure_style.save(discrimination_figure(fitted), plot)


def _print(fitted: Sequence[tuple["AnswerTable", list["Finding"]]]) -> None:
    from smarttouch.experiments.findings import threshold_rows

    console = printable_output.console(highlight=False)
    for table, findings in fitted:
        console.print(f"{table.name}{', ' * bool(table.unit)}{table.unit}", style="bold")
        compares = any(finding.answers.standard for finding in findings)
        heading, *rows = threshold_rows(
            [finding for finding in findings if not finding.verdict], compares
        )
        if rows:
            printable_output.print_table(rows, heading, left=0)
        if table.cut:
            console.print("the last line of this file is incomplete and is ignored", style="dim")
        for finding in findings:
            about = f"{finding.answers.standard:g}: " if compares else ""
            if finding.verdict is not None:
                console.print(f"{about}no threshold: {finding.verdict}", soft_wrap=True)
