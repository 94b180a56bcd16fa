"""``smarttouch board``: one board, looked at, measured, tried and stopped."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from smarttouch import terminal
from smarttouch.cli.driving import asks_a_board, drives_a_board, opened

if TYPE_CHECKING:
    from smarttouch.boards.board import Board
    from smarttouch.boards.impedance import Impedance
    from smarttouch.profile import Profile

board = typer.Typer(help="Look at one board, measure, try or stop it.", no_args_is_help=True)

_Url = Annotated[
    str, typer.Argument(metavar="URL", help="kajimoto61:PORT, etactilekit:PORT, link:PORT")
]
_MOST_EMULATED = 1024
"""Electrodes; the skin between them takes the square of that."""
_ProfileName = Annotated[
    str | None,
    typer.Option("--profile", metavar="NAME|FILE", help="The board's usual one if not given."),
]


_WALK_MA = 0.5


@board.command()
@asks_a_board
def info(url: _Url, profile: _ProfileName = None) -> None:
    """Say what a board is and what it can and cannot do."""
    chosen, display = _driver(url, profile)
    with opened(display):
        capabilities = display.capabilities
        force = display.force_n
    for name, value in capabilities.describe():
        typer.echo(f"{name:>14}  {value}")
    if force is not None:
        typer.echo(f"{'force':>14}  {force:.2f} N")
    typer.echo(f"{'profile':>14}  {chosen.name}: {chosen.title}")


@board.command()
@asks_a_board
def stop(url: _Url, profile: _ProfileName = None) -> None:
    """Put all electrodes of a board at zero."""
    _, display = _driver(url, profile)
    with opened(display):
        display.stop()
    typer.echo("All electrodes are at zero.")


@board.command()
@drives_a_board
def measure(
    url: _Url,
    profile: _ProfileName = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the impedances.")
    ] = None,
) -> None:
    """Measure the impedance of every electrode on the finger, with small currents."""
    from smarttouch.cli.files import require_folder, write_json

    require_folder(json_file)
    _, display = _driver(url, profile)
    with opened(display):
        found = display.measure()
    _print_impedance(found)
    if json_file is not None:
        kohm = [
            None if condition == "open" else float(f"{each:.4g}")
            for each, condition in zip(found.kohm, found.condition, strict=True)
        ]
        write_json(
            json_file,
            {
                "impedance_kohm": kohm,
                "condition": found.condition,
                "current_ma": found.current_ma,
                "masked": found.broken,
            },
        )


@board.command("test")
@drives_a_board
def try_out(
    url: _Url,
    current_ma: Annotated[
        float | None,
        typer.Option(
            metavar="MA", help=f"Through each electrode in turn; {_WALK_MA:g} with a keyboard."
        ),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(metavar="S", help="For each electrode; waits for a key if not given."),
    ] = None,
    profile: _ProfileName = None,
) -> None:
    """Walk through the electrodes, each against all others, from zero up to a small current."""
    import sys

    from smarttouch.boards.board import may_touch_a_finger
    from smarttouch.cli.walk import walk
    from smarttouch.errors import SmartTouchError

    chosen, display = _driver(url, profile)
    if current_ma is None:
        if may_touch_a_finger(url) and not sys.stdin.isatty():
            raise SmartTouchError(
                "there is no keyboard to end it with, and a finger may be on the board: say how "
                f"strong it is to become with --current-ma, for example {_WALK_MA:g}",
                about="keyboard",
                problem="missing",
                remedy="--current-ma",
            )
        current_ma = _WALK_MA
    with opened(display):
        felt = walk(display, chosen, current_ma, seconds)
    typer.echo(f"{felt} of {len(chosen.electrodes)} electrodes tried; all are at zero.")


@board.command("calibrate-scale")
@drives_a_board
def calibrate_scale(
    url: _Url,
    ohm: Annotated[
        float, typer.Option(metavar="OHM", help="The resistor between electrode and all others.")
    ] = 1000.0,
    electrode: Annotated[int, typer.Option(metavar="N", help="Where it is connected.")] = 0,
    current_ma: Annotated[float, typer.Option(metavar="MA", help="Nominal current.")] = 1.0,
    volts: Annotated[
        float | None,
        typer.Option(metavar="V", help="Peak that was seen; asked for while it pulses if not."),
    ] = None,
    profile: _ProfileName = None,
) -> None:
    """Check the scale of a board's current with a resistor in place of the finger."""
    from smarttouch.boards.scale import NOMINAL_UA, check_reading, scale_of
    from smarttouch.cli.files import require_site
    from smarttouch.cli.walk import pulse_until_line
    from smarttouch.errors import SmartTouchError

    # Before anything pulses; the voltage is not known yet.
    check_reading(current_ma * ohm / 1000 if volts is None else volts, ohm, current_ma)
    chosen, display = _driver(url, profile)
    require_site(chosen, electrode)
    if volts is None:
        with opened(display):
            typer.echo(
                f"Pulses of nominally {current_ma:g} mA go through electrode {electrode}. No "
                f"finger on the array: {ohm:g} ohm between it and all others."
            )
            answer = pulse_until_line(
                display, chosen, electrode, current_ma, "Peak voltage across it, V: "
            )
        try:
            volts = float(answer)
        except ValueError:
            message = f"{answer!r} is no voltage: give a number of volts"
            raise SmartTouchError(
                message, about="--volts", problem="malformed", value=answer
            ) from None
    ratio = check_reading(volts, ohm, current_ma)
    scale_ua = None if display.ua_per_count is None else display.ua_per_count * ratio
    kind = url.partition(":")[0]
    if scale_ua is not None and kind in NOMINAL_UA:
        # The scale of the profile may have been a measured one; the band is of the nominal.
        scale_of(kind, float(f"{scale_ua:.4g}"))
    typer.echo(
        f"{volts:g} V across {ohm:g} ohm are {1000 * volts / ohm:.3f} mA: {ratio:.3f} of nominal."
    )
    if scale_ua is not None:
        typer.echo("In the profile of this board:\n")
        typer.echo(f"[output]\nua_per_count = {scale_ua:.4g}")


@board.command()
def emulate(
    name: Annotated[str, typer.Argument(metavar="NAME", help="link, kajimoto61 or etactilekit")],
    electrodes: Annotated[
        int | None, typer.Option(metavar="N", help="Of a link board or an eTactileKit.")
    ] = None,
    output: Annotated[
        str, typer.Option(metavar="KIND", help="Of a link board: weighted, three-state, ...")
    ] = "weighted",
    firmware: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Of an eTactileKit: v1.0, 936c6c0, 71adee2 or newest."),
    ] = None,
    tcp: Annotated[bool, typer.Option("--tcp", help="Serve TCP instead of a serial port.")] = False,
    event: Annotated[
        list[str] | None,
        typer.Option(metavar="TEXT", help="What happens to the finger: '2 lift', '0 open 7', ..."),
    ] = None,
    books: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Where it keeps its books.")
    ] = None,
) -> None:
    """Play a board on skin, behind a port whose name is printed, until Ctrl-C."""
    from smarttouch.boards.emulator.etactilekit_generations import GENERATIONS
    from smarttouch.cli.emulation import play_emulator
    from smarttouch.errors import BoardError, SmartTouchError

    usual = {"link": 64, "kajimoto61": 61, "etactilekit": 32}
    if name not in usual:
        message = f"no emulator {name!r}: choose {', '.join(usual)}"
        raise SmartTouchError(
            message, about="emulator", problem="unknown", value=name, allowed=tuple(usual)
        )
    if electrodes is not None and not 1 <= electrodes <= _MOST_EMULATED:
        message = f"--electrodes {electrodes} must be from 1 to {_MOST_EMULATED}"
        raise SmartTouchError(
            message, about="--electrodes", value=electrodes, allowed=(1, _MOST_EMULATED)
        )
    if books is not None and not books.is_dir():
        message = f"--books {books} is no folder: make it first"
        raise SmartTouchError(message, about="--books", problem="no folder", value=books)
    if firmware is not None and name != "etactilekit":
        message = f"--firmware is for etactilekit, and a {name} has only one: leave it out"
        raise SmartTouchError(
            message, about="--firmware", problem="conflict", value=name, allowed=("etactilekit",)
        )
    if firmware is not None and firmware not in GENERATIONS:
        message = f"no firmware {firmware!r}: choose {', '.join(GENERATIONS)}"
        raise SmartTouchError(
            message,
            about="--firmware",
            problem="unknown",
            value=firmware,
            allowed=tuple(GENERATIONS),
        )
    arguments = [f"--protocol={name}", f"--electrodes={electrodes or usual[name]}"]
    arguments += [f"--output={output}"] if name == "link" else []
    arguments += [f"--firmware={firmware}"] if firmware else []
    arguments += ["--tcp"] if tcp else []
    arguments += [f"--event={each}" for each in event or ()]
    arguments += [f"--books={books}"] if books is not None else []

    def advice(port: str) -> str:
        return (
            f"A {name} board on emulated skin. In another terminal:\n\n"
            f"  smarttouch live --board {name}:{port}\n\nCtrl-C ends it."
        )

    play_emulator("smarttouch.boards.emulator", arguments, advice, BoardError)


def _driver(url: str, profile: str | None) -> tuple["Profile", "Board"]:
    from smarttouch.boards.board import make_board, usual_profile
    from smarttouch.profile import load_profile
    from smarttouch.stimulation.safety import SafetyLimits

    chosen = load_profile(profile or usual_profile(url))
    return chosen, make_board(url, SafetyLimits.of(chosen), chosen.output)


def _print_impedance(found: "Impedance") -> None:
    from rich.table import Table

    table = Table("electrode", "kohm", "", box=None)
    for index, (kohm, condition) in enumerate(zip(found.kohm, found.condition, strict=True)):
        value = "-" if condition == "open" else f"{kohm:.1f}"
        table.add_row(str(index), value, "" if condition == "good" else condition)
    terminal.console().print(table)
    if found.lifted:
        typer.echo("No electrode touches anything: put the finger on, and measure again.")
    elif found.broken:
        typer.echo("Open or shorted electrodes. To plan around them, in the profile:\n")
        typer.echo(f"[output]\nmasked = {list(found.broken)}")
    unsure = found.condition.count("unsure")
    if unsure:
        typer.echo(
            f"{unsure} readings fit more than one voltage (this board's wrap): the least is shown, "
            "so an open electrode may look like a good one."
        )
