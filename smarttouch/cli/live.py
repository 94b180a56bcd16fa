"""``smarttouch live``: from a sensor to current in the skin."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from smarttouch.boards.board import Board, BoardReport
    from smarttouch.live import Tally
    from smarttouch.modes.bank import KernelBank
    from smarttouch.primary import Primary
    from smarttouch.profile import Profile
    from smarttouch.sensing.frame import Sensor


def live(
    sensor: Annotated[
        str | None,
        typer.Option(metavar="URL", help="page:FILE or text:STRING; a sample page if not given."),
    ] = None,
    board: Annotated[
        str,
        typer.Option(metavar="URL", help="emulator:, kajimoto61:PORT, etactilekit:PORT, link:PORT"),
    ] = "emulator:",
    profile: Annotated[
        str | None,
        typer.Option(metavar="NAME|FILE", help="Device and finger; the board's usual if none."),
    ] = None,
    mode: Annotated[str, typer.Option(metavar="RA|SAI", help="Which afferents to reach.")] = "RA",
    rate: Annotated[
        float | None, typer.Option(metavar="HZ", help="Sequences a second; the profile's if none.")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(metavar="S", help="Longest run, wall time.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the virtual finger's and sensor's noise.")] = 0,
    dpi: Annotated[
        float | None, typer.Option(help="Resolution of a page file that does not say.")
    ] = None,
    page_width_mm: Annotated[float | None, typer.Option(help="Or the width of its page.")] = None,
    speed: Annotated[
        float, typer.Option(metavar="MM/S", help="Of the virtual finger along a line.")
    ] = 40.0,
    path: Annotated[
        Path | None,
        typer.Option(metavar="CSV", help="A recorded path: time_s,x_mm,y_mm,angle_deg,force_n"),
    ] = None,
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
        typer.Option("--balance", help="Turn the polarity of scans to keep net charge at zero."),
    ] = False,
    felt: Annotated[
        Path | None, typer.Option(metavar="PNG", help="Draw the page and what the skin got.")
    ] = None,
    record: Annotated[Path | None, typer.Option(metavar="MCAP", help="Keep the run.")] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the figures of the run.")
    ] = None,
    quiet: Annotated[bool, typer.Option(help="Show nothing but errors.")] = False,
) -> None:
    """Let a finger feel what a sensor sees, until the page ends or Ctrl-C."""
    import contextlib
    import tempfile

    from smarttouch.boards.board import make_board, usual_profile
    from smarttouch.cli.files import parse_mode, require_folder, write_json
    from smarttouch.cli.progress import bank_progress
    from smarttouch.cli.regulation import make_regulator, masked_where_broken
    from smarttouch.cli.screen import Screen
    from smarttouch.errors import SmartTouchError
    from smarttouch.live import StopRequest, Tally, run, settled, stop_on_signals
    from smarttouch.modes.bank import load_bank
    from smarttouch.pipeline import Pipeline
    from smarttouch.primary import Primary
    from smarttouch.profile import load_profile
    from smarttouch.resources import data_folder
    from smarttouch.scan.safety import SafetyLimits
    from smarttouch.sensing import open_sensor

    primary = parse_mode(mode, (Primary.RA, Primary.SAI))
    if seconds is not None and not seconds > 0:
        raise SmartTouchError(f"--seconds {seconds:g} must be above 0")
    chosen = load_profile(profile or usual_profile(board))
    for output in (felt, record, json_file):
        require_folder(output)
    if felt is not None and not board.startswith("emulator:"):
        raise SmartTouchError(
            f"--felt needs a board that reports every pulse, and {board!r} does not: "
            "use --board emulator:"
        )
    stop, tally = StopRequest(), Tally()
    with contextlib.ExitStack() as stack:
        source = stack.enter_context(
            open_sensor(
                sensor or f"page:{data_folder('sample_images') / 'page.png'}",
                chosen,
                seed=seed,
                dpi=dpi,
                page_width_mm=page_width_mm,
                speed_mm_s=speed,
                path=path,
                light_on_dark=light_on_dark,
            )
        )
        limits = SafetyLimits.of(chosen)
        options: dict[str, Any] = {}
        if felt is not None:
            books = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="smarttouch-")))
            options["books"] = books
        display = make_board(board, limits, chosen.output, **options)
        if measure:
            with display:
                chosen = masked_where_broken(display, chosen, quiet)
        with bank_progress(quiet) as progress:
            bank = load_bank(chosen, progress)
        # Until here an interrupt may end the program at once: no board pulses.
        stack.enter_context(stop_on_signals(stop))
        pipeline = Pipeline(chosen, bank, primary, rate, light_on_dark, display.timing)
        drawing = None if felt is None else _drawing(source, chosen, bank, primary)
        observers = [] if drawing is None else [drawing.watch]
        if record is not None:
            recorder = _recorder(record, chosen, {"sensor": source.title, "board": board}, seed)
            stack.callback(recorder.close)
            observers.append(
                lambda sent: recorder.record(sent, display.acknowledged, display.refused)
            )
        report: BoardReport | None = None
        ended = "fault"
        try:
            with settled(pipeline), display:
                regulator = make_regulator(display, chosen, hold, balance, quiet)
                screen = Screen(source, chosen, primary, board, display, tally, quiet)
                with screen:
                    run(
                        source,
                        pipeline,
                        display,
                        stop=stop,
                        tally=tally,
                        seconds=seconds,
                        observers=[*observers, screen.show],
                        regulator=regulator,
                    )
                report = display.report()
            display.notes += regulator.notes()
            ended = stop.reason or "end of the page"
        finally:
            figures = _figures(tally, source, display, report, pipeline.period_us, ended)
            if json_file is not None:
                write_json(json_file, figures)
        if felt is not None and drawing is not None:
            from smarttouch.boards.emulator.books import read_delivered

            numbers, _, current_ua = read_delivered(books)
            drawing.deliver(numbers, current_ua)
            drawing.save(felt)
    if not quiet:
        written = [each for each in (felt, record, json_file) if each is not None]
        screen.summarize(figures, display.notes, written)


def _drawing(source: "Sensor", profile: "Profile", bank: "KernelBank", primary: "Primary") -> Any:
    from smarttouch.errors import SmartTouchError
    from smarttouch.felt import FeltImage

    page = getattr(source, "page", None)
    if page is None:
        raise SmartTouchError(f"--felt needs a page to draw beside, and {source.title} has none")
    return FeltImage(profile, bank, primary, page)


def _recorder(path: Path, profile: "Profile", settings: dict[str, str], seed: int) -> Any:
    from smarttouch import __version__
    from smarttouch.recording import Recorder

    about = {
        **settings,
        "seed": str(seed),
        "version": __version__,
        "profile": profile.model_dump_json(),
    }
    return Recorder(path, about)


def _figures(
    tally: "Tally",
    source: "Sensor",
    board: "Board",
    report: "BoardReport | None",
    asked_period_us: int,
    ended: str,
) -> dict[str, Any]:
    """Return what ``--json`` writes; the board's own figures are null after a fault."""
    return {
        "ended": ended,
        "seconds": tally.seconds,
        "frames": tally.frames,
        "sequences": tally.frames,
        "slots": tally.slots,
        "pulses": report and report.pulses,
        "acknowledged": board.acknowledged,
        "refused": board.refused,
        "dropped_frames": source.dropped_frames,
        "late_frames": tally.late,
        "replaced": board.replaced,
        "restarts": tally.restarts,
        "lifts": tally.lifts,
        "reported_by": report and report.by,
        "rate_asked_hz": 1e6 / asked_period_us,
        "rate_hz": tally.frames / tally.seconds if tally.seconds else 0.0,
        "lowest_rate_hz": tally.lowest_rate_hz if tally.frames else None,
        "slowed_sequences": tally.slowed,
        "latency_us": tally.latency(),
        "max_current_ma": report and report.max_current_ma,
        "max_charge_uc": report and report.max_charge_uc,
        "max_net_charge_uc": report and report.max_net_charge_uc,
        "emulator_violations": report.violations if report and report.by == "board" else None,
        "active_fraction": tally.active / tally.frames if tally.frames else 0.0,
    }
