"""Boards, sources and forces by URL: the name before the first colon chooses the opener."""

from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from smarttouch.base.errors import SmartTouchError, kind_in_words


class Registry:
    """Names of one kind of device: built-in ones, and entry points of other packages.

    ``built_in`` has ``module:opener`` for each name; no other package can take these names. What an
    opener returns must be of the class ``kind``. Problems raise ``error``.
    """

    def __init__(
        self, group: str, kind: type, error: type[SmartTouchError], built_in: Mapping[str, str]
    ) -> None:
        self._group, self._kind, self._error, self._built_in = group, kind, error, built_in
        self._what = group.rpartition(".")[2].removesuffix("s")

    @property
    def names(self) -> list[str]:
        """All names, sorted."""
        return sorted({*self._built_in, *self.plug_ins})

    @property
    def plug_ins(self) -> list[str]:
        """Names that other packages have added."""
        return sorted({*entry_points(group=self._group).names} - {*self._built_in})

    def find(self, url: str) -> tuple[Callable[..., Any], str]:
        """Return the opener of ``url`` and the part of the URL after the name."""
        name, colon, rest = url.partition(":")
        if colon and name in self._built_in:
            return EntryPoint(name, self._built_in[name], self._group).load(), rest
        if not colon or name not in self.plug_ins:
            raise unknown(self._what, url, self.names, self._error)
        return self.load(name), rest

    def load(self, name: str) -> Any:
        """Return the object that another package has under one of `plug_ins`."""
        points = entry_points(group=self._group, name=name)
        packages = sorted({point.dist.name if point.dist else point.module for point in points})
        if len(packages) > 1:
            raise self._error(
                f"the packages {' and '.join(packages)} both have a {self._what} {name}: remove "
                "one of them"
            )
        try:
            return points[name].load()
        except Exception as broken:
            raise self._error(
                f"{name}: of the package {packages[0]} cannot be loaded "
                f"({type(broken).__name__}: {broken}): repair or remove that package"
            ) from broken

    def require_kind(self, opened: object, url: str) -> None:
        """Raise unless an opener, perhaps of another package, has returned the right class."""
        if not isinstance(opened, self._kind):
            raise self._error(
                f"{url} gives {kind_in_words(opened)}: its package must give a "
                f"{self._kind.__name__}"
            )


def unknown(
    kind: str, url: str, known: Sequence[str], error: type[SmartTouchError]
) -> SmartTouchError:
    """Return the error of a URL that begins with no known name."""
    name, colon, _ = url.partition(":")
    close = [name] if name in known else get_close_matches(name.lower(), known, 1, 0.75)
    if close:
        way = f"did you mean {close[0]}:{url[len(name) + len(colon) :]}"
    elif kind == "board" and url.startswith("/"):
        way = f"a port does not say which board is on it; write its kind first, as in link:{url}"
    else:
        way = "it must begin with one of " + ", ".join(f"{each}:" for each in known)
    return error(f"unknown {kind} {url!r}: {way}")


def refuse_rest(url: str, rest: str, error: type[SmartTouchError]) -> None:
    """Raise an error if something comes after the colon of a URL that takes nothing there."""
    if rest:
        raise error(f"{url} takes nothing after the colon, not {rest!r}")
