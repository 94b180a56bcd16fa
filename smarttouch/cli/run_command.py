"""Commands that run: the port of ``--window`` may be left out."""

from collections.abc import Sequence

import typer
from typer.core import TyperCommand


class RunCommand(TyperCommand):
    """A command that reads ``--window`` without a number as ``--window 0``."""

    # Some versions of typer hand over a context class of their own, not the one of the base.
    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]
        """Parse the words of the command line."""
        return super().parse_args(ctx, with_ports(args))


def with_ports(words: Sequence[str]) -> list[str]:
    """Return the words of a command line with a 0 behind each ``--window`` that has no port."""
    found: list[str] = []
    for at, word in enumerate(words):
        found.append(word)
        if word == "--":
            return [*found, *words[at + 1 :]]
        following = "".join(words[at + 1 : at + 2])
        if word == "--window" and not following.lstrip("-").isdecimal():
            found.append("0")
    return found
