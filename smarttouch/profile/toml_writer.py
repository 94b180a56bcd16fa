"""Profiles as TOML text: whole, with their defaults and with what calibrations measured."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import tomlkit
from tomlkit.items import Array
from tomlkit.items import Table as TomlTable

from smarttouch.profile.profile import Profile
from smarttouch.profile.toml_tables import Table

CALIBRATED_KEYS: dict[str, tuple[str, ...]] = {
    "optics": ("optics.flat_field",),
    "registration": ("optics.homography", "optics.sensor_columns", "optics.sensor_rows"),
    "force": ("force.curve",),
    "thresholds": ("perception.threshold_ma", "perception.comfort_ma"),
    "contact": ("output.impedance_kohm", "output.masked"),
}
"""Keys that each calibration measures."""
_A_LINE = 8  # numbers of a long list on one line


def as_toml(profile: Profile) -> str:
    """Return all values of a profile, as they would stand in a file. A comment beside each value
    that is not the file's own says whether it is a default, or which calibration it comes from."""
    origins = {
        key: f"calibrated: {part}, {note.when:%Y-%m-%d}"
        for part, note in profile.calibrated.items()
        for key in CALIBRATED_KEYS.get(part, ())
    }
    document = tomlkit.document()
    _fill(document, profile, "", origins)
    return tomlkit.dumps(document)


def difference(one: Profile, other: Profile) -> str | None:
    """Return the first key in which two profiles differ, apart from calibrations and defaults."""
    measured = {key for keys in CALIBRATED_KEYS.values() for key in keys}
    values, others = dict(_flat(one)), dict(_flat(other))
    for key in values | others:
        aside = key in ("name", "title", "calibrated") or key in measured
        aside = aside or key.startswith("defaults.")
        if not aside and values.get(key) != others.get(key):
            return key
    return None


def in_rows(values: Sequence[Any]) -> Array:
    """Return a list as TOML, a long one in rows."""
    rows = tomlkit.array()
    if len(values) <= _A_LINE:
        rows.extend(values)
        return rows
    width = 3 if len(values) == 9 else _A_LINE
    for first in range(0, len(values), width):
        rows.add_line(*values[first : first + width])
    rows.add_line(indent="")
    return rows


def _values(table: Table) -> Iterator[tuple[str, Any]]:
    for name in type(table).model_fields:
        yield name, getattr(table, name)


def _flat(table: Table, before: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in _values(table):
        if isinstance(value, Table):
            yield from _flat(value, f"{before}{name}.")
        else:
            yield before + name, value


def _fill(into: Any, table: Table, before: str, origins: Mapping[str, str]) -> None:
    # Tables come last: what follows one in a file is its own.
    inner = {}
    for name, value in _values(table):
        key = before + name
        if value is None or key == "name":
            continue
        if isinstance(value, Table | dict):
            inner[name] = value
            continue
        item = tomlkit.item(in_rows(_plain(value)) if isinstance(value, tuple) else value)
        into[name] = item
        default = "" if name in table.model_fields_set else "default"
        if comment := origins.get(key, default):
            item.comment(comment)
    for name, value in inner.items():
        if (made := _made(value, f"{before}{name}.", origins)) is not None:
            into[name] = made


def _made(value: Any, before: str, origins: Mapping[str, str]) -> TomlTable | None:
    made = tomlkit.table(is_super_table=isinstance(value, dict))
    if isinstance(value, Table):
        _fill(made, value, before, origins)
        return made
    for name, each in value.items():
        made[name] = _made(each, f"{before}{name}.", origins)
    return made if value else None


def _plain(value: Any) -> Any:
    return [_plain(each) for each in value] if isinstance(value, tuple) else value
