"""``smarttouch replay``: a recording once more, into a board or against today's pipeline."""

from pathlib import Path
from typing import Annotated

import typer

from smarttouch.cli.option_groups import takes_options
from smarttouch.cli.run_options import RunOptions
from smarttouch.monitor.driving import drives_a_board


@drives_a_board
@takes_options()
def replay(
    run: RunOptions,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording, whole or cut.")],
    check: Annotated[
        bool,
        typer.Option("--check", help="Compare today's sequences with the recorded ones, exactly."),
    ] = False,
    profile: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE",
            help="Another than the recorded one; a real board takes its usual one or this, and "
            "the recording only lowers its limits.",
        ),
    ] = None,
    board: Annotated[
        str, typer.Option(metavar="URL", help="What to play into; not with --check.")
    ] = "emulator:",
    force: Annotated[
        str | None,
        typer.Option(
            metavar="URL",
            help="Today's finger; if not given, a real board's own sensor, elsewhere the recorded "
            "force.",
        ),
    ] = None,
    intensity: Annotated[
        float | None,
        typer.Option(
            metavar="0..1",
            help="Of the recorded. On a real board a run begins at 0, and keys raise it up to "
            "this (1); without a keyboard it must be given, and is reached slowly.",
        ),
    ] = None,
) -> None:
    """Let a finger feel once more what was recorded, or prove that it still would."""
    from smarttouch.recording.reader import Recording

    if check:
        _check(file, profile)
        return
    from dataclasses import replace
    from functools import partial

    from smarttouch.front import recording_config
    from smarttouch.recording.controls import RecordedControls
    from smarttouch.recording.source import RecordingSource

    run = replace(run, board=board, force=force, intensity=intensity, profile=profile)
    recording = Recording(file)
    recorded = profile is None and not run.on_a_finger
    chosen = recording.profile if recorded else run.load_profile()
    config = recording_config(recording, **run.settings("scan", "softness"))
    with RecordingSource(recording) as source:
        source.url = f"recording:{file}"
        run.start(source, chosen, config, controls=partial(RecordedControls, recording))


def _check(file: Path, profile: str | None) -> None:
    """Print the outcome; exit 1 where sequences differ."""
    from smarttouch.kernels.bank import load_bank
    from smarttouch.monitor.progress import bank_progress
    from smarttouch.profile import load_profile
    from smarttouch.recording.check import check_recording
    from smarttouch.recording.reader import Recording

    chosen = Recording(file).profile if profile is None else load_profile(profile)
    with bank_progress(quiet=False) as progress:
        bank = load_bank(chosen, progress)
    report = check_recording(file, bank=bank, profile=chosen)
    print(report.describe())
    if not report.exact:
        raise typer.Exit(1)
