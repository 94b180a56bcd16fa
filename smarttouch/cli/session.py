"""One run from an open sensor to a board: what every command that runs shares."""

import contextlib
from collections.abc import Callable

import typer

from smarttouch.boards.board import Board, BoardReport, make_board
from smarttouch.cli.blind_screen import BlindScreen
from smarttouch.cli.driving import ending_in_order, opened, the_stop
from smarttouch.cli.files import write_json
from smarttouch.cli.kept import Kept
from smarttouch.cli.keyboard import LOST, keys_heeded
from smarttouch.cli.plan import Plan
from smarttouch.cli.progress import bank_progress
from smarttouch.cli.regulation import make_regulator, masked_where_broken
from smarttouch.cli.run_figures import run_figures
from smarttouch.cli.screen import Screen
from smarttouch.clock import SimulatedClock
from smarttouch.controls import STEP, Controls, Wish
from smarttouch.errors import BoardStoppedError, SensorError, SmartTouchError
from smarttouch.kernels.bank import load_bank
from smarttouch.live import Tell, run, settled
from smarttouch.pipeline import Pipeline
from smarttouch.profile import Profile
from smarttouch.profile.ceilings import ADVISORY_RMS_MA_CM2
from smarttouch.realtime import Pace
from smarttouch.sources.forces.force import ForceSource
from smarttouch.sources.frame import Sensor
from smarttouch.stimulation.limits import rms_ma_cm2
from smarttouch.stimulation.safety import SafetyLimits
from smarttouch.stopping import StopRequest
from smarttouch.tally import Tally


def play(plan: Plan, source: Sensor, force: ForceSource | None, profile: Profile) -> None:
    """Let a finger feel what a sensor sees, until it ends or a user ends it."""
    stop, tally = the_stop(), Tally()
    with contextlib.ExitStack() as stack:
        kept = Kept(plan, stack)
        display = _board(plan, profile, kept)
        plan.require_a_level()
        if plan.measure:
            with opened(display, stop):
                profile = masked_where_broken(display, profile, plan.quiet)
        with bank_progress(plan.quiet) as progress:
            bank = load_bank(profile, progress)
        pipeline = Pipeline(
            profile,
            bank,
            plan.mode,
            plan.rate_hz,
            plan.light_on_dark,
            display.timing,
            plan.softness,
            plan.tone,
            plan.vibrators_url is not None,
            plan.sharing,
        )
        kept.prepare(source, profile, bank)
        wish = Wish(plan.mode, plan.first_level)
        offered = (plan.mode,) if source.asks else pipeline.offered()
        controls = plan.controls(wish, offered)
        controls.most = plan.most
        report: BoardReport | None = None
        ended = "fault"
        shown = BlindScreen if source.hidden else Screen
        screen = shown(source, profile, controls, plan.board_url, display, tally, plan.quiet)
        kept.observers.append(screen.show)
        kept.tells.append(screen.tell)
        source.tell = tell = _told_to(kept.tells)
        # Until here a signal ends the program anywhere: no board is open.
        stack.enter_context(ending_in_order(kept.patience_s))
        try:
            # The board is the innermost: at zero before anything else ends, or keeps us waiting.
            with (
                settled(pipeline),
                screen,
                keys_heeded(_keys(controls, stop, source)),
                opened(display, stop),
            ):
                _require_force(source, force, display)
                _warn_of_simulation(plan, profile)
                if plan.attend is not None:
                    kept.observers.append(plan.attend(display))
                regulator = make_regulator(display, profile, plan.hold, plan.balance, plan.quiet)
                kept.open(source, profile, display)
                run(
                    source,
                    pipeline,
                    display,
                    stop=stop,
                    tally=tally,
                    seconds=plan.seconds,
                    observers=kept.observers,
                    controls=controls,
                    force=force,
                    tell=tell,
                    regulator=regulator,
                    clock=SimulatedClock() if display.waits_for_nothing else None,
                )
                display.stop()
                report = display.report()
            display.notes += [*regulator.notes(), *_refused_packets(display, report)]
            if plan.on_a_finger:
                display.notes += [*_density(profile), *Pace(tally.real_time).notes]
            ended = stop.reason or source.ended
            for words in [_account(report), _dose(display), *_notes(source, force, display)]:
                tell(int(tally.seconds * 1e9), words)
        except BoardStoppedError:
            ended = stop.reason or ended
            raise
        except SmartTouchError as error:
            tell(int(tally.seconds * 1e9), str(error))
            raise
        finally:
            source.close()
            figures = run_figures(tally, source, display, report, ended)
            if plan.json_file is not None:
                write_json(plan.json_file, figures)
        kept.finish(display)
    if not plan.quiet:
        notes = [*_notes(source, force, display), *kept.notes]
        screen.summarize(figures, notes, kept.files)


def _board(plan: Plan, profile: Profile, kept: Kept) -> Board:
    """Return the board of a plan, not opened yet; with its vibrators, if it has any."""
    limits = SafetyLimits.of(profile)
    display = make_board(plan.board_url, limits, profile.output, **kept.board_options)
    if plan.vibrators_url is None:
        if plan.board_url.startswith("vibrators:"):
            raise SmartTouchError(
                "vibrators make no current, and shake only what smarttouch color asks for: give "
                "them to it with --vibrators"
            )
        return display
    from smarttouch.boards.hybrid import HybridBoard
    from smarttouch.boards.vibrators import make_vibrators

    return HybridBoard(display, make_vibrators(plan.vibrators_url, limits, profile.electrodes))


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


def _dose(board: Board) -> str:
    dose = board.dose
    return f"dose {dose.seconds:.3f} s of current, {dose.most_mc:.4f} mC through one electrode"


def _density(profile: Profile) -> list[str]:
    rms = rms_ma_cm2(profile)
    if rms <= ADVISORY_RMS_MA_CM2:
        return []
    return [
        f"at full intensity an electrode's own pulses are {rms:.0f} mA/cm² r.m.s.: above "
        f"{ADVISORY_RMS_MA_CM2:g}, IEC 60601-2-10 wants the operator's attention"
    ]


def _refused_packets(board: Board, report: BoardReport) -> list[str]:
    by_host, by_board = board.refused_packets, report.refused_packets
    if not by_host + by_board:
        return []
    return [
        f"{by_host + by_board} packets were old, or of another session: the board refused "
        f"{by_board} and the host {by_host} (something on the line repeats, delays or mixes them)"
    ]


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
    if simulated and not plan.quiet and plan.on_a_finger:
        typer.echo(
            f"Of the profile {', '.join(simulated)} were calibrated in simulation, on no finger: "
            "calibrate again, and turn the current up slowly.",
            err=True,
        )
