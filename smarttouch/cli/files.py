"""What the commands share: modes by name, and files to write."""

import json
import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from smarttouch.errors import SmartTouchError
from smarttouch.files import write_bytes
from smarttouch.primary import Mode, Primary

if TYPE_CHECKING:
    from smarttouch.profile import Profile

Choice = TypeVar("Choice", bound=str)


def parse_mode(mode: str) -> Mode:
    """Return the mode that ``--mode`` names, one that images can drive."""
    offered = [each for each in Mode if each is not Mode.COLOR]
    for each in offered:
        if mode.lower() == each.value.lower():
            return each
    raise SmartTouchError(f"--mode {mode!r} is not offered: choose {' or '.join(offered)}")


def parse_choice(option: str, text: str, choices: Iterable[Choice]) -> Choice:
    """Return the one of several choices that an option names."""
    known = list(choices)
    if text.lower() not in known:
        raise SmartTouchError(f"{option} {text!r} is not offered: choose {' or '.join(known)}")
    return next(each for each in known if each == text.lower())


def parse_primary(mode: str) -> Primary:
    """Return the primary that ``--mode`` names."""
    if mode.upper() not in Primary.__members__:
        names = " or ".join(Primary.__members__)
        raise SmartTouchError(f"--mode {mode!r} is not offered: choose {names}")
    return Primary[mode.upper()]


def parse_size(size: str | None) -> tuple[int, int] | None:
    """Return width and height that ``--size`` names, as in 640x480."""
    if size is None:
        return None
    found = re.fullmatch("([1-9][0-9]{0,4})x([1-9][0-9]{0,4})", size.lower())
    if found is None:
        raise SmartTouchError(f"--size {size!r} is not a size: give width and height as 640x480")
    return int(found[1]), int(found[2])


def require_site(profile: "Profile", site: int) -> None:
    """Raise unless a profile's array has such a site."""
    count = len(profile.electrodes)
    if not 0 <= site < count:
        raise SmartTouchError(
            f"site {site} is out of range: {profile.name} has sites 0 to {count - 1}"
        )


def require_folder(path: Path | None) -> None:
    """Raise before any work is done if a file could not be written in the end."""
    if path is not None and (path.is_dir() or not path.absolute().parent.is_dir()):
        raise SmartTouchError(f"cannot write {path}: give a file in a folder that exists")


def write_json(path: Path, figures: Any) -> None:
    """Write figures as JSON, in which a number that is none, or endless, is null."""
    write_bytes(path, (json.dumps(_finite(figures), indent=2, allow_nan=False) + "\n").encode())


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
