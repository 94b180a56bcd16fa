"""Options in URLs."""

import inspect
import re
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin
from urllib.parse import unquote

from smarttouch.base.errors import SmartTouchError
from smarttouch.base.files import file_at


def read_options(
    opener: Callable[..., Any], rest: str, error: type[SmartTouchError], but: Collection[str] = ()
) -> tuple[str, dict[str, Any]]:
    """Return what follows the name in a URL without its options, and these in their types.

    Types are those of the annotations of the opener. A file that exists under the whole name has no
    options, nor has what looks like none (``text:Is it so?``), nor what belongs to an opener that
    takes none: that may have its own. Options in ``but`` are not for URLs.
    """
    place, mark, query = rest.rpartition("?")
    known = options_of(opener, but)
    parts = [each.partition("=")[::2] for each in query.split("&")]
    if not (mark and known) or not all(_NAME.fullmatch(name) for name, _ in parts):
        return rest, {}
    # Flags without a value must be known, or "text:Why?because" had one.
    if not all(name in known or f"{name}=" in query for name, _ in parts) or file_at(rest):
        return rest, {}
    found: dict[str, Any] = {}
    for name, text in parts:
        if name not in known:
            raise error(
                f"{rest!r} has no option {name}: choose {', '.join(sorted(known))}, or leave it out"
            )
        kind = known[name]
        value = _read_option(name, unquote(text), kind, error)
        if kind is Sequence:
            found.setdefault(name, []).append(value)
        elif name in found:
            raise error(f"{rest!r} has {name} twice: give it once")
        else:
            found[name] = value
    return place, found


def given_options(
    opener: Callable[..., Any], url: str, options: dict[str, Any], error: type[SmartTouchError]
) -> dict[str, Any]:
    """Return the options that are not None; raises if the opener does not take one by its name."""
    given = {name: value for name, value in options.items() if value is not None}
    parameters = inspect.signature(opener).parameters.values()
    taken = [each.name for each in parameters if each.default is not each.empty]
    for name in given:
        if name not in taken:
            kind, takes = url.partition(":")[0], ", ".join(taken) or "none"
            raise error(f"{kind}: does not take {name}: leave it out (it takes {takes})")
    return given


def joined_options(
    url: str, given: dict[str, Any], in_url: dict[str, Any], error: type[SmartTouchError]
) -> dict[str, Any]:
    """Return the options given beside a URL and those in it; raises if one is in both."""
    if twice := sorted(given.keys() & in_url.keys()):
        raise error(f"{twice[0]} is given in {url!r} and beside it: leave one out")
    return given | in_url


def parse_size(text: str, error: type[SmartTouchError], name: str) -> tuple[int, int]:
    """Return width and height, as in 640x480."""
    found = re.fullmatch("([1-9][0-9]{0,4})x([1-9][0-9]{0,4})", text.lower())
    if found is None:
        raise error(f"{name} {text!r} is not a size: give width and height as 640x480")
    return int(found[1]), int(found[2])


_NAME = re.compile("[a-z][a-z0-9_]*")
_TRUTHS = {"": True, "1": True, "yes": True, "true": True, "0": False, "no": False, "false": False}


def options_of(opener: Callable[..., Any], but: Collection[str] = ()) -> dict[str, Any]:
    """Return the type of each option of an opener that text can be turned into."""
    kinds = {}
    for each in inspect.signature(opener).parameters.values():
        if each.default is inspect.Parameter.empty or each.name in but:
            continue
        kind = each.annotation
        if get_origin(kind) is Annotated:
            kind = get_args(kind)[0]
        if get_origin(kind) in (Union, UnionType):
            kind = next(part for part in get_args(kind) if part is not type(None))
        kind = get_origin(kind) or kind
        kind = Sequence if kind is list else kind
        if kind in (bool, int, float, str, tuple, Path, Sequence):
            kinds[each.name] = kind
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
        raise error(f"?{name}={text} cannot be read: give {needed}, as in ?{name}=1") from None
