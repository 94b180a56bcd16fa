"""``smarttouch replay``: a recording once more, into a board or against today's pipeline."""

from pathlib import Path
from typing import Annotated

import typer

from smarttouch.cli.driving import drives_a_board
from smarttouch.cli.options import (
    JsonOption,
    MarkersOption,
    QuietOption,
    RecordOption,
    SecondsOption,
)


@drives_a_board
def replay(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording, whole or cut.")],
    check: Annotated[
        bool,
        typer.Option("--check", help="Compare today's sequences with the recorded ones, exactly."),
    ] = False,
    profile: Annotated[
        str | None,
        typer.Option(metavar="NAME|FILE", help="Another than the recorded one."),
    ] = None,
    board: Annotated[
        str, typer.Option(metavar="URL", help="What to play into; not with --check.")
    ] = "emulator:",
    force: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Today's finger; the recorded force if not given."),
    ] = None,
    intensity: Annotated[
        float | None,
        typer.Option(
            metavar="0..1",
            help="Of the recorded. On a real board a run begins at 0, and keys raise it up to "
            "this (1); without a keyboard it must be given, and is reached slowly.",
        ),
    ] = None,
    seconds: SecondsOption = None,
    record: RecordOption = None,
    markers: MarkersOption = False,
    json_file: JsonOption = None,
    quiet: QuietOption = False,
) -> None:
    """Let a finger feel once more what was recorded, or prove that it still would."""
    from smarttouch.profile import load_profile
    from smarttouch.recording.reader import Recording

    if check:
        _check(file, profile)
        return
    import contextlib
    from functools import partial

    from smarttouch.cli.plan import Plan
    from smarttouch.cli.session import play
    from smarttouch.recording.controls import RecordedControls
    from smarttouch.recording.sensor import RecordingSensor
    from smarttouch.sources.forces.force import open_force
    from smarttouch.stimulation.frames import NO_SHARING, why_not

    recording = Recording(file)
    chosen = recording.profile if profile is None else load_profile(profile)
    run = recording.run
    plan = Plan(
        sensor_url=f"recording:{file}",
        board_url=board,
        mode=run.mode,
        rate_hz=run.rate_hz,
        light_on_dark=run.light_on_dark,
        softness=run.softness,
        sharing=NO_SHARING if why_not(chosen) else run.sharing,
        tone=run.tone,
        level=intensity,
        seconds=seconds,
        force_url=force,
        record=record,
        markers=markers,
        json_file=json_file,
        quiet=quiet,
        controls=partial(RecordedControls, recording),
    )
    with contextlib.ExitStack() as stack:
        source = stack.enter_context(RecordingSensor(recording))
        pressing = None if force is None else stack.enter_context(open_force(force, chosen))
        play(plan, source, pressing, chosen)


def _check(file: Path, profile: str | None) -> None:
    """Print the outcome; exit 1 where sequences differ."""
    from smarttouch.cli.progress import bank_progress
    from smarttouch.kernels.bank import load_bank
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
