"""Profiles by name, and as TOML files."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from smarttouch.base.errors import ProfileError
from smarttouch.base.files import data_folder, read_toml
from smarttouch.profile.profile import Profile
from smarttouch.profile.toml_tables import table_error

DEFAULT_PROFILE = "electric-mouse"


def list_profiles() -> list[str]:
    """Return the names of the shipped profiles.

    Examples
    --------
    >>> import smarttouch as st
    >>> "electric-mouse" in st.list_profiles()
    True
    """
    return sorted(path.stem for path in data_folder("calibration").glob("*.toml"))


COARSEST_MM = 0.25  # largest ``skin.node_spacing_mm`` of a file whose array is not large
MOST_FINE = 200
"""Largest number of electrodes of which that is asked: rows of more may not fit into memory."""


def load_profile(name: str | Path | Profile) -> Profile:
    """Load a shipped profile by name, or any profile by its file; a profile is returned as it is.

    Raises
    ------
    ProfileError
        If there is none, or it has unknown keys or impossible values.

    Examples
    --------
    >>> import smarttouch as st
    >>> len(st.load_profile("electric-mouse").electrodes)
    64
    """
    if isinstance(name, Profile):
        return name
    path = profile_path(name)
    profile = profile_of(read_toml(path, ProfileError), path)
    skin, small = profile.skin, len(profile.electrodes) <= MOST_FINE
    if skin.medium != "plane" and skin.node_spacing_mm > COARSEST_MM and small:
        raise ProfileError(
            f"{path}: skin.node_spacing_mm {skin.node_spacing_mm:g} is of older profiles: between "
            "such places other classes get up to a third more than is bounded; set it to 0.1 (at "
            f"most {COARSEST_MM:g}), and kernels are designed again",
            key="skin.node_spacing_mm",
        )
    return profile


def profile_path(name: str | Path) -> Path:
    """Return the file of a profile, by its name or as it is given."""
    path = data_folder("calibration") / f"{name}.toml"
    if str(name) not in list_profiles():
        path = Path(str(name))
        if not _is_there(path):
            raise ProfileError(
                f"no profile {str(name)!r}: give a TOML file or one of "
                f"{', '.join(list_profiles())}",
                key="profile",
            )
    return path


def profile_of(table: Mapping[str, Any], path: Path) -> Profile:
    """Return the profile in the table of a file; files beside it are found from there."""
    try:
        profile = Profile.model_validate({**table, "name": path.stem})
    except ProfileError as error:
        # Of the array alone, which names no file.
        message = f"{path}: {error}"
        error.args, error.complaints = (message,), ((error.key, message),)
        raise
    except ValidationError as error:
        raise table_error(ProfileError, path, error) from None
    if profile.optics.flat_field is None:
        return profile
    beside = str(path.parent / profile.optics.flat_field)
    optics = profile.optics.model_copy(update={"flat_field": beside})
    return profile.model_copy(update={"optics": optics})


def _is_there(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:
        # Reading it raises the right error.
        return True
