"""Steps of ``smarttouch experiment`` around a run."""

import contextlib
import sys
from collections.abc import Iterable
from functools import partial
from pathlib import Path

import typer

from smarttouch.afferent import Afferent, Mode
from smarttouch.cli.run_options import RunOptions
from smarttouch.errors import ExperimentError
from smarttouch.kernels.bank import load_bank
from smarttouch.monitor.blind_screen import BlindScreen
from smarttouch.monitor.progress import bank_progress
from smarttouch.monitor.session import run_in_terminal
from smarttouch.profile import Profile
from smarttouch.psychophysics.free import FreeLog, FreeSource, HandControls, up_to_the_ceiling
from smarttouch.psychophysics.sitting import ExperimentSession, numbered
from smarttouch.reading.window import press_n
from smarttouch.running.config import RunConfig
from smarttouch.sources.forces.force import ForceSource
from smarttouch.texture.motion import open_motion

_SIMULATED = "simulated:"


def sit(
    sitting: ExperimentSession,
    options: RunOptions,
    config: RunConfig,
    force: ForceSource | None,
    simulate: str | None,
) -> None:
    """Run an experiment to its end or until a user ends it; say how far it came."""

    def say(lines: Iterable[str]) -> None:
        for line in () if options.quiet else lines:
            typer.echo(line)

    say(sitting.before())
    if sitting.session.over:
        say(sitting.after())
        return
    pressing_n = press_n(sitting.profile) if options.pressed else None
    source = sitting.source(pressing_n, in_real_time=options.board_url != _SIMULATED)
    try:
        run_in_terminal(
            source,
            options.display(sitting.profile),
            config,
            options.outputs(),
            force=force,
            screen=BlindScreen,
            keys=source.keys,
            listeners=[sitting.subject(source, simulate, config.seed)] if simulate else (),
        )
    finally:
        say(sitting.after())


def free_run(
    options: RunOptions,
    profile: Profile,
    afferent: Afferent,
    site: int | None,
    rate_hz: float,
    knob_url: str | None,
    output: Path | None,
) -> None:
    """Let a user turn amplitude, rate, mode and site until they have had enough."""
    if not sys.stdin.isatty() and options.seconds is None:
        message = "there is no keyboard, by which this would end: use a terminal, or give seconds"
        raise ExperimentError(message, about="keyboard", problem="missing", remedy="seconds")
    raised = up_to_the_ceiling(profile)
    with contextlib.ExitStack() as stack:
        force = options.open_force(raised, stack)
        knob = None if knob_url is None else stack.enter_context(open_motion(knob_url))
        with bank_progress(options.quiet) as progress:
            offered = tuple(sorted(load_bank(raised, progress).weights))
        log = stack.enter_context(FreeLog(output or numbered(Path("free.csv"))))
        pressed_n = press_n(raised) if options.pressed else None
        source = FreeSource(raised, offered, log, afferent, site, rate_hz, pressed_n)
        source.url = "experiment:free"
        run_in_terminal(
            source,
            options.display(raised),
            options.config(Mode.COLOR),
            options.outputs(),
            force=force,
            keys=source.keys,
            keys_help="← →  rate    [ ]  site    1 to 9  mark    ",
            controls=partial(HandControls, knob=knob),
        )
        if not options.quiet:
            typer.echo(f"every change is in {log.path}")


def require_answers(simulate: str | None, board_url: str) -> None:
    """Raise unless somebody can answer."""
    if simulate is not None and board_url != _SIMULATED:
        raise ExperimentError(
            f"a simulation answers for nobody: no current of its flows through {board_url!r}, only "
            f"through {_SIMULATED}",
            about="board",
            problem="conflict",
            value=board_url,
            allowed=(_SIMULATED,),
        )
    if simulate is None and not sys.stdin.isatty():
        message = "there is no keyboard to answer on: use a terminal, or simulate"
        raise ExperimentError(message, about="keyboard", problem="missing", remedy="simulate")
    if simulate is None and board_url == _SIMULATED:
        message = "nobody can answer as fast as simulated: goes: choose emulator:, or simulate"
        raise ExperimentError(
            message, about="board", problem="impossible", value=board_url, remedy="simulate"
        )
