"""``smarttouch calibrate``: one device on one finger, measured, and written to a profile."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from smarttouch.cli.driving import drives_a_board, opened, the_stop

if TYPE_CHECKING:
    from smarttouch.calibrate.profile_file import ProfileFile

calibrate = typer.Typer(
    help="Measure one device on one finger, and write a profile of it.", no_args_is_help=True
)

_Start = Annotated[
    str | None,
    typer.Option("--profile", metavar="NAME|FILE", help="What a new --output starts from."),
]
_Output = Annotated[Path, typer.Option(metavar="FILE.toml", help="The profile to write.")]
_Overwrite = Annotated[bool, typer.Option("--overwrite", help="Measure what --output has already.")]
_Yes = Annotated[bool, typer.Option("--yes", help="Ask nothing: everything is in place.")]
_Simulate = Annotated[bool, typer.Option("--simulate", help="Walk through it without hardware.")]
_Frames = Annotated[int, typer.Option(metavar="N", min=1, help="Frames to take the mean of.")]
_SensorUrl = Annotated[
    str | None, typer.Option(metavar="URL", help="camera:0, serial-array:PORT, ...")
]
_BoardUrl = Annotated[
    str,
    typer.Option(metavar="URL", help="emulator:, kajimoto61:PORT, etactilekit:PORT, link:PORT"),
]


@calibrate.command()
def optics(
    output: _Output,
    sensor: _SensorUrl = None,
    dark: Annotated[
        str | None, typer.Option(metavar="URL", help="Dark frames from here: frames:DIR, ...")
    ] = None,
    white: Annotated[
        str | None, typer.Option(metavar="URL", help="Frames of white paper from here.")
    ] = None,
    frames: _Frames = 16,
    profile: _Start = None,
    overwrite: _Overwrite = False,
    yes: _Yes = False,
    simulate: _Simulate = False,
) -> None:
    """Dark level and gain of every pixel, by the sensor covered and on blank white paper."""
    from smarttouch.calibrate.optics import measure_optics
    from smarttouch.calibrate.tables import show_optics
    from smarttouch.cli.calibrate_steps import ask, images_of, missing

    file = _profile_file("optics", profile, output, overwrite, simulate)
    if simulate:
        from smarttouch.calibrate.simulated import SimulatedPatch

        of = file.profile.optics
        patch = SimulatedPatch((of.sensor_rows, of.sensor_columns), dead=2, hot=1)
        seen = [patch.images(frames, light=light) for light in (False, True)]
    else:
        sources = (dark or sensor, white or sensor)
        if None in sources:
            raise missing("--sensor", "give --sensor, or --dark and --white, or --simulate")
        asked = ("Cover the sensor: no light.", "Put it on blank white paper, in its usual light.")
        seen = []
        for source, question in zip(sources, asked, strict=True):
            assert source is not None
            ask(question, yes or source != sensor)
            seen.append(images_of(source, file.profile, frames, corrected=False))
    found = measure_optics(*seen)
    show_optics(found)
    field_file = file.beside("flat-field.npz")
    file.set("optics.flat_field", field_file.name)
    _finish(file, "optics", found.sentence(), simulate, {field_file: found.field.to_bytes()})


@calibrate.command()
def registration(
    output: Annotated[
        Path | None, typer.Option(metavar="FILE.toml", help="The profile to write.")
    ] = None,
    sensor: _SensorUrl = None,
    target: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Write the target, to be printed.")
    ] = None,
    dot_pitch_mm: Annotated[
        float | None, typer.Option(metavar="MM", help="Of the target; to suit the field if none.")
    ] = None,
    center: Annotated[
        str,
        typer.Option(metavar="target|image", help="What lies in the middle of the array."),
    ] = "target",
    frames: _Frames = 16,
    profile: _Start = None,
    overwrite: _Overwrite = False,
    yes: _Yes = False,
    simulate: _Simulate = False,
) -> None:
    """Where in the sensor's image each electrode's point lies, by a printed target."""
    from smarttouch.calibrate.register import register
    from smarttouch.calibrate.tables import show_registration
    from smarttouch.calibrate.target import target_for
    from smarttouch.cli.calibrate_steps import ask, images_of, missing
    from smarttouch.cli.files import not_offered
    from smarttouch.errors import CalibrationError
    from smarttouch.profile import DEFAULT_PROFILE, load_profile
    from smarttouch.sources.flat_field import mean_image

    if center not in ("target", "image"):
        raise not_offered("--center", center, ("target", "image"), CalibrationError)
    begun = None if output is None or not output.exists() else str(output)
    grid = target_for(load_profile(profile or begun or DEFAULT_PROFILE), dot_pitch_mm)
    if target is not None:
        if target.exists() and not overwrite:
            message = f"{target} exists already: give another --target, or --overwrite"
            raise CalibrationError(
                message, about="file", problem="exists", value=target, remedy="--overwrite"
            )
        grid.draw(target)
        typer.echo(f"{target}: dots {grid.pitch_mm:g} mm apart; print it at 100 %, black on white.")
    if output is None:
        if target is None or sensor is not None or simulate:
            message = "give --output FILE.toml for what is measured"
            raise CalibrationError(message, about="--output", problem="missing")
        return
    file = _profile_file("registration", profile, output, overwrite, simulate)
    if simulate:
        from smarttouch.calibrate.view import bench_view

        image = bench_view(grid, file.profile.optics)
    elif sensor is None:
        raise missing("--sensor", "give --sensor, or --simulate")
    else:
        ask("Lay the target under the sensor, the L upright under the array's middle.", yes)
        mean = mean_image(images_of(sensor, file.profile, frames, corrected=True))
        image = mean.round().astype("uint8")
    found = register(image, file.profile, grid, "target" if center == "target" else "image")
    show_registration(found)
    file.set("optics.homography", [float(f"{each:.12g}") for each in found.homography.ravel()])
    file.set("optics.sensor_columns", found.shape[1])
    file.set("optics.sensor_rows", found.shape[0])
    _finish(file, "registration", found.sentence(), simulate)


@calibrate.command()
def force(
    output: _Output,
    cell: Annotated[
        str | None, typer.Option(metavar="URL", help="hx711:PORT or loadcell:PORT")
    ] = None,
    weights: Annotated[
        str | None,
        typer.Option(metavar="G,G,...", help="Grams, in order; asked for one by one if none."),
    ] = None,
    seconds: Annotated[float, typer.Option(metavar="S", help="To read each weight for.")] = 2.0,
    profile: _Start = None,
    overwrite: _Overwrite = False,
    yes: _Yes = False,
    simulate: _Simulate = False,
) -> None:
    """The load cell's curve, by known weights; one given twice tells the hysteresis."""
    from smarttouch.calibrate.force_curve import fit_curve
    from smarttouch.calibrate.tables import show_force
    from smarttouch.cli.calibrate_steps import missing, parse_grams, weigh_all, weigh_simulated
    from smarttouch.errors import CalibrationError

    if not 0 < seconds <= 600:
        message = f"--seconds {seconds:g} must be above 0 and at most 600"
        raise CalibrationError(message, about="--seconds", value=seconds, allowed=(0, 600))
    listed = None if weights is None else parse_grams(weights)
    file = _profile_file("force", profile, output, overwrite, simulate)
    if simulate:
        weighings = weigh_simulated(listed, seconds)
    elif cell is None:
        raise missing("--cell", "give --cell hx711:PORT or loadcell:PORT, or --simulate")
    else:
        weighings = weigh_all(cell, listed, seconds, yes)
    found = fit_curve(weighings, file.profile.force)
    show_force(found)
    file.set("force.curve", found.curve)
    _finish(file, "force", found.sentence(), simulate)


@calibrate.command()
@drives_a_board
def thresholds(
    output: _Output,
    board: _BoardUrl = "emulator:",
    electrodes: Annotated[
        str | None, typer.Option(metavar="0-7,12", help="Which; all that are not masked if none.")
    ] = None,
    adaptive: Annotated[
        bool, typer.Option("--adaptive", help="Yes-or-no trials after the rising current.")
    ] = False,
    repeats: Annotated[
        int, typer.Option(metavar="N", min=1, max=10, help="Of the rising current.")
    ] = 3,
    seed: Annotated[int, typer.Option(min=0, help="Of pauses, starts and the simulation.")] = 0,
    profile: _Start = None,
    overwrite: _Overwrite = False,
    simulate: _Simulate = False,
) -> None:
    """Per electrode, the current first felt and the strongest that is comfortable."""
    from smarttouch.boards.board import make_board, usual_profile
    from smarttouch.calibrate.found import filled, parse_electrodes, sentence
    from smarttouch.calibrate.progress import Progress
    from smarttouch.calibrate.session import StoppedError
    from smarttouch.calibrate.stimulus import measuring_limits
    from smarttouch.cli.calibrate_steps import feel_all, require_subject
    from smarttouch.errors import BoardStoppedError, CalibrationError

    start = profile or usual_profile(board)
    simulated = simulate or board.startswith("emulator:")
    file = _profile_file("thresholds", profile, output, overwrite, simulated, usual_profile(board))
    chosen = file.profile
    sites = parse_electrodes(electrodes, chosen)
    require_subject(simulate, board)
    stop = the_stop()
    # A simulated subject does not wait, and the emulator's clock would refuse to be hurried.
    url = "simulated:" if simulate and board == "emulator:" else board
    display = make_board(url, measuring_limits(chosen), chosen.output)
    progress = Progress(
        file.beside("thresholds.json"),
        {
            "profile": start, "electrodes": len(chosen.electrodes),
            "board": board.partition(":")[0],
            "pulse_us": chosen.pulse.width_us, "adaptive": adaptive, "repeats": repeats,
            "simulate": simulate,
        },
    )  # fmt: skip
    try:
        with progress, opened(display, stop):
            feel_all(display, chosen, sites, progress, stop, adaptive, repeats, seed, simulate)
    except (StoppedError, BoardStoppedError):
        left = len(set(sites) - set(progress.found))
        raise CalibrationError(
            f"stopped, all electrodes are off: {left} of {len(sites)} electrodes are left, the "
            "same command goes on there",
            about="thresholds",
            problem="stopped",
            value=left,
        ) from None
    threshold_ma, comfort_ma = filled(chosen, progress.found)
    file.set("perception.threshold_ma", threshold_ma)
    file.set("perception.comfort_ma", comfort_ma)
    told = sentence(progress.found, adaptive=adaptive)
    _finish(file, "thresholds", told, simulated)
    progress.forget()


@calibrate.command()
@drives_a_board
def contact(
    output: _Output,
    board: _BoardUrl = "emulator:",
    repeats: Annotated[int, typer.Option(metavar="N", min=1, max=100, help="Measurements.")] = 5,
    profile: _Start = None,
    overwrite: _Overwrite = False,
) -> None:
    """Which electrodes touch the skin, by repeated measurements of their impedance."""
    from smarttouch.boards.board import make_board, usual_profile
    from smarttouch.calibrate.contact import judge_contact
    from smarttouch.calibrate.tables import show_contact
    from smarttouch.stimulation.safety import SafetyLimits

    simulated = board.startswith("emulator:")
    file = _profile_file("contact", profile, output, overwrite, simulated, usual_profile(board))
    chosen = file.profile
    with opened(make_board(board, SafetyLimits.of(chosen), chosen.output)) as display:
        found = judge_contact([display.measure() for _ in range(repeats)])
    show_contact(found, chosen.electrodes)
    masked = found.masked(chosen)
    still = sorted(set(chosen.output.masked) - set(found.broken))
    if still:
        typer.echo(f"Masked before, and still: {still}; if they are good, remove them by hand.")
    if masked != list(chosen.output.masked):
        typer.echo(f"Masked now: {masked}; kernels are designed without them at the next start.")
    file.set("output.impedance_kohm", found.impedances(chosen))
    file.set("output.masked", masked)
    _finish(file, "contact", found.sentence(), simulated)


def _profile_file(
    part: str,
    start: str | None,
    output: Path,
    overwrite: bool,
    simulated: bool,
    usual: str | None = None,
) -> "ProfileFile":
    from smarttouch.calibrate.profile_file import file_to_calibrate
    from smarttouch.cli.profiles import tell_changes
    from smarttouch.profile import DEFAULT_PROFILE

    file = file_to_calibrate(
        part, start, usual or DEFAULT_PROFILE, output, overwrite, simulated=simulated
    )
    tell_changes(file)
    return file


def _finish(
    file: "ProfileFile",
    what: str,
    found: str,
    simulated: bool,
    others: dict[Path, bytes] | None = None,
) -> None:
    """Write the profile; say what was found, and where it is."""
    told = f"simulated: {found}" if simulated else found
    file.note(what, told)
    file.write(others)
    typer.echo(told)
    typer.echo("written: " + ", ".join(str(each) for each in (*(others or {}), file.output)))
