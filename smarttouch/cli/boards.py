"""``smarttouch boards``: which ports and boards there are."""

from typing import Annotated

import typer

from smarttouch import terminal


def boards(
    network: Annotated[
        bool, typer.Option(help="Also ask the network for eTactileKits, by a broadcast.")
    ] = True,
) -> None:
    """List serial ports and boards. Nothing is opened, no unknown device gets a byte."""
    from rich.table import Table

    from smarttouch.boards.discovery import network_boards, serial_ports
    from smarttouch.registry import known_names

    console = terminal.console()
    table = Table("port", "what the system says of it", box=None)
    for port in serial_ports():
        table.add_row(port.device, port.description)
    for board in network_boards() if network else ():
        table.add_row(board.url, f"eTactileKit {board.name}" + (", in use" if board.busy else ""))
    if table.row_count:
        console.print(table)
    else:
        console.print("No serial port, and no board answers on the network.")
    names = ", ".join(f"{each}:" for each in known_names("smarttouch.boards"))
    console.print(
        f"\nDrivers: {names}. You choose which one fits what is plugged in, for example "
        "--board kajimoto61:/dev/ttyUSB0.\nWithout hardware: smarttouch board emulate kajimoto61",
        highlight=False,
        soft_wrap=True,
    )
