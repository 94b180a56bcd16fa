"""``smarttouch boards``, ``board`` and ``sensor``: devices found, looked at, measured and tried."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from smarttouch.base.terminal import print_table
from smarttouch.cli.options import ForceOption, ProfileOption
from smarttouch.emulator.commands import emulate_board, emulate_sensor
from smarttouch.views.keys_and_signals import (
    asks_a_board,
    command_stop,
    drives_a_board,
    opened,
)

if TYPE_CHECKING:
    from smarttouch.base.events import Event
    from smarttouch.boards.reports import Impedance
    from smarttouch.running.step import StepResult


def boards(
    network: Annotated[
        bool, typer.Option(help="Also ask the network for eTactileKits, by a broadcast.")
    ] = True,
) -> None:
    """List serial ports and boards. Nothing is opened, no unknown device gets a byte."""
    from smarttouch.base.registry import known_names
    from smarttouch.boards.open import network_boards, serial_ports

    rows = [(port.device, port.description) for port in serial_ports()]
    for board in network_boards() if network else ():
        rows.append((board.url, f"eTactileKit {board.name}" + ", in use" * board.busy))
    if rows:
        print_table(rows, ("port", "what the system says of it"), left=2)
    else:
        typer.echo("No serial port, and no board answers on the network.")
    names = ", ".join(f"{each}:" for each in known_names("smarttouch.boards"))
    typer.echo(
        f"\nDrivers: {names}. You choose which one fits what is plugged in, for example "
        "--board kajimoto61:/dev/ttyUSB0.\nWithout hardware: smarttouch board emulate kajimoto61"
    )


board = typer.Typer(help="Look at one board, measure, try or stop it.", no_args_is_help=True)
board.command("emulate")(emulate_board)

_Url = Annotated[
    str, typer.Argument(metavar="URL", help="kajimoto61:PORT, etactilekit:PORT, link:PORT")
]

_WALK_MA = 0.5
_ENDS = ("q", "\x03", "\x04", "")
"""Keys that end a walk; the empty one is a terminal that is gone."""


@board.command()
@asks_a_board
def info(url: _Url, profile: ProfileOption = None) -> None:
    """Say what a board is and what it can and cannot do."""
    from smarttouch.running.display import open_display

    display = open_display(url, profile)
    with opened(display.board) as board:
        rows, force = board.capabilities.describe(), board.force_n
    if force is not None:
        rows.append(("force", f"{force:.2f} N"))
    rows.append(("profile", f"{display.profile.name}: {display.profile.title}"))
    for name, value in rows:
        typer.echo(f"{name:>14}  {value}")


@board.command()
@asks_a_board
def stop(url: _Url, profile: ProfileOption = None) -> None:
    """Put all electrodes of a board at zero."""
    from smarttouch.running.display import open_display

    with opened(open_display(url, profile).board) as board:
        board.stop()
    typer.echo("All electrodes are at zero.")


@board.command()
def clear(url: _Url, profile: ProfileOption = None) -> None:
    """Clear the fault of a board that was found and latched, once it has been checked."""
    from smarttouch.boards.faults import clear_latch
    from smarttouch.running.display import open_display

    device = open_display(url, profile).board.device
    found = None if device is None else clear_latch(device)
    if found is None:
        typer.echo(f"{url} is not latched.")
    else:
        typer.echo(f"Cleared ({found.device}): {found.reason}, {found.date}.")


@board.command()
@drives_a_board
def measure(
    url: _Url,
    profile: ProfileOption = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the impedances.")
    ] = None,
) -> None:
    """Measure the impedance of every electrode on the finger, with small currents."""
    from smarttouch.base.files import require_folder, write_json
    from smarttouch.running.display import open_display

    require_folder(json_file)
    with opened(open_display(url, profile).board) as board:
        found = board.measure()
    _print_impedance(found)
    if json_file is not None:
        write_json(json_file, found.figures())


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
    force: ForceOption = None,
    profile: ProfileOption = None,
) -> None:
    """Walk through the electrodes, each against all others, from zero up to a small current."""
    import sys

    from smarttouch.base.errors import SmartTouchError
    from smarttouch.boards.open import may_touch_a_finger
    from smarttouch.running.display import open_display
    from smarttouch.running.listener import OnEvent
    from smarttouch.running.walk import ElectrodeReached, Walk, run_walk
    from smarttouch.views.keys_and_signals import keyboard_listener

    display = open_display(url, profile)
    if current_ma is None:
        if may_touch_a_finger(url) and not sys.stdin.isatty():
            raise SmartTouchError(
                "there is no keyboard to end it with, and a finger may be on the board: say how "
                f"strong it is to become, for example {_WALK_MA:g} mA",
                about="keyboard",
                remedy="current_ma",
            )
        current_ma = _WALK_MA
    if seconds is None and not sys.stdin.isatty():
        message = "there is no keyboard to wait for: give seconds"
        raise SmartTouchError(message, about="keyboard", remedy="seconds")
    walk, stop = Walk(display.profile, current_ma, seconds), command_stop()

    def say(event: "Event") -> None:
        if isinstance(event, ElectrodeReached):
            typer.echo(event)

    def on_key(key: str) -> None:
        if key in _ENDS:
            stop.ask(f"key {key!r}")
        else:
            walk.go_on()

    with keyboard_listener(on_key):
        run_walk(walk, display, [OnEvent(say)], stop, partial(opened, display.board), force)
    count = len(display.profile.electrodes)
    typer.echo(f"{walk.tried} of {count} electrodes tried; all are at zero.")


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
    profile: ProfileOption = None,
) -> None:
    """Check the scale of a board's current with a resistor in place of the finger."""
    from smarttouch.base.errors import SmartTouchError
    from smarttouch.boards.kits.current_scale import check_reading, measured_scale
    from smarttouch.cli.options import require_site
    from smarttouch.running.display import open_display
    from smarttouch.running.listener import OnStep
    from smarttouch.running.walk import Walk, run_walk

    # Before anything pulses; the voltage is not known yet.
    check_reading(current_ma * ohm / 1000 if volts is None else volts, ohm, current_ma)
    display = open_display(url, profile)
    require_site(display.profile, electrode)
    if volts is None:
        walk, answer = Walk(display.profile, current_ma, sites=[electrode]), ""

        def take_answer(_result: "StepResult") -> None:
            nonlocal answer
            if (line := _line_entered()) is not None:
                answer = line
                walk.go_on()

        typer.echo(
            f"Pulses of nominally {current_ma:g} mA go through electrode {electrode}. No finger "
            f"on the array: {ohm:g} ohm between it and all others."
        )
        typer.echo("Peak voltage across it, V: ", nl=False)
        # No finger is there: a resistor takes the current, whatever the force.
        force = f"fixed:{display.profile.force.full_n:g}"
        opening = partial(opened, display.board)
        run_walk(walk, display, [OnStep(take_answer)], command_stop(), opening, force)
        try:
            volts = float(answer)
        except ValueError:
            message = f"{answer!r} is no voltage: give a number of volts"
            raise SmartTouchError(message, about="volts") from None
    ratio = check_reading(volts, ohm, current_ma)
    scale_ua = measured_scale(url.partition(":")[0], display.board.ua_per_count, ratio)
    typer.echo(
        f"{volts:g} V across {ohm:g} ohm are {1000 * volts / ohm:.3f} mA: {ratio:.3f} of nominal."
    )
    if scale_ua is not None:
        typer.echo("In the profile of this board:\n")
        typer.echo(f"[output]\nua_per_count = {scale_ua:.4g}")


def _line_entered() -> str | None:
    """Return a line if one was entered; never waits."""
    import select
    import sys

    ready = select.select([sys.stdin], [], [], 0)[0]
    return sys.stdin.readline().strip() if ready else None


def _print_impedance(found: "Impedance") -> None:
    rows = [
        (str(index), "-" if condition == "open" else f"{kohm:.1f}", condition.removeprefix("good"))
        for index, (kohm, condition) in enumerate(zip(found.kohm, found.condition, strict=True))
    ]
    print_table(rows, ("electrode", "kohm", ""), left=3)
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


sensor = typer.Typer(help="Look at one sensor or load cell, or play one.", no_args_is_help=True)
sensor.command("emulate")(emulate_sensor)


@sensor.command()
def show(
    url: Annotated[
        str,
        typer.Argument(
            metavar="URL",
            help="camera:N, video:FILE, serial-array:PORT, ...; with --force hx711:PORT, ...",
        ),
    ],
    seconds: Annotated[float, typer.Option(metavar="S", help="How long to look.")] = 2.0,
    force: Annotated[
        bool, typer.Option("--force", help="It is a source of finger force, not of frames.")
    ] = False,
    save: Annotated[Path | None, typer.Option(metavar="PNG", help="Keep the last frame.")] = None,
    profile: ProfileOption = None,
) -> None:
    """Say what comes from a sensor: frames, rate, size, force, and what went wrong."""
    import cv2

    from smarttouch.base.errors import SmartTouchError, require_within
    from smarttouch.base.files import require_folder, write_bytes
    from smarttouch.profile import DEFAULT_PROFILE, load_profile
    from smarttouch.sources import open_source
    from smarttouch.sources.force import open_force
    from smarttouch.sources.source_sample import sample_force, sample_source

    require_within(SmartTouchError, "seconds", seconds, 0, 3600, above=True)
    require_folder(save)
    chosen = load_profile(profile or DEFAULT_PROFILE)
    if force:
        if save is not None:
            raise SmartTouchError("save is for frames: leave out force, or this", about="force")
        with open_force(url, chosen) as pressed:
            rows = sample_force(pressed, seconds)
        print_table([*rows, *(("note", note) for note in pressed.notes)], left=2)
        return
    with open_source(url, chosen) as source:
        look = sample_source(source, seconds)
    notes = [("note", note) for note in source.notes]
    print_table([*look.rows(source), *notes], left=2)
    if save is not None and look.last is not None and look.last.image is not None:
        write_bytes(save, cv2.imencode(".png", look.last.image)[1].tobytes())
        typer.echo(f"The last frame is in {save}.")
