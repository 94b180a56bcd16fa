"""``smarttouch live``: from a sensor to current in the skin."""

from pathlib import Path
from typing import Annotated

import typer

from smarttouch.cli.driving import drives_a_board
from smarttouch.cli.options import (
    FeltOption,
    ForceOption,
    IntensityOption,
    JsonOption,
    MarkersOption,
    ModeOption,
    ProfileOption,
    QuietOption,
    RateOption,
    RecordOption,
    ScanOption,
    SecondsOption,
)


@drives_a_board
def live(
    sensor: Annotated[
        str | None,
        typer.Option(
            metavar="URL",
            help="page:FILE, text:STRING, camera:N, video:FILE, frames:FOLDER, serial-array:PORT, "
            "recording:FILE; a sample page if not given.",
        ),
    ] = None,
    board: Annotated[
        str,
        typer.Option(metavar="URL", help="emulator:, kajimoto61:PORT, etactilekit:PORT, link:PORT"),
    ] = "emulator:",
    profile: ProfileOption = None,
    mode: ModeOption = "RA",
    scan: ScanOption = "auto",
    force: ForceOption = None,
    intensity: IntensityOption = None,
    softness: Annotated[
        float | None,
        typer.Option(metavar="0..1", help="1: SAI pulses at a constant rate; 0: follows force."),
    ] = None,
    rate: RateOption = None,
    seconds: SecondsOption = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Of the virtual finger's and sensor's noise.")
    ] = None,
    dpi: Annotated[
        float | None, typer.Option(help="Resolution of a page file that does not say.")
    ] = None,
    page_width_mm: Annotated[float | None, typer.Option(help="Or the width of its page.")] = None,
    speed: Annotated[
        float | None,
        typer.Option(metavar="MM/S", help="Of the virtual finger along a line; 40 if not given."),
    ] = None,
    path: Annotated[
        Path | None,
        typer.Option(metavar="CSV", help="A recorded path: time_s,x_mm,y_mm,angle_deg,force_n"),
    ] = None,
    size: Annotated[
        str | None, typer.Option(metavar="WxH", help="Of a camera's frames, 640x480.")
    ] = None,
    exposure: Annotated[
        float | None, typer.Option(help="Of a camera, in its driver's own unit.")
    ] = None,
    fps: Annotated[
        float | None, typer.Option(metavar="HZ", help="Of a camera, or of a folder of frames.")
    ] = None,
    unpaced: Annotated[
        bool, typer.Option("--unpaced", help="Every frame of a file, none passed over.")
    ] = False,
    baud: Annotated[int | None, typer.Option(help="Of a serial array.")] = None,
    light_on_dark: Annotated[bool, typer.Option(help="Print is lighter than paper.")] = False,
    measure: Annotated[
        bool, typer.Option("--measure", help="First find bad electrodes, and plan around them.")
    ] = False,
    hold: Annotated[
        str | None,
        typer.Option(metavar="charge|energy", help="Against drifting impedance, if the board can."),
    ] = None,
    balance: Annotated[
        bool,
        typer.Option(
            "--balance",
            help="Keep net charge at zero, by a weak recharge phase in each scan. Boards of one "
            "source reverse scans instead, and those drive the other class (SAI for RA).",
        ),
    ] = False,
    felt: FeltOption = None,
    record: RecordOption = None,
    subject: Annotated[str, typer.Option(help="Who feels it, for the recording.")] = "",
    note: Annotated[str, typer.Option(help="Anything else, for the recording.")] = "",
    markers: MarkersOption = False,
    json_file: JsonOption = None,
    quiet: QuietOption = False,
) -> None:
    """Let a finger feel what a sensor sees, until the page ends, a key or Ctrl-C."""
    import contextlib

    from smarttouch.boards.board import usual_profile
    from smarttouch.cli.files import parse_mode, parse_size
    from smarttouch.cli.plan import Plan
    from smarttouch.cli.session import play
    from smarttouch.cli.sharing import parse_scan
    from smarttouch.profile import load_profile
    from smarttouch.resources import data_folder
    from smarttouch.sources import open_sensor
    from smarttouch.sources.forces.force import open_force

    chosen = load_profile(profile or usual_profile(board))
    plan = Plan(
        sensor_url=sensor or f"page:{data_folder('sample_images') / 'page.png'}",
        board_url=board,
        mode=parse_mode(mode),
        sharing=parse_scan(scan, chosen, hold),
        rate_hz=rate,
        seconds=seconds,
        level=intensity,
        softness=softness,
        light_on_dark=light_on_dark,
        force_url=force,
        measure=measure,
        hold=hold,
        balance=balance,
        felt=felt,
        record=record,
        markers=markers,
        json_file=json_file,
        quiet=quiet,
        seed=seed or 0,
        subject=subject,
        note=note,
    )
    with contextlib.ExitStack() as stack:
        source = stack.enter_context(
            open_sensor(
                plan.sensor_url,
                chosen,
                light_on_dark=light_on_dark,
                seed=seed,
                dpi=dpi,
                page_width_mm=page_width_mm,
                speed_mm_s=speed,
                path=path,
                size=parse_size(size),
                exposure=exposure,
                fps=fps,
                unpaced=unpaced or None,
                baud=baud,
            )
        )
        pressing = None if force is None else stack.enter_context(open_force(force, chosen))
        play(plan, source, pressing, chosen)
