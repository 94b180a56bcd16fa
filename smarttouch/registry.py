"""Sensors and boards by URL: a name before the first colon picks the opener."""

from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Any

from smarttouch.errors import SmartTouchError


def find_opener(
    group: str, url: str, error: type[SmartTouchError]
) -> tuple[Callable[..., Any], str]:
    """Return what opens ``url`` and the part of it after the name.

    Parameters
    ----------
    group : str
        Entry-point group, ``smarttouch.sensors`` or ``smarttouch.boards``. The
        package's own kinds stand in the same group as anyone else's.
    url : str
        ``name:rest``, for example ``page:letter.png`` or ``link:/dev/ttyACM0``.
    error : type
        What to raise if no such name is known.
    """
    name, colon, rest = url.partition(":")
    known = {point.name: point for point in entry_points(group=group)}
    if not colon or name not in known:
        kind = group.rpartition(".")[2].removesuffix("s")
        names = ", ".join(f"{each}:" for each in sorted(known))
        raise error(
            f"unknown {kind} {url!r}: it must begin with one of {names}",
            about=kind,
            problem="unknown",
            value=url,
            allowed=tuple(sorted(known)),
        )
    opener: Callable[..., Any] = known[name].load()
    return opener, rest


def refuse_rest(url: str, rest: str, error: type[SmartTouchError]) -> None:
    """Raise an error if something comes after the colon of a URL that takes nothing there."""
    if rest:
        message = f"{url} takes nothing after the colon, not {rest!r}"
        raise error(message, about="board", problem="malformed", value=rest)
