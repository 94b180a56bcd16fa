"""Sources, forces and boards by URL: a name before the first colon picks the opener."""

import inspect
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from importlib.metadata import EntryPoint, entry_points
from typing import Any, TypeVar

from smarttouch.base.errors import SmartTouchError, kind_in_words
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
        "emulator": "smarttouch.emulator.emulated_boards:open_emulator",
        "etactilekit": "smarttouch.boards.kits.etactilekit:ETactileKitDriver",
        "kajimoto61": "smarttouch.boards.kits.kajimoto61:Kajimoto61Driver",
        "link": "smarttouch.boards.link.link_driver:LinkDriver",
        "memory": "smarttouch.boards.open:MemoryDriver",
        "simulated": "smarttouch.emulator.emulated_boards:SimulatedDriver",
    },
}
"""The package's own, by entry-point group; no other package can take their names."""
_T = TypeVar("_T")


def known_names(group: str) -> list[str]:
    """Return the names that a URL of a group can begin with, plug-ins included."""
    return sorted({*_OWN[group], *plug_in_names(group)})


def plug_in_names(group: str) -> list[str]:
    """Return the names that other packages have in a group."""
    return sorted({point.name for point in _plug_ins(group)})


def find_opener(
    group: str, url: str, error: type[SmartTouchError]
) -> tuple[Callable[..., Any], str]:
    """Return the opener of ``url`` and the part of the URL after the name."""
    name, colon, rest = url.partition(":")
    if colon and name in _OWN[group]:
        return EntryPoint(name, _OWN[group][name], group).load(), rest
    point = _plug_in(group, name, error) if colon else None
    if point is None:
        raise unknown(_kind(group), url, known_names(group), error)
    return _loaded(point, error), rest


def require_kind(opened: object, kind: type, url: str, error: type[SmartTouchError]) -> None:
    """Raise unless the opener of a URL, perhaps of another package, returned the right kind."""
    if not isinstance(opened, kind):
        raise error(f"{url} gives {kind_in_words(opened)}: its package must give a {kind.__name__}")


def load_plug_in(group: str, name: str, error: type[SmartTouchError], kind: type[_T]) -> _T | None:
    """Return an object that another package has under a name; None if there is none."""
    point = _plug_in(group, name, error)
    if point is None:
        return None
    found: _T = _loaded(point, error)
    require_kind(found, kind, name, error)
    return found


def _plug_in(group: str, name: str, error: type[SmartTouchError]) -> EntryPoint | None:
    """Return the entry point of another package by its name, which only one may have."""
    points = [point for point in _plug_ins(group) if point.name == name]
    packages = sorted({package_of(point) for point in points})
    if len(packages) > 1:
        kind = _kind(group)
        raise error(
            f"the packages {' and '.join(packages)} both have a {kind} {name}: remove one of them"
        )
    return points[0] if points else None


def unknown(
    kind: str, url: str, known: Sequence[str], error: type[SmartTouchError]
) -> SmartTouchError:
    """Return the error of a URL that begins with no known name."""
    name, colon, _ = url.partition(":")
    if colon and (sentence := instead_of(URLS, name)):
        return error(sentence)
    close = [name] if name in known else get_close_matches(name.lower(), known, 1, 0.75)
    meant = close[0] if close else ""
    if meant:
        way = f"did you mean {meant}:{url[len(name) + len(colon) :]}"
    elif kind == "board" and url.startswith("/"):
        way = f"a port does not say which board is on it; write its kind first, as in link:{url}"
    else:
        way = "it must begin with one of " + ", ".join(f"{each}:" for each in known)
    return error(f"unknown {kind} {url!r}: {way}")


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
                f"{url.partition(':')[0]}: does not take {name}: leave it out (it takes {takes})"
            )
    return given


def package_of(point: EntryPoint) -> str:
    """Return the name of an entry point's package."""
    return point.dist.name if point.dist is not None else point.module


def _kind(group: str) -> str:
    return group.rpartition(".")[2].removesuffix("s")


def _plug_ins(group: str) -> list[EntryPoint]:
    """Return the entry points of other packages."""
    return [point for point in entry_points(group=group) if point.name not in _OWN.get(group, ())]


def _loaded(point: EntryPoint, error: type[SmartTouchError]) -> Any:
    try:
        return point.load()
    except Exception as broken:
        raise error(
            f"{point.name}: of the package {package_of(point)} cannot be loaded "
            f"({type(broken).__name__}: {broken}): repair or remove that package"
        ) from broken


def refuse_rest(url: str, rest: str, error: type[SmartTouchError]) -> None:
    """Raise an error if something comes after the colon of a URL that takes nothing there."""
    if rest:
        raise error(f"{url} takes nothing after the colon, not {rest!r}")
