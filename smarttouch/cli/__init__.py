"""The command line: one module per command, heavy imports only inside them."""

import os
import sys

import typer

from smarttouch.cli.board import board
from smarttouch.cli.boards import boards
from smarttouch.cli.braille import braille
from smarttouch.cli.calibrate import calibrate
from smarttouch.cli.color import color
from smarttouch.cli.design import design
from smarttouch.cli.experiment import experiment
from smarttouch.cli.experiment_fit import fit
from smarttouch.cli.figures import figures
from smarttouch.cli.legibility import legibility
from smarttouch.cli.live import live
from smarttouch.cli.mouse import mouse
from smarttouch.cli.profiles import profiles
from smarttouch.cli.read import read
from smarttouch.cli.recordings import recordings
from smarttouch.cli.replay import replay
from smarttouch.cli.sensor import sensor
from smarttouch.cli.stop import stop
from smarttouch.errors import SmartTouchError
from smarttouch.stopping import RunStopped

app = typer.Typer(
    name="smarttouch",
    help="Touch what a sensor sees: print becomes current in the skin of a fingertip.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
app.command()(live)
app.command()(read)
app.command()(braille)
app.command()(legibility)
app.command()(mouse)
app.command()(color)
app.command()(stop)
app.command()(replay)
app.command()(profiles)
app.command()(design)
app.command()(figures)
app.command()(boards)
experiment.command()(fit)
app.add_typer(experiment, name="experiment")
app.add_typer(board, name="board")
app.add_typer(sensor, name="sensor")
app.add_typer(calibrate, name="calibrate")
app.add_typer(recordings, name="recordings")


def main() -> None:
    """Run the command line; what a user can cause ends in one sentence and exit 2."""
    try:
        app()
    except SmartTouchError as error:
        _say(str(error))
        sys.exit(2)
    except RunStopped as stopped:
        sys.exit(128 + stopped.number)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:
        # Whoever read our output has gone; there is nobody to tell.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except Exception as error:
        if os.environ.get("SMARTTOUCH_TRACEBACK"):
            raise
        _say(
            f"internal error, {type(error).__name__}: {error}; all electrodes are off "
            "(set SMARTTOUCH_TRACEBACK=1 to see where)"
        )
        sys.exit(1)


def _say(sentence: str) -> None:
    print("smarttouch: " + " ".join(sentence.split()), file=sys.stderr)
