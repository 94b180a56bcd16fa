"""``smarttouch devices``: list, show, measure, test and emulate boards, sensors and cameras."""

from typing import TYPE_CHECKING, Annotated

import typer

from smarttouch.base.errors import SmartTouchError
from smarttouch.cli.options import (
    Commands,
    ForceOption,
    ProfileOption,
    argument,
    option,
    require_site,
)
from smarttouch.views.keys_and_signals import command_stop, drives_a_board
from smarttouch.views.printable_output import print_table

if TYPE_CHECKING:
    from smarttouch.base.events import Event
    from smarttouch.running.step_records import StepResult


devices: Commands = Commands(
    help="List devices; show, measure, test or emulate a device.",
    invoke_without_command=True,
)


@devices.callback()
def list_devices(context: typer.Context) -> None:
    # Do not open ports: unknown devices must not receive bytes.
    if context.invoked_subcommand is not None:
        return
    from serial.tools import list_ports

    from smarttouch.boards.open import BOARDS
    from smarttouch.sources.camera import cameras

    # Built-in ports without hardware have no description.
    ports = [
        serial_port for serial_port in list_ports.comports() if serial_port.description != "n/a"
    ]
    rows = sorted((port.device, port.description) for port in ports)
    rows += [(f"camera:{number}", name) for number, name in cameras()]
    if rows:
        print_table(rows, ("port", "description of the port or camera"), left=2)
    else:
        typer.echo("No serial port and no camera was found.")
    names = ", ".join(f"{serial_port}:" for serial_port in BOARDS.names)
    typer.echo(
        f"\nDrivers: {names}. Choose the one for your board, for example "
        "--board kajimoto61:/dev/ttyUSB0.\nWithout hardware: smarttouch devices emulate kajimoto61"
    )


@devices.command()
def emulate(
    device: Annotated[
        str,
        argument(
            "Kind of device: link, kajimoto61, etactilekit, serial-array, hx711, loadcell. Options "
            "follow a ?, as in 'link?electrodes=16&event=2 lift'. You can also give a file that "
            "was recorded with --board 'KIND:PORT?record=FILE'.",
            "KIND|FILE",
        ),
    ],
) -> None:
    """Open a new port, and emulate a board or a sensor there, until Ctrl-C."""
    from smarttouch.emulator.devices import emulate as emulate_device

    emulate_device(device, advise=True)


_Url = Annotated[str, argument("A board: kajimoto61:PORT, etactilekit:PORT, link:PORT.", "URL")]

_WALK_MA = 0.5
_ENDS = ("q", "\x03", "\x04", "")  # keys that end the test; "" means that the terminal was closed


@devices.command()
@drives_a_board
def show(
    url: Annotated[
        str,
        argument(
            "A board, a source of frames or a load cell: link:PORT, camera:0, hx711:PORT.", "URL"
        ),
    ],
    seconds: Annotated[float, option("Read a sensor for this time.", "S")] = 2.0,
    profile: ProfileOption = None,
) -> None:
    """Show the capabilities of a board, or the readings of a sensor or load cell."""
    from smarttouch.base.errors import require_within
    from smarttouch.boards.open import BOARDS
    from smarttouch.profile import DEFAULT_PROFILE, load_profile
    from smarttouch.sources import open_source
    from smarttouch.sources.force import FORCES, open_force
    from smarttouch.sources.source_statistics import sample_force, sample_source

    kind = url.partition(":")[0]
    if kind in BOARDS.names:
        _describe_board(url, profile)
        return
    require_within(SmartTouchError, "seconds", seconds, 0, 3600, above=True)
    chosen = load_profile(profile or DEFAULT_PROFILE)
    if kind in FORCES.names:
        with open_force(url, chosen) as pressed:
            rows = sample_force(pressed, seconds)
        print_table([*rows, *(("note", note) for note in pressed.notes)], left=2)
        return
    with open_source(url, chosen) as source:
        rows = sample_source(source, seconds)
    notes = [("note", note) for note in source.notes]
    print_table([*rows, *notes], left=2)


def _describe_board(url: str, profile: str | None) -> None:
    from smarttouch.running.display import open_display

    display = open_display(url, profile)
    with display.opened() as board:
        rows, force = board.capabilities.describe(), board.force_n
    if force is not None:
        rows.append(("force", f"{force:.2f} N"))
    rows.append(("profile", f"{display.profile.name}: {display.profile.title}"))
    print_table(rows, left=2)


@devices.command()
def clear(url: _Url, profile: ProfileOption = None) -> None:
    """Clear the latched fault of a board. Check the board first."""
    from smarttouch.boards.reports import clear_latch
    from smarttouch.running.display import open_display

    device = open_display(url, profile).board.device
    latch = clear_latch(device)
    if latch is None:
        typer.echo(f"{url} has no latched fault.")
    else:
        typer.echo(f"Cleared ({device}): {latch}.")


@devices.command()
@drives_a_board
def measure(url: _Url, profile: ProfileOption = None) -> None:
    """Measure the impedance of each electrode on the finger, with small currents."""
    from smarttouch.running.display import open_display

    with open_display(url, profile).opened() as board:
        impedance = board.measure()
    rows = [
        (str(index), "-" if condition == "open" else f"{kohm:.1f}", condition.removeprefix("good"))
        for index, (kohm, condition) in enumerate(
            zip(impedance.kohm, impedance.condition, strict=True)
        )
    ]
    print_table(rows, ("electrode", "kohm", ""), left=3)
    if impedance.lifted:
        typer.echo("No electrode touches the skin: put the finger on the array, and measure again.")
    elif impedance.broken:
        typer.echo("Electrodes are open or shorted. To exclude them, write into the profile:\n")
        typer.echo(f"[output]\nmasked = {list(impedance.broken)}")


@devices.command("test")
@drives_a_board
def try_out(
    url: _Url,
    current_ma: Annotated[
        float | None, option("Raise the current of each electrode to this value.", "MA")
    ] = None,
    seconds: Annotated[
        float | None,
        option("Stay at each electrode for this time (default: until a key is pressed).", "S"),
    ] = None,
    electrode: Annotated[int | None, option("Drive only this electrode.", "N")] = None,
    force: ForceOption = None,
    profile: ProfileOption = None,
) -> None:
    """Drive each electrode in turn against all others, from zero up to a small current."""
    import sys

    from smarttouch.running.display import open_display
    from smarttouch.running.electrode_walk import ElectrodeReached, Walk, run_walk
    from smarttouch.running.step_records import OnEvent, as_listeners
    from smarttouch.views.keys_and_signals import keyboard_listener

    display = open_display(url, profile)
    sites = range(len(display.profile.electrodes)) if electrode is None else [electrode]
    require_site(display.profile, sites[-1])
    if not sys.stdin.isatty() and (seconds is None or current_ma is None):
        raise SmartTouchError(
            "there is no keyboard to continue or stop: add --seconds and --current-ma, "
            f"for example {_WALK_MA:g}"
        )
    current_ma = _WALK_MA if current_ma is None else current_ma
    walk, stop = Walk(display.profile, current_ma, seconds, sites), command_stop()
    tried, pulsed = list[int](), set(display.profile.output.masked)

    def say(event: "Event") -> None:
        if isinstance(event, ElectrodeReached):
            tried.append(sites[len(tried)])
            typer.echo(event)

    def note_pulses(result: "StepResult") -> None:
        if result.number is not None:
            pulsed.update(result.step.sequence.site.tolist())

    def on_key(key: str) -> None:
        if key in _ENDS:
            stop.ask(f"key {key!r}")
        else:
            walk.go_on()

    with keyboard_listener(on_key):
        followers = [OnEvent(say), *as_listeners([note_pulses])]
        run_walk(walk, display, listeners=followers, stop=stop, force=force)
    if missed := [str(site) for site in tried if site not in pulsed]:
        typer.echo(f"Electrodes with no pulse: {', '.join(missed)}.")
    typer.echo("All electrodes are at zero.")
