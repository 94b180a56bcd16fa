"""``smarttouch boards``: which ports and boards there are."""

from typing import Annotated

import typer

from smarttouch.terminal import print_table


def boards(
    network: Annotated[
        bool, typer.Option(help="Also ask the network for eTactileKits, by a broadcast.")
    ] = True,
) -> None:
    """List serial ports and boards. Nothing is opened, no unknown device gets a byte."""
    from smarttouch.boards.discovery import network_boards, serial_ports
    from smarttouch.registry import known_names

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
