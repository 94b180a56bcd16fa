"""A profile that is shown is whole, and says where each value comes from."""

import tomllib
from datetime import UTC, datetime
from pathlib import Path

import pytest

from smarttouch.profile import list_profiles, load_profile
from smarttouch.profile.toml_files import profile_of
from smarttouch.profile.toml_writer import CALIBRATED_KEYS, as_toml, difference

NOTE = {"when": datetime(2026, 3, 2, tzinfo=UTC), "versions": "smarttouch 0.1", "found": "good"}


def comment(text, key):
    (line,) = [each for each in text.splitlines() if each.startswith(f"{key} = ")]
    return line.partition("#")[2].strip()


def read_back(text, profile):
    return profile_of(tomllib.loads(text), Path(f"{profile.name}.toml"))


@pytest.mark.parametrize("name", list_profiles())
def test_it_is_read_back_as_it_was(name):
    profile = load_profile(name)
    text = as_toml(profile)
    assert read_back(text, profile) == profile
    assert comment(text, "title") == ""
    assert comment(text, "carrier") == "default"


def test_lists_and_calibrations(profile, changed):
    keys = {
        "perception.threshold_ma": [1.0 + each / 1000 for each in range(64)],
        "output.masked": [3],
        "optics.homography": [1.0, 0, 0, 0, 1, 0, 0, 0, 1],
        "calibrated": {"thresholds": NOTE, "contact": NOTE},
    }
    measured = changed(profile, keys)
    text = as_toml(measured)
    assert read_back(text, measured) == measured
    assert "thresholds" in text[: text.index("[calibrated")]
    assert comment(text, "masked") == "calibrated: contact, 2026-03-02"
    assert comment(text, "homography") == ""


MEASURED = {
    "optics.flat_field": "other.npz", "optics.homography": (1.0, 0, 0.1, 0, 1, 0, 0, 0, 1),
    "optics.sensor_columns": 99, "optics.sensor_rows": 98, "force.curve": (0.0, 0.5),
    "perception.threshold_ma": 0.9, "perception.comfort_ma": (1.5,) * 64,
    "output.impedance_kohm": 12.5, "output.masked": (3,),
}  # fmt: skip


@pytest.mark.parametrize("key", [key for keys in CALIBRATED_KEYS.values() for key in keys])
def test_calibrations_make_no_difference(key, profile):
    table, _, name = key.partition(".")
    inner = getattr(profile, table).model_copy(update={name: MEASURED[key]})
    other = profile.model_copy(update={table: inner})
    assert other != profile
    assert difference(profile, other) is None


def test_anything_else_does(profile, changed):
    other = changed(profile, {"limits.current_ma": 4.0, "pulse.rate_hz": 40.0})
    assert difference(profile, other) in ("limits.current_ma", "pulse.rate_hz")
    assert difference(profile, load_profile("line-7")) is not None
    assert difference(profile, profile) is None
