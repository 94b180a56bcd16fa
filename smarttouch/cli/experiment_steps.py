"""Steps of ``smarttouch experiment`` around a run."""

import contextlib
import sys
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from smarttouch.cli.run_options import RunOptions
from smarttouch.errors import ExperimentError

if TYPE_CHECKING:
    from smarttouch.afferent import Afferent
    from smarttouch.profile import Profile
    from smarttouch.psychophysics.sitting import ExperimentSession
    from smarttouch.running.config import RunConfig

_SIMULATED = "simulated:"


def sit(
    sitting: "ExperimentSession",
    options: RunOptions,
    config: "RunConfig",
    simulate: str | None,
) -> None:
    """Run an experiment to its end or until a user ends it; print how far it came."""
    from smarttouch.monitor.blind_screen import BlindScreen
    from smarttouch.reading.window import press_n

    def say(lines: Iterable[str]) -> None:
        for line in () if options.quiet else lines:
            typer.echo(line)

    say(sitting.before())
    if sitting.session.over:
        say(sitting.after())
        return
    in_real_time = options.board_url != _SIMULATED
    source = sitting.source(press_n(sitting.profile), in_real_time=in_real_time)
    try:
        options.start(
            source,
            sitting.profile,
            config,
            screen=BlindScreen,
            keys=source.keys,
            listeners=()
            if simulate is None
            else [sitting.subject(source, simulate, config.seed, options.finger, options.anatomy)],
        )
    finally:
        say(sitting.after())


def free_run(
    options: RunOptions,
    profile: "Profile",
    afferent: "Afferent",
    site: int | None,
    rate_hz: float,
    knob_url: str | None,
    output: Path | None,
) -> None:
    """Let a user change amplitude, rate, mode and site until the end of the run."""
    from smarttouch.afferent import Mode
    from smarttouch.kernels.bank import load_bank
    from smarttouch.monitor.progress import bank_progress
    from smarttouch.psychophysics.free import FreeLog, FreeSource, HandControls, up_to_the_ceiling
    from smarttouch.psychophysics.sitting import numbered
    from smarttouch.reading.window import press_n
    from smarttouch.texture.motion import open_motion

    if not sys.stdin.isatty() and options.seconds is None:
        message = "there is no keyboard, by which this would end: use a terminal, or give seconds"
        raise ExperimentError(message, about="keyboard", remedy="seconds")
    raised = up_to_the_ceiling(profile)
    with contextlib.ExitStack() as stack:
        knob = None if knob_url is None else stack.enter_context(open_motion(knob_url))
        with bank_progress(options.quiet) as progress:
            offered = tuple(sorted(load_bank(raised, progress).weights))
        log = stack.enter_context(FreeLog(output or numbered(Path("free.csv"))))
        source = FreeSource(raised, offered, log, afferent, site, rate_hz, press_n(raised))
        source.url = "experiment:free"
        options.start(
            source,
            raised,
            options.config(Mode.COLOR),
            keys=source.keys,
            keys_help="← → rate    [ ] site    1 to 9 mark    ",
            controls=partial(HandControls, knob=knob),
        )
        if not options.quiet:
            typer.echo(f"every change is in {log.path}")
