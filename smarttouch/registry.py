"""Sources and boards by URL: a name before the first colon picks the opener."""

import inspect
import warnings
from collections.abc import Callable, Sequence
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from smarttouch.errors import SmartTouchError

_FORMER = {"smarttouch.sources": "smarttouch.sensors"}
"""Former names of entry-point groups: packages of others may still be in them."""


def known_openers(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of a group by name, also those in the group of its former name."""
    former = {point.name: point for point in entry_points(group=_FORMER.get(group, group))}
    return former | {point.name: point for point in entry_points(group=group)}


def find_opener(
    group: str, url: str, error: type[SmartTouchError]
) -> tuple[Callable[..., Any], str]:
    """Return what opens ``url`` and the part of it after the name.

    Parameters
    ----------
    group : str
        Entry-point group, ``smarttouch.sources`` or ``smarttouch.boards``. The
        package's own kinds stand in the same group as anyone else's.
    url : str
        ``name:rest``, for example ``page:letter.png`` or ``link:/dev/ttyACM0``.
    error : type
        What to raise if no such name is known.

    Warns
    -----
    DeprecationWarning
        If the package that offers the name has it in a group of a former name.
    """
    name, colon, rest = url.partition(":")
    known = known_openers(group)
    if not colon or name not in known:
        raise unknown(group.rpartition(".")[2].removesuffix("s"), url, sorted(known), error)
    point = known[name]
    if point.group != group:
        package = point.dist.name if point.dist is not None else point.module
        warnings.warn(
            f"{package} offers {name}: in the entry-point group {point.group}, which is now "
            f"{group}: rename it in the pyproject.toml of {package}",
            DeprecationWarning,
            stacklevel=3,
        )
    opener: Callable[..., Any] = point.load()
    return opener, rest


def unknown(
    kind: str, url: str, known: Sequence[str], error: type[SmartTouchError]
) -> SmartTouchError:
    """Return the error of a URL that begins with none of the names that are known."""
    names = ", ".join(f"{each}:" for each in known)
    return error(
        f"unknown {kind} {url!r}: it must begin with one of {names}",
        about=kind,
        problem="unknown",
        value=url,
        allowed=tuple(known),
    )


def given_options(
    opener: Callable[..., Any],
    url: str,
    options: dict[str, Any],
    error: type[SmartTouchError],
) -> dict[str, Any]:
    """Return the options that were given, which those that are None were not.

    Raises
    ------
    SmartTouchError
        Of the type given, if the opener does not take one of them by its name.
    """
    given = {name: value for name, value in options.items() if value is not None}
    parameters = inspect.signature(opener).parameters.values()
    taken = tuple(each.name for each in parameters if each.default is not each.empty)
    for name in given:
        if name not in taken:
            takes = ", ".join(taken) or "none"
            raise error(
                f"{url.partition(':')[0]}: does not take {name}: leave it out (it takes {takes})",
                about=name,
                problem="unknown",
                value=given[name],
                allowed=taken,
            )
    return given


def refuse_rest(url: str, rest: str, error: type[SmartTouchError]) -> None:
    """Raise an error if something comes after the colon of a URL that takes nothing there."""
    if rest:
        message = f"{url} takes nothing after the colon, not {rest!r}"
        raise error(message, about="board", problem="malformed", value=rest)
