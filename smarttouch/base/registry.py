"""Sources, forces and boards by URL: a name before the first colon picks the opener."""

import functools
import inspect
from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from importlib.metadata import EntryPoint, entry_points
from typing import Any, NamedTuple, TypeVar

from smarttouch.base.errors import SmartTouchError
from smarttouch.base.removed import URLS, instead_of

_OWN = {
    "smarttouch.sources": {
        "brltty": "smarttouch.reading.brltty_source:open_brltty",
        "camera": "smarttouch.sources.camera:open_camera",
        "frames": "smarttouch.sources.video:open_frames",
        "page": "smarttouch.sources.virtual_finger:open_page",
        "recording": "smarttouch.running.recorded_source:open_recording",
        "serial-array": "smarttouch.sources.serial_array:open_serial_array",
        "socket": "smarttouch.instruments.socket_source:SocketSource",
        "text": "smarttouch.sources.virtual_finger:open_text",
        "texture": "smarttouch.instruments.electric_mouse:open_texture_source",
        "vibration": "smarttouch.instruments.color_source:open_vibration",
        "video": "smarttouch.sources.video:open_video",
    },
    "smarttouch.forces": {
        "fixed": "smarttouch.sources.force:FixedForce",
        "hx711": "smarttouch.sources.load_cell:open_hx711",
        "loadcell": "smarttouch.sources.load_cell:open_load_cell",
        "recorded": "smarttouch.sources.force:RecordedForce",
    },
    "smarttouch.boards": {
        "emulator": "smarttouch.emulator.emulated_boards:EmulatorBoard",
        "etactilekit": "smarttouch.boards.kits.etactilekit:ETactileKitBoard",
        "kajimoto61": "smarttouch.boards.kits.kajimoto61:Kajimoto61Board",
        "link": "smarttouch.boards.link.link_board:LinkBoard",
        "memory": "smarttouch.boards.open:MemoryBoard",
        "simulated": "smarttouch.emulator.emulated_boards:SimulatedBoard",
        "vibrators": "smarttouch.boards.vibrators.vibrator_board:VibratorBoard",
    },
}
"""The package's own, by entry-point group; no other package can take their names."""
_T = TypeVar("_T")
_BY_POSITION = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)


class Fault(NamedTuple):
    """One way in which a class or opener breaks the contract of its kind."""

    about: str  # name of the method or class
    sentence: str


def known_names(group: str) -> list[str]:
    """Return the names that a URL of a group can begin with, plug-ins included."""
    return sorted({*_OWN[group], *plug_in_names(group)})


def plug_in_names(group: str) -> list[str]:
    """Return the names that other packages have in a group."""
    return sorted({point.name for point in _plug_ins(group)})


def find_opener(
    group: str, url: str, error: type[SmartTouchError], base: type, arguments: tuple[str, ...]
) -> tuple[Callable[..., Any], str]:
    """Return the opener of ``url`` and the part of the URL after the name.

    That of another package is checked: whether it can be called with ``arguments`` by position, and
    whether its class keeps the contract of ``base``.
    """
    name, colon, rest = url.partition(":")
    kind = _kind(group)
    if colon and name in _OWN[group]:
        return EntryPoint(name, _OWN[group][name], group).load(), rest
    point = _plug_in(group, name, error) if colon else None
    if point is None:
        raise unknown(kind, url, known_names(group), error)
    return _load(point, error, base, arguments), rest


def load_plug_in(group: str, name: str, error: type[SmartTouchError], kind: type[_T]) -> _T | None:
    """Return an object that another package has under a name; None if there is none."""
    point = _plug_in(group, name, error)
    if point is None:
        return None
    found = _loaded(point, error)
    if not isinstance(found, kind):
        how = f"{point.value} is no {kind.__name__}"
        raise _refusal(point, Fault(point.value, how), error)
    return found


def _plug_in(group: str, name: str, error: type[SmartTouchError]) -> EntryPoint | None:
    """Return the entry point of another package by its name, which only one may have."""
    points = [point for point in _plug_ins(group) if point.name == name]
    packages = sorted({package_of(point) for point in points})
    if len(packages) > 1:
        kind = _kind(group)
        raise error(
            f"the packages {' and '.join(packages)} both have a {kind} {name}: remove one of them",
            about=kind,
        )
    return points[0] if points else None


def unknown(
    kind: str, url: str, known: Sequence[str], error: type[SmartTouchError]
) -> SmartTouchError:
    """Return the error of a URL that begins with no known name."""
    name, colon, _ = url.partition(":")
    if colon and (sentence := instead_of(URLS, name)):
        return error(sentence, about=kind)
    close = [name] if name in known else get_close_matches(name.lower(), known, 1, 0.75)
    meant = close[0] if close else ""
    if meant:
        way = f"did you mean {meant}:{url[len(name) + len(colon) :]}"
    elif kind == "board" and url.startswith("/"):
        way = f"a port does not say which board is on it; write its kind first, as in link:{url}"
    else:
        way = "it must begin with one of " + ", ".join(f"{each}:" for each in known)
    return error(f"unknown {kind} {url!r}: {way}", about=kind, remedy=meant and f"{meant}:")


def given_options(
    opener: Callable[..., Any], url: str, options: dict[str, Any], error: type[SmartTouchError]
) -> dict[str, Any]:
    """Return the options that are not None; raises if the opener does not take one by its name."""
    given = {name: value for name, value in options.items() if value is not None}
    parameters = inspect.signature(opener).parameters.values()
    taken = tuple(each.name for each in parameters if each.default is not each.empty)
    for name in given:
        if name not in taken:
            takes = ", ".join(taken) or "none"
            raise error(
                f"{url.partition(':')[0]}: does not take {name}: leave it out (it takes {takes})",
                about=name,
            )
    return given


def package_of(point: EntryPoint) -> str:
    """Return the name of an entry point's package."""
    return point.dist.name if point.dist is not None else point.module


def fault_of(kind: type, base: type) -> Fault | None:
    """Return the first way in which a class breaks the contract of ``base``; None if in none.

    It must have every abstract method, replace no method that is final, and take in each
    what the one of ``base`` takes.
    """
    if not issubclass(kind, base):
        return Fault(kind.__name__, f"{kind.__name__} is no {base.__name__}")
    replaced = replaced_finals(kind, base)
    if replaced:
        which = f"{base.__name__}.{replaced[0]}"
        return Fault(replaced[0], f"{kind.__name__} replaces {which}, which is final")
    missing = sorted(getattr(kind, "__abstractmethods__", ()))
    if missing:
        return Fault(missing[0], f"{kind.__name__} has no method {missing[0]}")
    for name in sorted(dir(base)):
        expected, own = inspect.getattr_static(base, name), inspect.getattr_static(kind, name)
        if not inspect.isfunction(expected) or own is expected or name.startswith("__"):
            continue
        called = _positions(expected)
        if not inspect.isfunction(own) or not _can_take(own, called):
            how = f"{kind.__name__}.{name} cannot be called as {name}({', '.join(called[1:])})"
            return Fault(name, how)
    return None


def final_names(base: type) -> list[str]:
    """Return the names of the final methods and properties of a class."""
    return [name for name in dir(base) if is_final(inspect.getattr_static(base, name))]


def replaced_finals(kind: type, base: type) -> list[str]:
    """Return the names of the final methods of ``base`` that a class has replaced."""
    static = inspect.getattr_static
    return [name for name in final_names(base) if static(kind, name) is not static(base, name)]


def is_final(member: object) -> bool:
    """Whether a member of a class is a method or property marked as final."""
    inner = member.fget if isinstance(member, property) else member
    return getattr(inner, "__final__", False) is True


def _positions(function: Callable[..., Any]) -> tuple[str, ...]:
    parameters = inspect.signature(function).parameters.values()
    return tuple(each.name for each in parameters if each.kind in _BY_POSITION)


def _can_take(function: Callable[..., Any], arguments: Iterable[str]) -> bool:
    try:
        inspect.signature(function).bind(*arguments)
    except (TypeError, ValueError):
        return False
    return True


def _kind(group: str) -> str:
    return group.rpartition(".")[2].removesuffix("s")


def _plug_ins(group: str) -> list[EntryPoint]:
    """Return the entry points of other packages."""
    return [point for point in entry_points(group=group) if point.name not in _OWN.get(group, ())]


def _refusal(point: EntryPoint, fault: Fault, error: type[SmartTouchError]) -> SmartTouchError:
    return error(
        f"{point.name}: of the package {package_of(point)} cannot be used: {fault.sentence}",
        about=fault.about,
    )


def _loaded(point: EntryPoint, error: type[SmartTouchError]) -> Any:
    try:
        return point.load()
    except Exception as broken:
        why = f"{point.value} cannot be loaded ({type(broken).__name__}: {broken})"
        raise _refusal(point, Fault(point.value, why), error) from broken


def _load(
    point: EntryPoint, error: type[SmartTouchError], base: type, arguments: tuple[str, ...]
) -> Callable[..., Any]:
    """Return the opener of an entry point, if it and its class keep the contract."""
    opener = _loaded(point, error)
    if not callable(opener) or not _can_take(opener, arguments):
        how = f"{point.attr} cannot be called as {point.attr}({', '.join(arguments)})"
        raise _refusal(point, Fault(point.attr, how), error)
    if isinstance(opener, type):
        fault = fault_of(opener, base)
        if fault is not None:
            raise _refusal(point, fault, error)
        return opener

    @functools.wraps(opener)
    def checked(*given: Any, **options: Any) -> Any:
        made = opener(*given, **options)
        fault = fault_of(type(made), base)
        if fault is not None:
            raise _refusal(point, fault, error)
        return made

    return checked


def refuse_rest(url: str, rest: str, error: type[SmartTouchError]) -> None:
    """Raise an error if something comes after the colon of a URL that takes nothing there."""
    if rest:
        raise error(f"{url} takes nothing after the colon, not {rest!r}", about="board")
