"""URLs of boards, sources and forces: a name before the first colon, and options after ``?``."""

import inspect
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin
from urllib.parse import unquote

from smarttouch.base.errors import SmartTouchError, kind_in_words
from smarttouch.base.files import file_at


class Registry:
    """Functions that open one kind of device, by name: built-in ones and those of other packages.

    ``built_in`` maps names to ``module:opener``. Other packages add other names, as entry points
    of ``group``. Openers must return an object of class ``kind``. Problems raise ``error``.
    """

    def __init__(
        self, group: str, kind: type, error: type[SmartTouchError], built_in: Mapping[str, str]
    ) -> None:
        self._group, self._kind, self._error, self._built_in = group, kind, error, built_in
        self._what = group.rpartition(".")[2].removesuffix("s")

    @property
    def names(self) -> list[str]:
        """All names, sorted."""
        from importlib.metadata import entry_points

        return sorted({*self._built_in, *entry_points(group=self._group).names})

    def find(self, url: str) -> tuple[Callable[..., Any], str]:
        """Return the opener for ``url`` and the part of the URL after the name."""
        name, colon, rest = url.partition(":")
        if colon and name in self._built_in:
            module, _, opener = self._built_in[name].partition(":")
            return getattr(import_module(module), opener), rest
        from importlib.metadata import entry_points

        if not colon or name not in self.names:
            raise unknown(self._what, url, self.names, self._error)
        points = entry_points(group=self._group, name=name)
        packages = sorted({point.dist.name if point.dist else point.module for point in points})
        if len(packages) > 1:
            raise self._error(
                f"the packages {' and '.join(packages)} both have a {self._what} {name}: remove "
                "one of them"
            )
        try:
            return points[name].load(), rest
        except Exception as broken:
            raise self._error(
                f"the {self._what} {name} of the package {packages[0]} cannot be loaded "
                f"({type(broken).__name__}: {broken}): repair or remove that package"
            ) from broken

    def require_kind(self, opened: object, url: str) -> None:
        """Raise an error unless an opener returned an object of the right class."""
        if not isinstance(opened, self._kind):
            raise self._error(
                f"{url} opened {kind_in_words(opened)} instead of a {self._kind.__name__}: report "
                "this to the author of its package"
            )


def unknown(
    kind: str, url: str, known: Sequence[str], error: type[SmartTouchError]
) -> SmartTouchError:
    """Return the error for a URL with an unknown name."""
    from difflib import get_close_matches

    name, colon, _ = url.partition(":")
    close = [name] if name in known else get_close_matches(name.lower(), known, 1, 0.75)
    if close:
        way = f"did you mean {close[0]}:{url[len(name) + len(colon) :]}"
    elif kind == "board" and url.startswith("/"):
        way = f"a port does not show its kind of board: write the kind first, as in link:{url}"
    else:
        way = "it must begin with one of " + ", ".join(f"{known_name}:" for known_name in known)
    return error(f"unknown {kind} {url!r}: {way}")


def refuse_rest(url: str, rest: str, error: type[SmartTouchError]) -> None:
    """Raise an error if there is text after the colon of a URL that takes none."""
    if rest:
        raise error(f"{url} takes nothing after the colon: leave out {rest!r}")


def read_options(
    opener: Callable[..., Any], rest: str, error: type[SmartTouchError],
    but: Collection[str] = (), **more: type,
) -> tuple[str, dict[str, Any]]:  # fmt: skip
    """Split ``rest``, the part of a URL after its name, into an address and options.

    Options are the parameters of ``opener`` with a default, and the names in ``more``. Parameters
    in ``but`` are not options. All of ``rest`` is the address if a file named ``rest`` exists, or
    if the part after ``?`` does not look like options (``text:Is it so?``).
    """
    address, mark, query = rest.rpartition("?")
    known = options_of(opener, but) | more
    parts = [part.partition("=")[::2] for part in query.split("&")]
    if not (mark and known) or not all(_NAME.fullmatch(name) for name, _ in parts):
        return rest, {}
    # A name without a value is an option only if it is known: "text:Why?because" has no option.
    if not all(name in known or f"{name}=" in query for name, _ in parts) or file_at(rest):
        return rest, {}
    values: dict[str, Any] = {}
    for name, text in parts:
        if name not in known:
            raise error(f"{rest!r} has an unknown option {name}: use {', '.join(sorted(known))}")
        kind = known[name]
        value = _read_option(name, unquote(text), kind, error)
        if kind is Sequence:
            values.setdefault(name, []).append(value)
        elif name in values:
            raise error(f"{rest!r} has {name} twice: give it once")
        else:
            values[name] = value
    return address, values


def all_options(
    opener: Callable[..., Any],
    url: str,
    rest: str,
    beside: Mapping[str, Any],
    error: type[SmartTouchError],
    but: Collection[str] = (),
) -> tuple[str, dict[str, Any]]:
    """Split a URL as `read_options` does, and add the options in ``beside`` that are not None.

    Raises ``error`` if an option in ``beside`` is unknown or also in the URL.
    """
    options = {name: value for name, value in beside.items() if value is not None}
    parameters = inspect.signature(opener).parameters.values()
    taken = [parameter.name for parameter in parameters if parameter.default is not parameter.empty]
    for name in options:
        if name not in taken:
            kind, takes = url.partition(":")[0], ", ".join(taken) or "none"
            raise error(f"'{kind}:' has no option {name}: leave {name} out (options: {takes})")
    address, in_url = read_options(opener, rest, error, but)
    if twice := sorted(options.keys() & in_url.keys()):
        raise error(f"{twice[0]} is given in {url!r} and as an argument: leave one out")
    return address, options | in_url


def parse_size(text: str, error: type[SmartTouchError], name: str) -> tuple[int, int]:
    """Parse width and height, as in 640x480."""
    match = re.fullmatch("([1-9][0-9]{0,4})x([1-9][0-9]{0,4})", text.lower())
    if match is None:
        raise error(f"{name} {text!r} is not a size: give width and height as 640x480")
    return int(match[1]), int(match[2])


_NAME = re.compile("[a-z][a-z0-9_]*")
_TRUTHS = {"": True, "1": True, "yes": True, "true": True, "0": False, "no": False, "false": False}


def options_of(opener: Callable[..., Any], but: Collection[str] = ()) -> dict[str, Any]:
    """Return the type of each option that an opener accepts in a URL. Keys are option names."""
    kinds = {}
    for parameter in inspect.signature(opener).parameters.values():
        if parameter.default is inspect.Parameter.empty or parameter.name in but:
            continue
        kind = parameter.annotation
        if get_origin(kind) is Annotated:
            kind = get_args(kind)[0]
        if get_origin(kind) in (Union, UnionType):
            kind = next(part for part in get_args(kind) if part is not type(None))
        kind = get_origin(kind) or kind
        kind = Sequence if kind is list else kind
        if kind in (bool, int, float, str, tuple, Path, Sequence):
            kinds[parameter.name] = kind
    return kinds


def _read_option(name: str, text: str, kind: Any, error: type[SmartTouchError]) -> Any:
    if kind is tuple:
        return parse_size(text, error, f"?{name}")
    try:
        if kind is bool:
            return _TRUTHS[text.lower()]
        return text if kind is Sequence else kind(text)
    except (ValueError, KeyError):
        needed = {bool: "1 or 0", int: "a whole number", float: "a number"}[kind]
        raise error(f"{name}={text} is not valid: give {needed}, as in ?{name}=1") from None
