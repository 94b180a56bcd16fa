"""Command line: one function for each command, with heavy imports inside the functions."""

import os
import sys
import traceback
from collections.abc import Callable
from functools import cache
from typing import Annotated, Any

import typer

from smarttouch.base import __version__
from smarttouch.base.errors import SmartTouchError, TableError
from smarttouch.base.stopping import RunStopped
from smarttouch.cli.calibrate import calibrate
from smarttouch.cli.design_and_profiles import design, profiles
from smarttouch.cli.devices import devices
from smarttouch.cli.experiment import experiment
from smarttouch.cli.live import live, replay, stop
from smarttouch.cli.options import Commands, option
from smarttouch.cli.read import braille, braille_display, read
from smarttouch.cli.simulate import simulate
from smarttouch.views.printable_output import guarded_output

_COMMANDS: dict[str, Callable[..., object] | typer.Typer] = {
    "live": live, "stop": stop, "read": read, "braille": braille,
    "braille-display": braille_display, "calibrate": calibrate, "experiment": experiment,
    "devices": devices, "replay": replay, "profiles": profiles,
    "design": design, "simulate": simulate,
}  # fmt: skip


app: Commands = Commands(name="smarttouch", no_args_is_help=True)
for _name, _command in _COMMANDS.items():
    if isinstance(_command, typer.Typer):
        app.add_typer(_command, name=_name)
    else:
        app.command(_name)(_command)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"smarttouch {__version__}")
        raise typer.Exit


@app.callback()
def smarttouch(
    version: Annotated[
        bool,
        option(
            "Print the version and exit.", None, "--version", is_eager=True, callback=_print_version
        ),
    ] = False,
) -> None:
    """Touch what a sensor sees: print becomes currents on a fingertip."""


def main() -> None:
    """Run the command line. For an error of the user, print one sentence and exit with status 2."""
    with guarded_output():
        status = _run()
        try:
            sys.stdout.flush()
        except (BrokenPipeError, SmartTouchError) as error:
            status = status or _outcome(error)
        if status:
            _drop_output()
            sys.exit(status)


@cache
def _built() -> Callable[..., Any]:
    """Return the command line, built once for each process."""
    return typer.main.get_command(app)


def _run() -> int:
    try:
        _built()(prog_name="smarttouch")
    except SystemExit as ended:
        return ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    except RunStopped as stopped:
        return 128 + stopped.number
    except BaseException as error:
        return _outcome(error)
    return 0


def _outcome(error: BaseException) -> int:
    """Print an error, with one line for each problem; return the exit status."""
    if isinstance(error, KeyboardInterrupt):
        return 130
    if isinstance(error, BrokenPipeError):
        # Output has no reader, so nothing can be printed.
        return 1
    if isinstance(error, SmartTouchError):
        complaints = error.complaints if isinstance(error, TableError) else [("", str(error))]
        for _, sentence in complaints:
            _say(sentence)
    elif isinstance(error, MemoryError):
        _say("not enough memory: use a smaller input")
    elif isinstance(error, OSError):
        about = f"{error.filename}: " if error.filename else ""
        _say(f"{about}{error.strerror or error}; all electrodes are off")
    else:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        _say(
            f"internal error, {type(error).__name__}: {error} ({frame.filename}, line "
            f"{frame.lineno}); all electrodes are off"
        )
        return 1
    return 2


def _drop_output() -> None:
    """Discard output that cannot be written. Otherwise Python reports an error at exit."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, SmartTouchError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _say(sentence: str) -> None:
    print("smarttouch: " + " ".join(sentence.split()), file=sys.stderr)
