"""Profiles are found by name or file."""

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from smarttouch.base.errors import ProfileError
from smarttouch.profile import list_profiles, load_profile
from smarttouch.profile.toml_files import (
    CALIBRATED_KEYS,
    as_toml,
    difference,
    profile_of,
    profile_path,
)

from ..support.checks import raises

ELECTRODES = {
    "electric-mouse": 64, "smarttouch-4x4": 16, "line-7": 7, "line-8": 8, "kajimoto-61": 61,
    "etactilekit-32": 32, "optacon-24x6": 144, "concentric": 2,
}  # fmt: skip


def test_all_are_shipped():
    assert set(list_profiles()) == set(ELECTRODES)


@pytest.mark.parametrize("name", ELECTRODES)
def test_shipped(name):
    profile = load_profile(name)
    assert len(profile.electrodes) == ELECTRODES[name] == len(profile.threshold_ma)
    assert len(profile.driven) == ELECTRODES[name]
    distance = profile.electrodes.distance_mm + np.eye(ELECTRODES[name]) * 1e9
    # A ring's middle is where its disc is: what is a pitch away is the middle of its metal.
    nearest_mm = (8 + 6) / 4 if name == "concentric" else distance.min()
    assert profile.electrodes.pitch_mm == pytest.approx(nearest_mm)
    assert profile.electrodes.position_mm.mean(axis=0) == pytest.approx([0, 0])


def test_hexagon_order_is_the_board_s():
    """Index rises as x falls and as y falls (y up): 0 at (.5, .866), 60 at (-.5, -.866)."""
    electrodes = load_profile("kajimoto-61").electrodes
    unit = electrodes.position_mm / (4 * electrodes.pitch_mm) * [1, -1]
    assert unit[0] == pytest.approx([0.5, math.sqrt(3) / 2])
    assert unit[30] == pytest.approx([0, 0])
    assert unit[60] == pytest.approx([-0.5, -math.sqrt(3) / 2])
    assert len(electrodes) == 61


def test_what_is_known_of_a_board(edited):
    keys = f"masked = [63, 3]\nwiring = {list(range(100, 164))}\nua_per_count = 9.7\n[optics]"
    profile = load_profile(edited(("[optics]", keys)))
    assert profile.driven.tolist() == [each for each in range(64) if each not in (3, 63)]
    assert profile.output.wiring[63] == 163
    assert profile.output.ua_per_count == 9.7


def test_unknown_name():
    names = tuple(list_profiles())
    with raises(ProfileError, names="profile", value="nothing", allowed=names) as caught:
        load_profile("nothing")
    assert all(name in str(caught.value) for name in ("nothing", *ELECTRODES))


def read_back(text, profile):
    return profile_of(tomllib.loads(text), Path(f"{profile.name}.toml"))


@pytest.mark.parametrize("name", list_profiles())
def test_it_is_read_back_as_it_was(name):
    profile = load_profile(name)
    assert read_back(as_toml(profile), profile) == profile


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


def test_limits_and_masks_of_an_older_profile_count(tmp_path):
    text = profile_path("electric-mouse").read_text("utf-8")
    assert "\n[output]\n" in text
    assert "\ncurrent_ma = " in text
    path = tmp_path / "mine.toml"
    path.write_text(text.replace("\n[output]\n", "\n[output]\nmasked = [3, 5]\n"), "utf-8")
    profile = load_profile(path)
    assert profile.output.masked == (3, 5)
    assert profile.limits == load_profile("electric-mouse").limits
