"""``python -m smarttouch.emulator``: ``smarttouch devices emulate``, with options."""

import sys
from collections.abc import Sequence

import typer

from smarttouch.base.errors import SmartTouchError
from smarttouch.emulator.commands import emulate_board, emulate_sensor

app: typer.Typer = typer.Typer(pretty_exceptions_enable=False, add_completion=False)
app.command("board")(emulate_board)
app.command("sensor")(emulate_sensor)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run an emulated device until its host is gone, with the command line's arguments if none are
    given."""
    try:
        app(arguments)
    except SmartTouchError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
