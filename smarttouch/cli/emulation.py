"""Emulators played from the command line, until Ctrl-C."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable

import typer

from smarttouch.errors import SmartTouchError


def play_emulator(
    module: str, arguments: list[str], advice: Callable[[str], str], error: type[SmartTouchError]
) -> None:
    """Run an emulator in a process of its own; print what to do with its port.

    Parameters
    ----------
    module : str
        What to run.
    arguments : list of str
        Its command line.
    advice : callable
        Makes of the port's name what a user should read.
    error : type
        What to raise if it does not start.
    """
    command = [sys.executable, "-m", module, "--linger=inf", f"--parent={os.getpid()}", *arguments]
    # A session of its own: Ctrl-C ends it through us, in order; if we are killed it ends itself.
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        port = process.stdout.readline().strip()
        if not port:
            # The last line of what argparse says is its sentence.
            words = process.stderr.read().strip().rpartition("error: ")[2]
            message = f"the emulator did not start: {words or process.wait()}"
            raise error(message, about="emulator", problem="gone")
        typer.echo(advice(port))
        # Ctrl-C too: a shell may have started us with it ignored.
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: sys.exit(0))
        try:
            process.wait()
        finally:
            process.terminate()
