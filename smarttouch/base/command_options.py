"""Options and arguments of commands, declared in a line each."""

from typing import Any

import typer


def option(says: str, metavar: str | None = None, *names: str, **more: Any) -> Any:
    """Return an option of a command; in the list of a parameter's ``Annotated``."""
    return typer.Option(*names, help=says, metavar=metavar, **more)


def argument(says: str, metavar: str | None = None, **more: Any) -> Any:
    """Return an argument of a command, as `option` does."""
    return typer.Argument(help=says, metavar=metavar, **more)
