"""What the calibrations ask of someone: things in place, weights, and answers to current."""

import math
import queue
import sys
from collections.abc import Sequence

import typer

from smarttouch.boards.board import Board
from smarttouch.calibrate.force_curve import Weighing, weigh
from smarttouch.calibrate.frames import Images
from smarttouch.calibrate.limits import Thresholds
from smarttouch.calibrate.progress import Progress
from smarttouch.calibrate.session import Person, Subject, ThresholdSession, simulated_subjects
from smarttouch.calibrate.stimulus import ceiling_ma
from smarttouch.cli.keyboard import keys_heeded
from smarttouch.errors import CalibrationError
from smarttouch.profile import Profile
from smarttouch.stopping import StopRequest


def missing(about: str, message: str) -> CalibrationError:
    """Return the error that nothing is given to measure with, which ``--simulate`` stands for."""
    return CalibrationError(message, about=about, problem="missing", remedy="--simulate")


def require_subject(simulate: bool, board_url: str) -> None:
    """Raise unless somebody can feel what a board does, and answer."""
    if simulate and not board_url.startswith(("emulator:", "simulated:", "memory:")):
        raise CalibrationError(
            f"--simulate answers for nobody: no current of its flows through {board_url!r}, only "
            "through emulator:",
            about="--board",
            problem="conflict",
            value=board_url,
            allowed=("emulator:",),
        )
    if not simulate and not sys.stdin.isatty():
        raise missing(
            "keyboard", "there is no keyboard to answer on: use a terminal, or --simulate"
        )


def ask(what: str, yes: bool) -> None:
    """Wait until something is in place."""
    if yes:
        return
    try:
        typer.prompt(f"{what} Then press Enter", default="", show_default=False)
    except typer.Abort:
        message = "nobody answered, nothing was written: --yes asks nothing"
        raise CalibrationError(message, about="answer", problem="missing", remedy="--yes") from None


def images_of(url: str, profile: Profile, count: int, *, corrected: bool) -> Images:
    """Return the next images of a sensor; with the profile's flat field, or without."""
    from smarttouch.calibrate.frames import collect_images, uncorrected
    from smarttouch.sources import open_sensor

    # What lies in files need not be waited for.
    unpaced = True if url.startswith(("frames:", "video:")) else None
    seen_by = profile if corrected else uncorrected(profile)
    with open_sensor(url, seen_by, unpaced=unpaced) as source:
        return collect_images(source, count)


def parse_grams(text: str) -> list[float]:
    """Return what ``0,20,50`` names."""
    try:
        grams = [float(each) for each in text.split(",")]
    except ValueError:
        grams = [math.nan]
    if not all(0 <= each < math.inf for each in grams):
        message = f"weights {text!r} are not understood: give grams like 0,20,50,100"
        raise CalibrationError(message, about="--weights", problem="malformed", value=text)
    return grams


def weigh_all(
    url: str, listed: Sequence[float] | None, seconds: float, yes: bool
) -> list[Weighing]:
    """Weigh what someone lays on a load cell: what is listed, or what is asked for."""
    from smarttouch.sources.forces.load_cell import open_cell

    found = []
    with open_cell(url) as cell:
        if listed is not None:
            for grams in listed:
                ask(f"{grams:g} g on the cell, at rest.", yes)
                found.append(weigh(cell, grams, seconds))
            return found
        while True:
            try:
                answer = typer.prompt(
                    "Grams on the cell, at rest (Enter: no more)", default="", show_default=False
                )
            except typer.Abort:
                message = "nobody answered, nothing was written: give --weights"
                raise CalibrationError(
                    message, about="answer", problem="missing", remedy="--weights"
                ) from None
            if not answer:
                return found
            found.append(weigh(cell, parse_grams(answer)[0], seconds))


def weigh_simulated(listed: Sequence[float] | None, seconds: float) -> list[Weighing]:
    """Weigh on a cell that does not exist."""
    from smarttouch.calibrate.simulated import SimulatedCell

    cell, found = SimulatedCell(bend=0.02, hysteresis_n=0.005), []
    for grams in listed or (0, 20, 50, 100, 50, 20, 0):
        cell.put(grams)
        found.append(weigh(cell, grams, seconds))
    return found


def feel_all(
    display: Board,
    profile: Profile,
    sites: Sequence[int],
    progress: Progress,
    stop: StopRequest,
    adaptive: bool,
    repeats: int,
    seed: int,
    simulate: bool,
) -> None:
    """Measure electrode after electrode on an open board, with whoever is there to feel."""

    def show(site: int, found: Thresholds) -> None:
        said = f"threshold {found.threshold_ma:.2f} mA, comfortable to {found.comfort_ma:.2f} mA"
        said = said if found.felt else "not felt up to the ceiling"
        room = "" if found.usable or not found.felt else " (no room between them: not used)"
        typer.echo(f"electrode {site}: {said}{room}")

    keys: queue.SimpleQueue[str] = queue.SimpleQueue()

    def next_key(seconds: float) -> str | None:
        try:
            return keys.get(timeout=seconds)
        except queue.Empty:
            return None

    tops = [ceiling_ma(profile, site, display) for site in range(len(profile.electrodes))]
    subject: Subject
    if simulate:
        subject = simulated_subjects(profile, tops, seed)
    else:
        subject = Person(next_key, typer.echo, stop.event.is_set)
        if display.capabilities.time_to_zero_ms is None:
            typer.echo("This board goes on if its line breaks: keep its switch in reach.")
        typer.echo(
            f"Current rises to {max(tops):.2f} mA at most. Press a key when you feel it, and again "
            "when it is strong enough; q or Esc stops at once."
        )
    session = ThresholdSession(
        display, profile, subject, adaptive, repeats, seed, simulate, stop.event.is_set
    )
    with keys_heeded(keys.put):
        session.run(sites, progress, show)
