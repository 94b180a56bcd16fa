"""``smarttouch recordings`` and ``replay``: recordings summarized and played."""

from pathlib import Path
from typing import Annotated

import typer

from smarttouch.base.command_options import argument, option
from smarttouch.base.terminal import print_table
from smarttouch.cli.options import Commands, takes_options
from smarttouch.cli.run_options import RunOptionGroup
from smarttouch.views.keys_and_signals import drives_a_board

recordings: Commands = Commands(help="Show what recordings hold.", no_args_is_help=True)


@recordings.command()
def info(file: Annotated[Path, argument("A recording, whole or cut off.", "FILE")]) -> None:
    """Show what was delivered to whom and when, and how much of it was recorded."""
    from smarttouch.running.recording import describe

    print_table(describe(file), left=2)


@drives_a_board
@takes_options
def replay(
    run: RunOptionGroup,
    file: Annotated[Path, argument("A recording, whole or cut off.", "FILE")],
    check: Annotated[
        bool, option("Compare today's sequences with the recorded ones, exactly.", None, "--check")
    ] = False,
) -> None:
    """Play a recording, or check that it gives the same.

    Without --profile it is played with the recorded one, which never raises the limits of a real
    board. The recorded force counts on simulated boards only; --intensity scales what was recorded.
    """
    from smarttouch.running.recording import Recording

    if check:
        _check(file, run.profile)
        return
    from functools import partial

    from smarttouch.running.recorded_source import RecordedControls, RecordingSource

    recording = Recording(file)
    recorded = run.profile is None and not run.on_a_finger
    chosen = recording.profile if recorded else run.load_profile()
    asked = {"hold": None, "balance": False, "paced": run.is_watched} | run.settings()
    config = recording.run.model_copy(update=asked)
    with RecordingSource(recording) as source:
        source.url = f"recording:{file}"
        run.start(source, chosen, config, controls=partial(RecordedControls, recording))


def _check(file: Path, profile: str | None) -> None:
    """Print the outcome; exit 1 where sequences differ."""
    from smarttouch.kernels.bank import load_bank
    from smarttouch.profile import load_profile
    from smarttouch.running.check_recording import check_recording
    from smarttouch.running.recording import Recording
    from smarttouch.views.progress import bank_progress

    chosen = Recording(file).profile if profile is None else load_profile(profile)
    with bank_progress(quiet=False) as progress:
        bank = load_bank(chosen, progress)
    report = check_recording(file, bank=bank, profile=chosen)
    print(report.describe())
    if not report.exact:
        raise typer.Exit(1)
