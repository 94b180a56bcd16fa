"""Loading of profiles by name and from TOML files."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from smarttouch.base.errors import ProfileError
from smarttouch.base.files import data_folder, file_at, read_toml
from smarttouch.profile.profile import Profile
from smarttouch.profile.toml_tables import Table, table_error

if TYPE_CHECKING:
    from tomlkit.items import Array

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


COARSEST_MM = 0.25  # largest ``skin.node_spacing_mm`` of arrays with up to `MOST_FINE` electrodes
MOST_FINE = 200  # with more electrodes, a spacing of `COARSEST_MM` would need too much memory


def load_profile(name: str | Path | Profile) -> Profile:
    """Load a shipped profile by name, or any profile from its file.

    Raises
    ------
    ProfileError
        If the profile does not exist, or has unknown keys or impossible values.

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
            f"{path}: skin.node_spacing_mm {skin.node_spacing_mm:g} is too coarse, because "
            "activation of other classes is a third larger between nodes than at nodes: set it to "
            f"0.1, or to {COARSEST_MM:g} at most",
            key="skin.node_spacing_mm",
        )
    return profile


def profile_path(name: str | Path) -> Path:
    """Return the path of a profile given by name or by file."""
    path = data_folder("calibration") / f"{name}.toml"
    if str(name) not in list_profiles():
        path = Path(str(name))
        if file_at(str(name)) is None:
            raise ProfileError(
                f"no profile {str(name)!r}: give a TOML file or one of "
                f"{', '.join(list_profiles())}",
                key="profile",
            )
    return path


def profile_of(table: Mapping[str, Any], path: Path) -> Profile:
    """Return the profile of a TOML table. Its paths are relative to the folder of ``path``."""
    try:
        profile = Profile.model_validate({**table, "name": path.stem})
    except ProfileError as error:
        # Errors that `ElectrodeArray` raises do not name the file.
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


CALIBRATED_KEYS: dict[str, tuple[str, ...]] = {
    "optics": ("optics.flat_field",),
    "registration": ("optics.homography", "optics.sensor_columns", "optics.sensor_rows"),
    "force": ("force.curve",),
    "thresholds": ("perception.threshold_ma", "perception.comfort_ma"),
    "contact": ("output.impedance_kohm", "output.masked"),
}
"""Keys measured by each calibration."""
_A_LINE = 8  # number of values on one line of a long list


def as_toml(profile: Profile) -> str:
    """Return all values of a profile as TOML, including defaults."""
    import tomlkit

    return tomlkit.dumps(profile.model_dump(exclude={"name"}, exclude_none=True))


def difference(one: Profile, other: Profile) -> str | None:
    """Return the first key in which two profiles differ, or None. Ignore names, titles,
    calibrations and defaults of commands."""
    measured = {key for keys in CALIBRATED_KEYS.values() for key in keys}
    values, others = dict(_flat(one)), dict(_flat(other))
    for key in values | others:
        aside = key in ("name", "title", "calibrated") or key in measured
        aside = aside or key.startswith("defaults.")
        if not aside and values.get(key) != others.get(key):
            return key
    return None


def in_rows(values: Sequence[Any]) -> "Array":
    """Return a list as TOML, in several rows if it is long."""
    import tomlkit

    rows = tomlkit.array()
    if len(values) <= _A_LINE:
        rows.extend(values)
        return rows
    width = 3 if len(values) == 9 else _A_LINE
    for first in range(0, len(values), width):
        rows.add_line(*values[first : first + width])
    rows.add_line(indent="")
    return rows


def _flat(table: Table, before: str = "") -> Iterator[tuple[str, Any]]:
    for name in type(table).model_fields:
        value = getattr(table, name)
        if isinstance(value, Table):
            yield from _flat(value, f"{before}{name}.")
        else:
            yield before + name, value
