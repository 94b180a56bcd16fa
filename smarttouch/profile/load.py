"""Profiles by name, and as TOML files."""

from pathlib import Path
from typing import Any

from pydantic import ValidationError

from smarttouch.errors import ProfileError
from smarttouch.files import MOST_TOML_BYTES, parse_toml, read_text
from smarttouch.profile.profile import Profile
from smarttouch.profile.table import UnfitError
from smarttouch.resources import data_folder

DEFAULT_PROFILE = "electric-mouse"
_LAYOUTS = ("grid", "hexagon-61", "lines", "free")
_KINDS = ("constrained-", "function-", "tuple[")
"""Kinds of value that pydantic names between the keys of the file."""
_PROBLEMS = {
    "missing": "missing",
    "union_tag_not_found": "missing",
    "extra_forbidden": "unknown",
    "literal_error": "unknown",
    "union_tag_invalid": "unknown",
    "greater_than": "too small",
    "greater_than_equal": "too small",
    "less_than": "too large",
    "less_than_equal": "too large",
    "too_short": "too few",
    "too_long": "too many",
}
"""What pydantic calls it, and what `SmartTouchError` does."""
_BOUNDS = ("gt", "ge", "lt", "le", "min_length", "max_length")


def list_profiles() -> list[str]:
    """Return the names of the shipped profiles.

    Examples
    --------
    >>> import smarttouch as st
    >>> "electric-mouse" in st.list_profiles()
    True
    """
    return sorted(path.stem for path in data_folder("calibration").glob("*.toml"))


def load_profile(name: str | Path) -> Profile:
    """Load a shipped profile by name, or any profile by its file.

    Raises
    ------
    ProfileError
        If there is none, or it says something unknown or impossible.

    Examples
    --------
    >>> import smarttouch as st
    >>> len(st.load_profile("electric-mouse").electrodes)
    64
    """
    path = data_folder("calibration") / f"{name}.toml"
    if str(name) not in list_profiles():
        path = Path(name)
        if not _is_there(path):
            raise ProfileError(
                f"no profile {str(name)!r}: give a TOML file or one of "
                f"{', '.join(list_profiles())}",
                about="profile",
                problem="unknown",
                value=str(name),
                allowed=tuple(list_profiles()),
            )
    text = read_text(path, ProfileError, MOST_TOML_BYTES)
    try:
        table = parse_toml(text)
    except ValueError as error:
        raise ProfileError(
            f"{path} is not a readable TOML file: {error}",
            about="file",
            problem="malformed",
            value=path,
        ) from None
    try:
        profile = Profile.model_validate({**table, "name": path.stem})
    except ProfileError as error:
        # Of the array alone, which names no file.
        error.args = (f"{path}: {error}",)
        raise
    except ValidationError as error:
        raise _first_complaint(path, error) from None
    if profile.optics.flat_field is None:
        return profile
    beside = str(path.parent / profile.optics.flat_field)
    optics = profile.optics.model_copy(update={"flat_field": beside})
    return profile.model_copy(update={"optics": optics})


def _is_there(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:
        # Reading it will say what is wrong.
        return True


def _first_complaint(path: Path, error: ValidationError) -> ProfileError:
    first = error.errors()[0]
    parts = [str(part) for part in first["loc"] if part not in _LAYOUTS]
    kind, key = first["type"], ".".join(each for each in parts if not each.startswith(_KINDS))
    if kind.startswith("union_tag"):
        key += ".layout"
    given, context = first["input"], first.get("ctx", {})
    bounds = [context[each] for each in _BOUNDS if each in context]
    attributes: dict[str, Any] = {
        "about": key,
        "problem": _PROBLEMS.get(kind, "malformed"),
        "value": given,
        "allowed": bounds[0] if bounds else None,
    }
    message = first["msg"].removeprefix("Value error, ")
    if kind == "extra_forbidden":
        message = f"unknown key {key!r}: remove it or correct its spelling"
    elif attributes["problem"] == "missing":
        message = f"key {key!r} is missing: add it (any shipped profile shows how)"
        attributes["value"] = None
    elif kind == "union_tag_invalid":
        message = f"{key} = {repr(context['tag'])[:60]}: choose one of {', '.join(_LAYOUTS)}"
        attributes |= {"value": context["tag"], "allowed": _LAYOUTS}
    elif isinstance(given, dict) and key:
        message = f"{key}: {message}"
    elif key:
        message = f"{key} = {repr(given)[:60]}: {message}"
    if isinstance(context.get("error"), UnfitError):
        attributes |= context["error"].attributes
    return ProfileError(f"{path}: {message}", **attributes)
