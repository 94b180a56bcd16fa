"""``smarttouch live``, ``replay`` and ``stop``: run a source, replay a recording, stop all runs."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from smarttouch.cli.options import (
    RunOptions,
    argument,
    option,
    or_standard_input,
    parse_mode,
    takes_options,
)
from smarttouch.views.keys_and_signals import drives_a_board
from smarttouch.views.printable_output import print_table


@takes_options
def live(
    run: RunOptions,
    source: Annotated[
        str | None,
        argument(
            "A file, words, or a source by its URL: page:, text:, camera:, video:, "
            "frames:, serial-array:, brltty:, socket:, recording:, texture:, vibration:. Options "
            "follow a ?, as in 'scan.png?dpi=300&speed_mm_s=40'. The default is a sample page.",
            "SOURCE",
            callback=or_standard_input,
        ),
    ] = None,
    mode: Annotated[
        str | None,
        option("Choose the class to stimulate: RA (default), SAI, PC or natural.", "CLASS"),
    ] = None,
) -> None:
    """Show the images or stimuli of a source on the finger.

    The run ends with its source, or when you press q or Ctrl-C. In a terminal or a window, a page
    is read again and again, at about 30 words a minute. With 'text:Hello?passes=1', or if files are
    written, the page is read once.
    """
    from smarttouch.base.files import data_folder

    url = source or f"page:{data_folder('sample_images') / 'page.png'}"
    _show(run, url, mode)


@drives_a_board
def _show(run: RunOptions, url: str, mode: str | None) -> None:
    chosen = run.load_profile()
    ready = run.display(chosen)
    from smarttouch.base.errors import SourceError
    from smarttouch.sources import open_source, options_taken
    from smarttouch.sources.virtual_finger import READER_MM_S

    settings, asked = run.settings(), None if mode is None else parse_mode(mode)
    rate_hz = settings.get("rate_hz")
    offered = {"mode": asked, "rate_hz": rate_hz, "display": ready, "vibrated": bool(run.vibrators)}
    if run.is_watched:
        offered |= {"passes": 0, "speed_mm_s": READER_MM_S}
    taken = options_taken(url)
    accepted = {name: value for name, value in offered.items() if name in taken}
    dark, seed = bool(settings.get("light_on_dark")), settings.get("seed")
    with open_source(url, chosen, light_on_dark=dark, seed=seed, **accepted) as opened:
        if opened.pointer is not None and not run.window:
            raise SourceError("motion=page follows the pointer in the browser: add --window")
        suits = {"mode": asked or "RA"} | dict(opened.settings)
        if asked is not None and suits["mode"] != asked:
            message = f"{opened.title} chooses its own classes: leave out --mode"
            raise SourceError(message)
        config = run.config(**suits)
        if "rate_hz" in taken:
            config = config.model_copy(update={"rate_hz": None})
        run.start(
            opened, chosen, config, ready, keys=opened.keys,
            keys_help=opened.keys_help,
        )  # fmt: skip


@drives_a_board
@takes_options
def replay(
    run: RunOptions,
    file: Annotated[Path, argument("A recording, complete or interrupted.", "FILE")],
    check: Annotated[
        bool, option("Compute all sequences again, and compare them exactly.", None, "--check")
    ] = False,
    info: Annotated[bool, option("Print a summary and the events.", None, "--info")] = False,
) -> None:
    """Play a recording, check it by a new computation (--check), or summarize it (--info).

    By default, a simulated board uses the recorded profile and force, and a real board uses its own
    profile and force. --intensity scales the recorded intensity.
    """
    from smarttouch.running.recorded_source import RecordedControls, RecordingSource
    from smarttouch.running.recording_reader import RecordedRun
    from smarttouch.views.terminal_session import describe_recording

    if info:
        print_table(describe_recording(file), left=2)
        return
    if check:
        _check(file, run.profile)
        return
    recording = RecordedRun(file)
    recorded = run.profile is None and not run.on_a_finger
    chosen = recording.profile if recorded else run.load_profile()
    asked = {"hold": None, "balance": False, "paced": run.is_watched} | run.settings()
    config = recording.run.model_copy(update=asked)
    with RecordingSource(recording) as source:
        run.start(source, chosen, config, controls=partial(RecordedControls, recording))


def _check(file: Path, profile: str | None) -> None:
    """Print the result of the comparison; exit with status 1 if sequences differ."""
    from smarttouch.kernels.bank import load_bank
    from smarttouch.profile import load_profile
    from smarttouch.running.recording_reader import RecordedRun
    from smarttouch.running.replay_check import check_recording
    from smarttouch.views.progress import bank_progress

    chosen = RecordedRun(file).profile if profile is None else load_profile(profile)
    with bank_progress() as progress:
        bank = load_bank(chosen, progress)
    report = check_recording(file, bank=bank, profile=chosen)
    print(report.describe())
    if not report.exact:
        raise typer.Exit(1)


def stop(
    url: Annotated[str | None, argument("Also set this board to zero current.", "BOARD")] = None,
) -> None:
    """Stop all runs of this user, and wait until each has confirmed zero current.

    Programs that are still starting will not open a board. The exit status is 0 only if a run was
    found or BOARD was given, and each has confirmed zero current.
    """
    from smarttouch.boards.run_registry import registry_folder, stop_all

    answers = stop_all()
    for answer in answers:
        typer.echo(f"{answer.sentence}.", err=not answer.at_zero)
    if not answers:
        typer.echo(f"No run is registered in {registry_folder()}.", err=True)
    if url is not None:
        _zero(url)
        typer.echo(f"All electrodes of {url} are at zero.")
    if not all(answer.at_zero for answer in answers):
        raise typer.Exit(2)
    if not answers and url is None:
        raise typer.Exit(1)


@drives_a_board
def _zero(url: str) -> None:
    """Set a board to zero by opening and closing it."""
    from smarttouch.running.display import open_display

    with open_display(url).opened():
        pass
