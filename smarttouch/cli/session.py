"""One run from an open sensor to a board: what ``live`` and ``replay`` share."""

import contextlib
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import typer

from smarttouch.boards.board import Board, BoardReport, make_board
from smarttouch.cli.files import require_folder, write_json
from smarttouch.cli.keyboard import LOST, keys_heeded
from smarttouch.cli.progress import bank_progress
from smarttouch.cli.regulation import make_regulator, masked_where_broken
from smarttouch.cli.run_figures import run_figures
from smarttouch.cli.running import announced
from smarttouch.cli.screen import Screen
from smarttouch.clock import SimulatedClock
from smarttouch.controls import STEP, Controls, StopRequest, Wish, stop_on_signals
from smarttouch.errors import SensorError, SmartTouchError
from smarttouch.imaging.mapping import Tone
from smarttouch.live import Sent, Tell, run, settled
from smarttouch.modes.bank import KernelBank, load_bank
from smarttouch.pipeline import Pipeline
from smarttouch.primary import Mode
from smarttouch.profile import Profile
from smarttouch.scan.safety import SafetyLimits
from smarttouch.sensing.forces.force import ForceSource
from smarttouch.sensing.frame import Sensor
from smarttouch.tally import Tally

_TELL_ALL = ("emulator:", "simulated:")
"""Boards that report every pulse."""
_NO_FINGER = (*_TELL_ALL, "memory:")
"""Boards that no finger is on."""


@dataclass
class Plan:
    """What a run is asked to be."""

    sensor_url: str
    board_url: str
    mode: Mode
    rate_hz: float | None = None
    seconds: float | None = None
    level: float | None = None
    softness: float | None = None
    light_on_dark: bool = False
    force_url: str | None = None
    measure: bool = False
    hold: str | None = None
    balance: bool = False
    tone: Tone | None = None
    felt: Path | None = None
    frames: Path | None = None
    record: Path | None = None
    json_file: Path | None = None
    quiet: bool = False
    seed: int = 0
    subject: str = ""
    note: str = ""
    controls: Callable[[Wish, tuple[Mode, ...]], Controls] = field(default=Controls)
    attend: Callable[[Board], Callable[[Sent], None]] | None = None
    """Given the open board, returns who is told of every step."""

    def __post_init__(self) -> None:
        for output in (self.felt, self.record, self.json_file):
            require_folder(output)
        if self.felt is not None and not self.board_url.startswith(_TELL_ALL):
            raise SmartTouchError(
                f"--felt needs a board that reports every pulse, and {self.board_url!r} does not: "
                "use --board emulator:"
            )
        for name, value in (("--intensity", self.level), ("--softness", self.softness)):
            if value is not None and not 0 <= value <= 1:
                raise SmartTouchError(f"{name} {value:g} must be from 0 to 1")
        if self.seconds is not None and not self.seconds > 0:
            raise SmartTouchError(f"--seconds {self.seconds:g} must be above 0")

    @property
    def first_level(self) -> float:
        """Intensity at the start: where someone can turn it up on a real board, nothing."""
        if self.level is not None:
            return self.level
        return 0.0 if sys.stdin.isatty() and not self.board_url.startswith(_NO_FINGER) else 1.0


def play(plan: Plan, source: Sensor, force: ForceSource | None, profile: Profile) -> None:
    """Let a finger feel what a sensor sees, until it ends or a user ends it."""
    stop, tally = StopRequest(), Tally()
    with contextlib.ExitStack() as stack:
        options: dict[str, Any] = {}
        if plan.felt is not None and plan.board_url.startswith("emulator:"):
            books = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="smarttouch-")))
            options["books"] = books
        display = make_board(plan.board_url, SafetyLimits.of(profile), profile.output, **options)
        if plan.measure:
            with display:
                profile = masked_where_broken(display, profile, plan.quiet)
        with bank_progress(plan.quiet) as progress:
            bank = load_bank(profile, progress)
        # Until here an interrupt may end the program at once: no board pulses.
        stack.enter_context(stop_on_signals(stop))
        pipeline = Pipeline(
            profile,
            bank,
            plan.mode,
            plan.rate_hz,
            plan.light_on_dark,
            display.timing,
            plan.softness,
            plan.tone,
        )
        drawing = None if plan.felt is None else _drawing(source, profile, bank, plan.mode)
        patterns = None if plan.frames is None else _patterns(plan.frames, profile)
        observers: list[Callable[[Sent], None]] = [
            each.watch for each in (drawing, patterns) if each is not None
        ]
        wish = Wish(plan.mode, plan.first_level)
        offered = (plan.mode,) if source.asks else pipeline.offered()
        controls = plan.controls(wish, offered)
        report: BoardReport | None = None
        ended = "fault"
        screen = Screen(source, profile, controls, plan.board_url, display, tally, plan.quiet)
        observers.append(screen.show)
        tells: list[Tell] = [screen.tell]
        source.tell = tell = _told_to(tells)
        try:
            with settled(pipeline), display:
                _require_force(source, force, display)
                _warn_of_simulation(plan, profile)
                if plan.attend is not None:
                    observers.append(plan.attend(display))
                regulator = make_regulator(display, profile, plan.hold, plan.balance, plan.quiet)
                if plan.record is not None:
                    recorder = _recorder(plan, profile, source, force, display)
                    stack.callback(recorder.close)
                    tells.append(recorder.event)
                    observers.append(
                        lambda sent: recorder.record(sent, display.acknowledged, display.refused)
                    )
                with screen, keys_heeded(_keys(controls, stop, source)), announced():
                    run(
                        source,
                        pipeline,
                        display,
                        stop=stop,
                        tally=tally,
                        seconds=plan.seconds,
                        observers=observers,
                        controls=controls,
                        force=force,
                        tell=tell,
                        regulator=regulator,
                        clock=SimulatedClock() if display.waits_for_nothing else None,
                    )
                report = display.report()
            display.notes += regulator.notes()
            ended = stop.reason or source.ended
            for words in [_account(report), *_notes(source, force, display)]:
                tell(int(tally.seconds * 1e9), words)
        except SmartTouchError as error:
            tell(int(tally.seconds * 1e9), str(error))
            raise
        finally:
            source.close()
            figures = run_figures(tally, source, display, report, ended)
            if plan.json_file is not None:
                write_json(plan.json_file, figures)
        if plan.felt is not None and drawing is not None:
            drawing.deliver(*_delivered(display, options.get("books")))
            drawing.save(plan.felt)
        if patterns is not None:
            patterns.save()
    if not plan.quiet:
        outputs = (plan.felt, plan.frames, plan.record, plan.json_file)
        written = [each for each in outputs if each is not None]
        screen.summarize(figures, _notes(source, force, display), written)


def _keys(controls: Controls, stop: StopRequest, source: Sensor) -> Callable[[str], None]:
    """Return what each key does: the subject's own control, the source's, and the way out."""
    does: dict[str, Callable[[], None]] = {
        "+": lambda: controls.change_level(STEP),
        "-": lambda: controls.change_level(-STEP),
        "0": controls.silence,
        " ": controls.toggle_pause,
        "m": controls.next_mode,
        "q": lambda: stop.ask("key q"),
        "\x1b": lambda: stop.ask("key Esc"),
        LOST: lambda: stop.ask("the terminal is gone"),
    }
    does |= {"=": does["+"], "up": does["+"], "down": does["-"], "_": does["-"]}

    def heed(key: str) -> None:
        for each in (does, source.keys):
            each.get(key, lambda: None)()

    return heed


def _told_to(tells: list[Tell]) -> Tell:
    def tell(time_ns: int, words: str) -> None:
        for each in tells:
            each(time_ns, words)

    return tell


def _account(report: BoardReport) -> str:
    return (
        f"by the {report.by}'s account {report.slots} slots, strongest {report.max_current_ma:.3f} "
        f"mA, {report.max_charge_uc:.3f} µC, {report.violations} violations"
    )


def _notes(source: Sensor, force: ForceSource | None, board: Board) -> list[str]:
    return [*board.notes, *source.notes, *(force.notes if force is not None else ())]


def _require_force(source: Sensor, force: ForceSource | None, board: Board) -> None:
    if not (source.knows_force or force is not None or board.capabilities.force):
        raise SensorError(
            f"nobody knows how hard the finger presses, neither {source.title} nor the board, so "
            "there would be no current: give --force, for example hx711:PORT, or fixed:0.5 (N)"
        )


def _warn_of_simulation(plan: Plan, profile: Profile) -> None:
    """Say so where a real finger is to feel what was found on none."""
    simulated = [
        name for name, note in profile.calibrated.items() if note.found.startswith("simulated")
    ]
    if simulated and not plan.quiet and not plan.board_url.startswith(_NO_FINGER):
        typer.echo(
            f"Of the profile {', '.join(simulated)} were calibrated in simulation, on no finger: "
            "calibrate again, or begin with --intensity 0.",
            err=True,
        )


def _drawing(source: Sensor, profile: Profile, bank: KernelBank, mode: Mode) -> Any:
    from smarttouch.felt import FeltImage

    return FeltImage(profile, bank, mode.primaries, getattr(source, "page", None))


def _delivered(display: Board, books: Path | None) -> Any:
    """Return every pulse that an emulated board delivered, by its books or as it told."""
    if books is None:
        from smarttouch.boards.emulator.simulated import SimulatedBoard

        assert isinstance(display, SimulatedBoard)
        return display.take_pulses()
    from smarttouch.boards.emulator.books import read_delivered

    return read_delivered(books)


def _patterns(path: Path, profile: Profile) -> Any:
    from smarttouch.patterns import PatternFile

    return PatternFile(path, profile)


def _recorder(
    plan: Plan, profile: Profile, source: Sensor, force: ForceSource | None, board: Board
) -> Any:
    from dataclasses import asdict

    from smarttouch.recording.recorder import Recorder, about_run

    started_unix_ns = time.time_ns()
    settings = {
        "mode": plan.mode.value,
        "rate_hz": plan.rate_hz,
        "light_on_dark": plan.light_on_dark,
        "softness": plan.softness,
        "tone": None if plan.tone is None else asdict(plan.tone),
        "hold": plan.hold,
        "balance": plan.balance,
        "timing": asdict(board.timing),
        "compliance_v": board.capabilities.compliance_v,
        "sensor": plan.sensor_url,
        "sensor_title": source.title,
        "board": plan.board_url,
        "firmware": board.capabilities.firmware,
        "force": plan.force_url,
        "seed": plan.seed,
        "subject": plan.subject,
        "note": plan.note,
    }
    assert plan.record is not None
    about = about_run(profile, settings, started_unix_ns)
    return Recorder(plan.record, about, started_unix_ns)
