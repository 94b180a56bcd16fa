"""Helpers of the commands: modes by name, and files to write."""

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from smarttouch.afferent import Afferent, Mode
from smarttouch.errors import SmartTouchError, not_offered, require_within
from smarttouch.files import write_bytes

if TYPE_CHECKING:
    from smarttouch.profile import Profile

Choice = TypeVar("Choice", bound=str)


def parse_mode(mode: str) -> Mode:
    """Return a mode by its name, one that images can drive."""
    offered = [each for each in Mode if each is not Mode.COLOR]
    for each in offered:
        if mode.lower() == each.value.lower():
            return each
    raise not_offered("mode", mode, offered)


def parse_choice(option: str, text: str, choices: Iterable[Choice]) -> Choice:
    """Return the one of several choices that an option names; capitals do not count."""
    known = list(choices)
    if text.lower() not in known:
        raise not_offered(option, text, known)
    return next(each for each in known if each == text.lower())


def parse_afferent(mode: str) -> Afferent:
    """Return a class of afferents by its name."""
    if mode.upper() not in Afferent.__members__:
        raise not_offered("mode", mode, Afferent.__members__)
    return Afferent[mode.upper()]


def require_site(profile: "Profile", site: int) -> None:
    """Raise unless a profile's array has such a site."""
    words = f"site {site} of {profile.name}"
    require_within(SmartTouchError, "site", site, 0, len(profile.electrodes) - 1, words)


def require_folder(path: Path | None) -> None:
    """Raise before any work is done if a file could not be written in the end."""
    if path is not None and (path.is_dir() or not path.absolute().parent.is_dir()):
        message = f"cannot write {path}: give a file in a folder that exists"
        raise SmartTouchError(message, about="file", problem="unwritable", value=path)


def write_json(path: Path, figures: Any) -> None:
    """Write figures as JSON, in which a number that is none, or endless, is null."""
    write_bytes(path, (json.dumps(_finite(figures), indent=2, allow_nan=False) + "\n").encode())


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
