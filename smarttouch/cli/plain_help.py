"""Help in plain lines: a dozen options by ``--help``, all by ``--help-all``; and their commands."""

from collections.abc import Callable
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from smarttouch.cli.options import with_ports

_ALL = "--help-all"
HELP_OPTIONS = ["-h", "--help", _ALL]
_IS_ALL = "smarttouch.all"


class PlainCommand(TyperCommand):
    """A command whose help is plain, and that reads ``--window`` without a number as 0."""

    # A context is of click's class or of typer's own, by the version of typer: hence `Any`.
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words of the command line."""
        ctx.meta[_IS_ALL] = _ALL in args
        return super().parse_args(ctx, with_ports(args))

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments and options: those of every day, or all of them in their panels."""
        panels: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        left_out = 0
        for each in self.get_params(ctx):
            record = each.get_help_record(ctx)
            if record is None:
                continue
            panel = getattr(each, "rich_help_panel", None)
            if each.param_type_name == "argument":
                # Without its type, which is always a text.
                panels["Arguments"].append((record[0].partition(" <")[0], record[1]))
            elif panel is None or ctx.meta.get(_IS_ALL):
                panels.setdefault(panel or "Options", []).append(record)
            else:
                left_out += 1
        for name, rows in panels.items():
            if rows:
                with formatter.section(name):
                    formatter.write_dl(rows)
        if left_out:
            formatter.write_paragraph()
            formatter.write_text(f"{left_out} more options: {ctx.command_path} {_ALL}")


class PlainGroup(TyperGroup):
    """Commands under one name, listed in their order with one sentence each."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return their names."""
        return list(self.commands)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write them by their panels."""
        panels: dict[str, list[tuple[str, str]]] = {}
        for name, each in self.commands.items():
            panel = str(getattr(each, "rich_help_panel", None) or "Commands")
            first = " ".join((each.help or "").split("\n\n")[0].split())
            panels.setdefault(panel, []).append((name, first))
        for panel, rows in panels.items():
            with formatter.section(panel):
                formatter.write_dl(rows)


class Commands(typer.Typer):
    """Commands whose help is plain, without boxes or colors."""

    def __init__(self, **settings: Any) -> None:
        context = {"help_option_names": HELP_OPTIONS}
        settings |= {"cls": PlainGroup, "pretty_exceptions_enable": False}
        super().__init__(rich_markup_mode=None, context_settings=context, **settings)

    def command(self, name: str | None = None, **settings: Any) -> Callable[..., Any]:
        """Return a decorator that adds a command."""
        return super().command(name, **{"cls": PlainCommand} | settings)
