"""What all commands share: options and their groups, choices, and help in plain lines."""

import inspect
import sys
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.command_options import option
from smarttouch.base.errors import SmartTouchError, choice_of, require_within
from smarttouch.base.removed import COMMANDS, OPTIONS, instead_of

if TYPE_CHECKING:
    from smarttouch.profile import Profile

_T = TypeVar("_T")


class OptionGroup:
    """Base of frozen dataclasses whose fields are options, annotated as typer wants them."""


def takes_options(command: Callable[..., _T]) -> Callable[..., _T]:
    """Let a command take the options of the groups among its parameters' types, each group as one
    object."""
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, Any] = {
        name: kind
        for name, kind in hints.items()
        if inspect.isclass(kind) and issubclass(kind, OptionGroup)
    }

    def expanded(**given: Any) -> _T:
        for name, group in groups.items():
            given[name] = group(**{each.name: given.pop(each.name) for each in fields(group)})
        return command(**given)

    keyword = inspect.Parameter.KEYWORD_ONLY
    taken = [
        each.replace(annotation=hints[each.name], kind=keyword)
        for each in inspect.signature(command).parameters.values()
        if each.name not in groups
    ]
    for group in groups.values():
        kinds = get_type_hints(group, include_extras=True)
        taken += [
            inspect.Parameter(each.name, keyword, default=each.default, annotation=kinds[each.name])
            for each in fields(group)
        ]
    expanded.__name__, expanded.__doc__ = command.__name__, command.__doc__
    expanded.__annotations__ = {each.name: each.annotation for each in taken}
    # Typer reads it; the type of a function has no such attribute.
    vars(expanded)["__signature__"] = inspect.Signature(taken)
    return expanded


def parse_mode(mode: str) -> Mode:
    """Return a mode by its name; only modes that images can drive."""
    return choice_of("mode", mode, [each for each in Mode if each is not Mode.COLOR])


def parse_finger(text: str, usual: str) -> tuple[str, int]:
    """Return anatomy and seed of ``[ANATOMY:]SEED``, with the usual anatomy where none is given."""
    anatomy, _, seed = text.rpartition(":")
    return (anatomy or usual, int(seed)) if seed.isdecimal() else (text, 1)


def parse_afferent(mode: str) -> Afferent:
    """Return a class of afferents by its name."""
    return Afferent[choice_of("mode", mode, Afferent.__members__)]


def require_site(profile: "Profile", site: int) -> None:
    """Raise unless a profile's array has such a site."""
    words = f"site {site} of {profile.name}"
    require_within(SmartTouchError, "site", site, 0, len(profile.electrodes) - 1, words)


def require_answers(
    simulate: bool, board_url: str, boards: tuple[str, ...], error: type[SmartTouchError]
) -> None:
    """Raise unless a person at a keyboard can answer, or a simulation on such boards."""
    if simulate and not board_url.startswith(boards):
        raise error(
            f"a simulation never drives a board that a finger may be on: not {board_url!r}, only "
            f"{' or '.join(boards)}"
        )
    if not simulate and not sys.stdin.isatty():
        message = "there is no keyboard to answer on: use a terminal, or add --simulate"
        raise error(message)


ProfileOption = Annotated[
    str | None, option("Use this device and finger; the board's usual one otherwise.", "NAME|FILE")
]
ArrayOption = Annotated[
    str, option("Use this device and finger; smarttouch profiles lists them.", "NAME|FILE")
]
ClassOption = Annotated[str, option("Choose the class that is stimulated: RA, SAI or PC.", "CLASS")]
ModeOption = Annotated[
    str, option("Choose the class that is stimulated: RA, SAI, PC or natural.", "CLASS")
]
JsonOption = Annotated[Path | None, option("Write the results as JSON.", "FILE", "--json")]


ForceOption = Annotated[
    str | None,
    option("Measure finger force by hx711:PORT or loadcell:PORT, or state it by fixed:N.", "URL"),
]
QuietOption = Annotated[bool, option("Print errors only.", None, "--quiet")]


class PlainCommand(TyperCommand):
    """A command that names what replaced an option of an earlier version."""

    # A context is of click's class or of typer's own, by the version of typer: hence `Any`.
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words of the command line."""
        options = {name for parameter in self.params for name in parameter.opts}
        for name in (word.partition("=")[0] for word in args):
            if name not in options and (sentence := instead_of(OPTIONS, name)):
                ctx.fail(sentence)
        return super().parse_args(ctx, args)


class PlainGroup(TyperGroup):
    """Commands under one name, which names what replaced one of an earlier version."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command that the words name, or fail with what replaced it."""
        path = " ".join([*ctx.command_path.split()[1:], args[0]])
        if args[0] not in self.commands and (sentence := instead_of(COMMANDS, path)):
            ctx.fail(sentence)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write each with its first sentence."""
        with formatter.section("Commands"):
            formatter.write_dl(
                [
                    (name, " ".join((each.help or "").split("\n\n")[0].split()))
                    for name, each in self.commands.items()
                ]
            )


class Commands(typer.Typer):
    """Commands whose help is plain, without boxes or colors."""

    def __init__(self, **settings: Any) -> None:
        context = {"help_option_names": ["-h", "--help"]}
        settings |= {"cls": PlainGroup, "pretty_exceptions_enable": False}
        super().__init__(rich_markup_mode=None, context_settings=context, **settings)

    def command(self, name: str | None = None, **settings: Any) -> Callable[..., Any]:
        """Return a decorator that adds a command."""
        return super().command(name, **{"cls": PlainCommand} | settings)
