"""``smarttouch stop``: end every run on this machine, from another terminal."""

import typer


def stop() -> None:
    """End every run of this user with all electrodes at zero, and wait for it.

    What was started before and has not begun yet does not begin.
    """
    from smarttouch.boards.open_boards import stop_all

    asked = stop_all()
    typer.echo(f"{asked} stopped." if asked else "Nothing runs.")
