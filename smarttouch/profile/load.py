"""Profiles by name, and as TOML files."""

from pathlib import Path

from pydantic import ValidationError

from smarttouch.errors import ProfileError
from smarttouch.files import MOST_TOML_BYTES, parse_toml, read_text
from smarttouch.profile.device import Profile
from smarttouch.resources import data_folder

DEFAULT_PROFILE = "electric-mouse"


def profile_names() -> list[str]:
    """Return the names of the shipped profiles."""
    return sorted(path.stem for path in data_folder("calibration").glob("*.toml"))


def load_profile(name: str | Path) -> Profile:
    """Load a shipped profile by name, or any profile by its file.

    Raises
    ------
    ProfileError
        If there is none, or it says something unknown or impossible.
    """
    path = data_folder("calibration") / f"{name}.toml"
    if str(name) not in profile_names():
        path = Path(name)
        if not _is_there(path):
            raise ProfileError(
                f"no profile {str(name)!r}: give a TOML file or one of {', '.join(profile_names())}"
            )
    text = read_text(path, ProfileError, MOST_TOML_BYTES)
    try:
        table = parse_toml(text)
    except ValueError as error:
        raise ProfileError(f"{path} is not a readable TOML file: {error}") from None
    try:
        profile = Profile.model_validate({**table, "name": path.stem})
    except ProfileError as error:
        raise ProfileError(f"{path}: {error}") from None
    except ValidationError as error:
        raise ProfileError(_first_complaint(path, error)) from None
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


def _first_complaint(path: Path, error: ValidationError) -> str:
    first = error.errors()[0]
    layouts = ("grid", "hexagon-61", "lines", "free")
    key = ".".join(str(part) for part in first["loc"] if part not in layouts)
    if first["type"] == "extra_forbidden":
        return f"{path}: unknown key {key!r}: remove it or correct its spelling"
    if first["type"] == "missing":
        return f"{path}: key {key!r} is missing: add it (any shipped profile shows how)"
    message = first["msg"].removeprefix("Value error, ")
    if not key:
        return f"{path}: {message}"
    if isinstance(first["input"], dict):
        return f"{path}: {key}: {message}"
    return f"{path}: {key} = {repr(first['input'])[:60]}: {message}"
