"""``smarttouch calibrate``: measure a device on a finger, and write a profile."""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from smarttouch.base.errors import BoardStoppedError, CalibrationError, require_within
from smarttouch.cli.options import (
    Commands,
    ForceOption,
    OptionGroup,
    ProfileOption,
    argument,
    option,
    takes_options,
)
from smarttouch.views.keys_and_signals import command_stop, drives_a_board

if TYPE_CHECKING:
    from smarttouch.experiments.contact_and_force_calibration import ProfileFile


@dataclass(frozen=True, kw_only=True)
class CalibrationOptions(OptionGroup):
    """Options common to all calibrations."""

    output: Annotated[Path | None, option("Write results to this profile.", "FILE.toml")] = None
    profile: Annotated[
        str | None, option("If --output is a new file, start from this profile.", "NAME|FILE")
    ] = None
    overwrite: Annotated[
        bool, option("Replace an earlier result of the same calibration.", None, "--overwrite")
    ] = False

    def file(
        self, part: str, simulated: bool = False, board_url: str = "simulated:"
    ) -> "ProfileFile":
        """Open the profile that a calibration changes."""
        from smarttouch.boards.open import default_profile
        from smarttouch.experiments.contact_and_force_calibration import file_to_calibrate

        if self.output is None:
            raise CalibrationError("no file for the results: add --output FILE.toml")
        fallback = default_profile(board_url)
        return file_to_calibrate(
            part, self.profile, fallback, self.output, self.overwrite, simulated=simulated
        )


def _typed_weights() -> Iterator[float]:
    """Ask for the weights that the user puts on a load cell, and yield them, g."""
    from smarttouch.experiments.contact_and_force_calibration import parse_grams

    while answer := _answer("Grams on the load cell, at rest (Enter: no more weights)"):
        yield parse_grams(answer)


def _answer(question: str) -> str:
    try:
        return str(typer.prompt(question, default="", show_default=False))
    except typer.Abort:
        message = "nobody could answer, so nothing was written: run this command in a terminal"
        raise CalibrationError(message) from None


def finish(
    file: "ProfileFile",
    what: str,
    found: str,
    simulated: bool = False,
    others: dict[Path, bytes] | None = None,
) -> None:
    """Write a calibration into its profile; print the result and the paths."""
    result = f"simulated: {found}" if simulated else found
    file.note(what, result)
    file.write(others)
    typer.echo(result)
    typer.echo("written: " + ", ".join(str(path) for path in (*(others or {}), file.output)))


calibrate: Commands = Commands(
    help="Measure a device on a finger, and write a profile.", no_args_is_help=True
)

_SIMULATED = ("emulator:", "simulated:", "memory:")
_FRAMES = 16  # frames to average
_REPEATS = 5  # number of measurements of impedance
_SourceUrl = Annotated[str | None, option("Take frames from this source, such as camera:0.", "URL")]
_BoardUrl = Annotated[
    str,
    option("Drive this board: emulator:, kajimoto61:PORT, etactilekit:PORT or link:PORT.", "URL"),
]


@calibrate.command()
@takes_options
def optics(
    calibration: CalibrationOptions,
    source: _SourceUrl = None,
) -> None:
    """Measure each pixel's dark level on the covered sensor, then its gain on blank white paper."""
    from smarttouch.experiments import sensor_calibration

    file = calibration.file("optics")
    if source is None:
        raise CalibrationError("no source of frames: add --source, for example --source camera:0")
    seen = []
    for asked in ("Cover the sensor: no light.", "Put the sensor on white paper, in normal light."):
        _answer(f"{asked} Then press Enter")
        seen.append(sensor_calibration.images_of(source, file.profile, _FRAMES, corrected=False))
    flat_field = sensor_calibration.measure_optics(*seen)
    field_file = file.beside("flat-field.npz")
    file.set("optics.flat_field", field_file.name)
    finish(file, "optics", flat_field.sentence(), others={field_file: flat_field.field.to_bytes()})


@calibrate.command()
@takes_options
def registration(
    calibration: CalibrationOptions,
    source: _SourceUrl = None,
    target: Annotated[Path | None, option("Write the target for printing.", "FILE.png")] = None,
) -> None:
    """Find the position of each electrode in the sensor's image, with a printed target."""
    from smarttouch.experiments.sensor_calibration import images_of, register, target_for
    from smarttouch.profile import DEFAULT_PROFILE, load_profile
    from smarttouch.sources.flat_field_and_motion import mean_image

    output = calibration.output
    begun = str(output) if output is not None and output.exists() else DEFAULT_PROFILE
    printed_target = target_for(load_profile(calibration.profile or begun))
    if target is not None:
        if target.exists() and not calibration.overwrite:
            message = f"{target} exists: give another file, or add --overwrite"
            raise CalibrationError(message)
        printed_target.draw(target)
        typer.echo(
            f"{target}: {printed_target.side_mm:g} mm across; print it at 100 %, black on white."
        )
    if output is None and target is not None and source is None:
        return
    file = calibration.file("registration")
    if source is None:
        raise CalibrationError("no source of frames: add --source, for example --source camera:0")
    _answer(
        "Lay the target under the sensor, text upright, centered under the array. Then press Enter"
    )
    mean = mean_image(images_of(source, file.profile, _FRAMES, corrected=True))
    image = mean.round().astype("uint8")
    registered = register(image, file.profile, printed_target)
    file.set(
        "optics.homography", [float(f"{number:.12g}") for number in registered.homography.ravel()]
    )
    file.set("optics.sensor_columns", registered.shape[1])
    file.set("optics.sensor_rows", registered.shape[0])
    finish(file, "registration", registered.sentence())


@calibrate.command()
@takes_options
def force(
    calibration: CalibrationOptions,
    cell: Annotated[
        str | None, option("Read this load cell: hx711:PORT or loadcell:PORT.", "URL")
    ] = None,
    seconds: Annotated[float, option("Measure each weight for this time.", "S")] = 2.0,
) -> None:
    """Measure the curve that converts load cell readings to force, with known weights."""
    from smarttouch.experiments.contact_and_force_calibration import fit_curve, weigh_on

    require_within(CalibrationError, "seconds", seconds, 0, 600, above=True)
    file = calibration.file("force")
    if cell is None:
        raise CalibrationError("no load cell: add --cell hx711:PORT or --cell loadcell:PORT")
    fitted = fit_curve(weigh_on(cell, _typed_weights(), seconds), file.profile.force)
    file.set("force.curve", fitted.curve)
    finish(file, "force", fitted.sentence())


@calibrate.command()
@drives_a_board
@takes_options
def thresholds(
    calibration: CalibrationOptions,
    board: _BoardUrl = "emulator:",
    electrodes: Annotated[
        str | None, option("Measure these electrodes (default: all that are not masked).", "0-7,12")
    ] = None,
    force: ForceOption = None,
) -> None:
    """Measure the detection threshold and the comfort level of each electrode."""
    from smarttouch.boards.open import default_profile
    from smarttouch.experiments.thresholds import ThresholdProcedure
    from smarttouch.profile.profile import require_driven
    from smarttouch.views.keys_and_signals import keyboard_listener

    simulated = board.startswith(_SIMULATED)
    file = calibration.file("thresholds", simulated, board)
    sites = file.profile.driven
    if electrodes is not None:
        sites = require_driven(file.profile, electrodes, CalibrationError, "electrodes")
    if not sys.stdin.isatty():
        raise CalibrationError("there is no keyboard for answers: run this command in a terminal")
    procedure = ThresholdProcedure(
        start=calibration.profile or default_profile(board), file=file, board_url=board,
        sites=sites.tolist(),
    )  # fmt: skip
    with procedure.progress() as progress:
        try:
            procedure.measure(progress, keyboard_listener, typer.echo, command_stop(), force)
        except BoardStoppedError:
            raise procedure.stopped(progress) from None
    finish(file, "thresholds", procedure.set_results(progress), simulated)
    progress.forget()


@calibrate.command()
@drives_a_board
@takes_options
def contact(
    calibration: CalibrationOptions,
    board: _BoardUrl = "emulator:",
) -> None:
    """Find the electrodes that touch the skin, by repeated measurements of impedance."""
    from smarttouch.experiments.contact_and_force_calibration import judge_contact, measure_contact
    from smarttouch.running.display import open_display

    simulated = board.startswith("emulator:")
    file = calibration.file("contact", simulated, board)
    chosen = file.profile
    judged = judge_contact(measure_contact(lambda: open_display(board, chosen).opened(), _REPEATS))
    masked = judged.masked(chosen)
    still = sorted(set(chosen.output.masked) - set(judged.broken))
    if still:
        typer.echo(f"Still masked: {still}. If one of them works, remove it from output.masked.")
    if masked != list(chosen.output.masked):
        typer.echo(f"Masked: {masked}. The next run designs kernels without these electrodes.")
    file.set("output.impedance_kohm", judged.impedances(chosen))
    file.set("output.masked", masked)
    finish(file, "contact", judged.sentence(), simulated)


@calibrate.command()
def scale(
    url: Annotated[str, argument("The board: kajimoto61:PORT, link:PORT, ...", "URL")],
    volts: Annotated[float, option("Peak voltage that you measured.", "V")],
    ohm: Annotated[
        float, option("Resistance between the electrode and all others.", "OHM")
    ] = 1000.0,
    current_ma: Annotated[float, option("Nominal current of the pulses.", "MA")] = 1.0,
    profile: ProfileOption = None,
) -> None:
    """Compute the scale of a board's current from the voltage across a resistor.

    Connect the resistor in place of the finger, and make pulses with smarttouch devices test
    --electrode N --current-ma 1.
    """
    from smarttouch.profile.kit_scales import measured_scale
    from smarttouch.running.display import open_display

    before_ua = getattr(open_display(url, profile).board.driver, "ua_per_count", None)
    ratio, scale_ua = measured_scale(url.partition(":")[0], before_ua, volts, ohm, current_ma)
    typer.echo(f"{1000 * volts / ohm:.3f} mA flowed, {ratio:.3f} times the nominal current.")
    if scale_ua is not None:
        typer.echo(f"Write into this board's profile:\n\n[output]\nua_per_count = {scale_ua:.4g}")
