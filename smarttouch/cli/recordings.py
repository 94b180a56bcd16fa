"""``smarttouch recordings``, ``replay`` and ``report``: recordings shown, repaired, played."""

from pathlib import Path
from typing import Annotated

import typer

from smarttouch.base.command_options import argument, option
from smarttouch.base.terminal import print_table
from smarttouch.cli.options import Commands, takes_options
from smarttouch.cli.run_options import RunOptionGroup
from smarttouch.views.keys_and_signals import drives_a_board

recordings: Commands = Commands(
    help="Show what recordings hold; repair and export them.", no_args_is_help=True
)

_File = Annotated[Path, argument("A recording, whole or cut off.", "FILE")]


@recordings.command()
def info(file: _File) -> None:
    """Show what was delivered to whom and when, and how much of it was recorded."""
    from smarttouch.running.recording_files import describe

    print_table(describe(file), left=2)


@recordings.command()
def repair(
    file: _File,
    output: Annotated[
        Path | None, option("Write this file; a new one beside the old one otherwise.", "FILE")
    ] = None,
) -> None:
    """Write all that can be read to a valid file; the old file stays as it is."""
    from smarttouch.running.recording_files import is_sound
    from smarttouch.running.recording_files import repair as write_whole

    if output is None and is_sound(file):
        print(f"{file} is whole: there is nothing to repair")
        return
    done = write_whole(file, output)
    damaged = f"; {done.damaged_chunks} damaged pieces left out" if done.damaged_chunks else ""
    print(f"{done.path}: {done.steps:,} sequences, {done.seconds:.1f} s{damaged}")


@recordings.command()
def export(
    file: _File, folder: Annotated[Path, argument("A new or empty folder.", "FOLDER")]
) -> None:
    """Write images as PNG, steps and events as CSV, and all numbers as NPZ."""
    from smarttouch.running.recording_files import export as write_out

    for path in write_out(file, folder):
        print(path)


@drives_a_board
@takes_options()
def replay(
    run: RunOptionGroup,
    file: Annotated[Path, argument("A recording, whole or cut off.", "FILE")],
    check: Annotated[
        bool, option("Compare today's sequences with the recorded ones, exactly.", None, "--check")
    ] = False,
    profile: Annotated[
        str | None,
        option(
            "Use another device and finger than the recorded one. A recording never raises "
            "the limits of a real board.",
            "NAME|FILE",
        ),
    ] = None,
    board: Annotated[
        str, option("Drive this board; it cannot be given with --check.", "URL")
    ] = "emulator:",
    force: Annotated[
        str | None,
        option(
            "Measure or state today's force. The recorded force counts on emulated boards only.",
            "URL",
        ),
    ] = None,
    intensity: Annotated[
        float | None,
        option("Scale the recorded intensity, 0 to 1. Real boards start at 0.", "0..1"),
    ] = None,
) -> None:
    """Play a recording on a board, or check that its sequences are still the same."""
    from smarttouch.running.recording_reader import Recording

    if check:
        _check(file, profile)
        return
    from dataclasses import replace
    from functools import partial

    from smarttouch.running.functions import recording_config
    from smarttouch.running.recorded_source import RecordedControls, RecordingSource

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
    from smarttouch.profile import load_profile
    from smarttouch.running.check_recording import check_recording
    from smarttouch.running.recording_reader import Recording
    from smarttouch.views.progress import bank_progress

    chosen = Recording(file).profile if profile is None else load_profile(profile)
    with bank_progress(quiet=False) as progress:
        bank = load_bank(chosen, progress)
    report = check_recording(file, bank=bank, profile=chosen)
    print(report.describe())
    if not report.exact:
        raise typer.Exit(1)


def report(
    recording: Annotated[
        Path | None, argument("The recording of the run that went wrong.", "[MCAP]")
    ] = None,
    output: Annotated[Path, option("Write the report to this file.", "FILE")] = Path(
        "smarttouch-report.json"
    ),
) -> None:
    """Write a file for a bug report: versions, drivers and settings.

    It contains nothing about participants: no name, note, file name, threshold, current or answer.
    """
    from smarttouch.base.files import require_folder, write_json
    from smarttouch.running.bug_report import bug_report

    require_folder(output)
    write_json(output, bug_report(recording))
    print(f"{output}: look through it, and add what you did and what you saw")
