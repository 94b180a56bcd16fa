"""What ``smarttouch experiment run`` does around a run."""

import contextlib
import sys
import zlib
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path

import typer

from smarttouch.cli.blind_screen import BlindScreen
from smarttouch.cli.progress import bank_progress
from smarttouch.cli.run_options import RunOptions
from smarttouch.cli.session import run_in_terminal
from smarttouch.clock import MonotonicClock
from smarttouch.errors import ExperimentError, SmartTouchError
from smarttouch.kernels.bank import load_bank
from smarttouch.primary import Mode, Primary
from smarttouch.profile import Profile
from smarttouch.psychophysics.catalog import Design
from smarttouch.psychophysics.course import Course
from smarttouch.psychophysics.free import FreeLog, FreeSensor, HandControls, up_to_the_ceiling
from smarttouch.psychophysics.sensor import ExperimentSensor
from smarttouch.psychophysics.session import Session
from smarttouch.psychophysics.subject import Subject, make_observer
from smarttouch.psychophysics.summary import summarize
from smarttouch.reading.window import press_n
from smarttouch.running.config import RunConfig
from smarttouch.sources.forces.force import ForceSource
from smarttouch.texture.motion import open_motion

_SIMULATED = "simulated:"


@dataclass
class Sitting:
    """One run of an experiment."""

    made: Design
    session: Session
    profile: Profile
    course: Course


def sit(
    sitting: Sitting,
    options: RunOptions,
    config: RunConfig,
    force: ForceSource | None,
    simulate: str | None,
    path: Path,
) -> None:
    """Run an experiment to its end or until a user ends it; say how far it came."""
    session, profile = sitting.session, sitting.profile
    if not options.quiet:
        _say_before(sitting, path)
    if session.over:
        if not options.quiet:
            _say_after(sitting, path)
        return
    sensor = ExperimentSensor(
        session,
        profile,
        sitting.course,
        press_n(profile) if options.pressed else None,
        None if options.board_url == _SIMULATED else MonotonicClock(),
    )
    sensor.url = f"experiment:{session.title}"
    listeners = []
    if simulate is not None:
        seed = config.seed + session.resumed
        drawn = getattr(sitting.made.task, "drawn", None)
        observer = make_observer(simulate, profile, seed, drawn)
        listeners.append(Subject(sensor, observer))
    try:
        run_in_terminal(
            sensor,
            options.display(profile),
            config,
            options.outputs(),
            force=force,
            screen=BlindScreen,
            keys=sensor.keys,
            listeners=listeners,
        )
    finally:
        if not options.quiet:
            _say_after(sitting, path)


def free_run(
    options: RunOptions,
    profile: Profile,
    primary: Primary,
    site: int | None,
    rate_hz: float,
    knob_url: str | None,
    output: Path | None,
) -> None:
    """Let a user turn amplitude, rate, mode and site until they have had enough."""
    if not sys.stdin.isatty() and options.seconds is None:
        message = "there is no keyboard, by which this would end: use a terminal, or give --seconds"
        raise ExperimentError(message, about="keyboard", problem="missing", remedy="--seconds")
    raised = up_to_the_ceiling(profile)
    with contextlib.ExitStack() as stack:
        force = options.open_force(raised, stack)
        knob = None if knob_url is None else stack.enter_context(open_motion(knob_url))
        with bank_progress(options.quiet) as progress:
            offered = tuple(sorted(load_bank(raised, progress).weights))
        log = stack.enter_context(FreeLog(output or numbered(Path("free.csv"))))
        pressed_n = press_n(raised) if options.pressed else None
        sensor = FreeSensor(raised, offered, log, primary, site, rate_hz, pressed_n)
        sensor.url = "experiment:free"
        run_in_terminal(
            sensor,
            options.display(raised),
            options.config(Mode.COLOR),
            options.outputs(),
            force=force,
            keys=sensor.keys,
            keys_help="← →  rate    [ ]  site    1 to 9  mark    ",
            controls=partial(HandControls, knob=knob),
        )
        if not options.quiet:
            typer.echo(f"every change is in {log.path}")


def _say_before(sitting: Sitting, path: Path) -> None:
    session = sitting.session
    total = "" if session.total is None else f" of {session.total}"
    if session.resumed and not session.over:
        typer.echo(f"goes on at trial {session.resumed + 1}{total}: {path}")
    for note in sitting.made.notes:
        typer.echo(note)


def _say_after(sitting: Sitting, path: Path) -> None:
    for line in summarize(sitting.made, sitting.session, path):
        typer.echo(line)


def require_answers(simulate: str | None, board_url: str) -> None:
    """Raise unless somebody can answer."""
    if simulate is not None and board_url != _SIMULATED:
        raise ExperimentError(
            f"--simulate answers for nobody: no current of its flows through {board_url!r}, only "
            f"through {_SIMULATED}",
            about="--board",
            problem="conflict",
            value=board_url,
            allowed=(_SIMULATED,),
        )
    if simulate is None and not sys.stdin.isatty():
        message = "there is no keyboard to answer on: use a terminal, or --simulate"
        raise ExperimentError(message, about="keyboard", problem="missing", remedy="--simulate")
    if simulate is None and board_url == _SIMULATED:
        message = "nobody can answer as fast as simulated: goes: choose emulator:, or --simulate"
        raise ExperimentError(
            message, about="--board", problem="impossible", value=board_url, remedy="--simulate"
        )


def parse_standards(text: str | None) -> tuple[float, ...] | None:
    """Return the frequencies that ``--standards 15,30`` names."""
    if text is None:
        return None
    try:
        standards = tuple(float(each) for each in text.split(","))
    except ValueError:
        standards = ()
    if not standards or not all(0 < each < 1e6 for each in standards):
        message = f"--standards {text!r} is not understood: give frequencies in Hz, as in 15,30,45"
        raise SmartTouchError(message, about="--standards", problem="malformed", value=text)
    return tuple(dict.fromkeys(standards))


def usual_name(
    experiment: str, participant: str, session: str, seed: int | None
) -> tuple[str, int]:
    """Return what an experiment's file is called without ending, and the seed of its orders.

    Raises
    ------
    SmartTouchError
        If a name cannot be part of a file's, or the seed is negative.
    """
    for option, name in (("--participant", participant), ("--session", session)):
        if any(not (each.isalnum() or each in "-_.") for each in name):
            raise SmartTouchError(
                f"{option} {name!r} becomes part of a file's name: use letters, digits, - and _",
                about=option,
                problem="malformed",
                value=name,
            )
    if seed is not None and seed < 0:
        message = f"--seed {seed} must be 0 or more"
        raise SmartTouchError(message, about="--seed", value=seed, allowed=0)
    named = "-".join(each for each in (participant, session, experiment) if each)
    usual = zlib.crc32(f"{participant}/{session}".encode()) % 10_000
    return named, usual if seed is None else seed


def numbered(path: Path) -> Path:
    """Return a file's name with the next number, if there is one of that name."""
    names = (path.with_stem(f"{path.stem}-{number}") for number in count(2))
    return next(each for each in names if not each.exists()) if path.exists() else path
