"""A profile with some keys changed is the profile it was, else; and never half."""

import tomllib
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import strategies as st

from smarttouch.base.errors import CalibrationError, ProfileError
from smarttouch.base.files import data_folder
from smarttouch.experiments.profile_file import ProfileFile, file_to_calibrate
from smarttouch.profile import list_profiles, load_profile

from ..support.checks import raises

numbers = st.floats(0.01, 1e6, allow_nan=False)


def comments(text):
    return [line[line.index("#") :] for line in text.splitlines() if "#" in line]


@pytest.mark.parametrize("name", list_profiles())
def test_only_what_is_set_changes_and_comments_stay(name, tmp_path):
    file = ProfileFile(name, tmp_path / "mine.toml")
    file.set("force.curve", [0.5, 2e-6])
    file.set("optics.sensor_columns", 640)
    file.note("force", "a line")
    profile = file.write()
    before = (data_folder("calibration") / f"{name}.toml").read_text()
    text = (tmp_path / "mine.toml").read_text()
    assert comments(text) == comments(before)
    wanted = tomllib.loads(before)
    wanted["force"]["curve"] = [0.5, 2e-6]
    wanted["optics"]["sensor_columns"] = 640
    written = tomllib.loads(text)
    noted = written.pop("calibrated")["force"]
    assert written == wanted
    assert noted["found"] == "a line"
    assert noted["versions"].startswith("smarttouch ")
    assert "opencv " in noted["versions"]
    assert timedelta(0) <= datetime.now(UTC) - noted["when"] < timedelta(minutes=1)
    assert profile == load_profile(tmp_path / "mine.toml")
    assert profile.force.curve == (0.5, 2e-6)


def test_nothing_is_overwritten_unless_requested(tmp_path):
    mine = tmp_path / "mine.toml"
    mine.write_text("what was there")
    with raises(CalibrationError, value=mine):
        ProfileFile("electric-mouse", mine)
    # Nor what came there meanwhile.
    late = ProfileFile("electric-mouse", tmp_path / "late.toml")
    (tmp_path / "late.toml").write_text("came meanwhile")
    with raises(CalibrationError, value=tmp_path / "late.toml"):
        late.write()
    other = ProfileFile("electric-mouse", tmp_path / "other.toml")
    (tmp_path / "other.npz").write_bytes(b"there")
    with raises(CalibrationError, value=tmp_path / "other.npz"):
        other.write({tmp_path / "other.npz": b"new"})
    assert mine.read_text() == "what was there"
    assert (tmp_path / "late.toml").read_text() == "came meanwhile"
    assert (tmp_path / "other.npz").read_bytes() == b"there"
    assert not (tmp_path / "other.toml").exists()


def test_what_would_not_load_replaces_nothing(tmp_path):
    mine = tmp_path / "mine.toml"
    ProfileFile("electric-mouse", mine).write()
    before = mine.read_bytes()
    file = ProfileFile(str(mine), mine, overwrite=True)
    file.set("perception.threshold_ma", [1.0, 2.0])
    with raises(CalibrationError, names="perception.threshold_ma", value=2, allowed=64):
        file.write({tmp_path / "mine.npz": b"beside"})
    assert mine.read_bytes() == before
    assert sorted(each.name for each in tmp_path.iterdir()) == ["mine.toml"]


def test_a_flat_field_is_still_found_from_another_folder(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    first = ProfileFile("electric-mouse", tmp_path / "a" / "mine.toml")
    first.set("optics.flat_field", "mine.npz")
    first.write({tmp_path / "a" / "mine.npz": b"field"})
    second = ProfileFile(str(tmp_path / "a" / "mine.toml"), tmp_path / "b" / "mine.toml")
    found = second.write().optics.flat_field
    assert Path(found).read_bytes() == b"field"


@pytest.mark.parametrize("output", ["mine.txt", "none/mine.toml", "folder.toml"])
def test_outputs_that_cannot_be(tmp_path, output):
    (tmp_path / "folder.toml").mkdir()
    with raises(CalibrationError, value=tmp_path / output):
        ProfileFile("electric-mouse", tmp_path / output, overwrite=True)
    with raises(ProfileError, names="profile", value="nobody"):
        ProfileFile("nobody", tmp_path / "mine.toml")


def calibrated(part, key, value, output, start=None, overwrite=False):
    file = file_to_calibrate(part, start, "electric-mouse", output, overwrite)
    file.set(key, value)
    file.note(part, f"{part} {value}")
    return file.write()


def test_calibrations_of_one_profile_accumulate(tmp_path):
    mine = tmp_path / "mine.toml"
    calibrated("thresholds", "perception.threshold_ma", [1.1] * 64, mine)
    calibrated("force", "force.curve", [0.0, 1e-6], mine)
    calibrated("contact", "output.masked", [3], mine, start="electric-mouse")
    profile = calibrated("registration", "optics.sensor_columns", 640, mine, start=str(mine))
    assert set(profile.calibrated) == {"thresholds", "force", "contact", "registration"}
    assert profile.perception.threshold_ma == (1.1,) * 64
    assert profile.force.curve == (0.0, 1e-6)
    assert profile.output.masked == (3,)
    assert comments(mine.read_text()) == comments(
        (data_folder("calibration") / "electric-mouse.toml").read_text()
    )


def test_a_part_again_needs_overwrite_and_keeps_the_rest(tmp_path):
    mine = tmp_path / "mine.toml"
    calibrated("force", "force.curve", [0.0, 1e-6], mine)
    calibrated("contact", "output.masked", [3], mine)
    before = mine.read_bytes()
    with raises(CalibrationError, names="force", value=mine):
        file_to_calibrate("force", None, "electric-mouse", mine)
    assert mine.read_bytes() == before
    profile = calibrated("force", "force.curve", [0.5, 1e-6], mine, overwrite=True)
    assert profile.force.curve == (0.5, 1e-6)
    assert profile.output.masked == (3,)
    found = {key: each.found for key, each in profile.calibrated.items()}
    assert found == {"force": "force [0.5, 1e-06]", "contact": "contact [3]"}


def test_a_simulation_does_not_mix_with_what_was_measured(tmp_path):
    mine = tmp_path / "mine.toml"
    start = (None, "electric-mouse", mine)
    calibrated("force", "force.curve", [0.0, 1e-6], mine)
    with raises(CalibrationError, value=mine):
        file_to_calibrate("contact", *start, simulated=True)
    assert file_to_calibrate("contact", *start, overwrite=True, simulated=True)
    again = file_to_calibrate("force", *start, overwrite=True, simulated=True)
    again.note("force", "simulated: a line")
    again.write()
    assert file_to_calibrate("contact", *start, simulated=True)


def test_a_start_of_another_device_or_with_other_limits_is_refused(tmp_path, changed, profile):
    mine, other = tmp_path / "mine.toml", tmp_path / "other.toml"
    calibrated("force", "force.curve", [0.0, 1e-6], mine)
    lowered = ProfileFile("electric-mouse", other)
    lowered.set("limits.current_ma", 4.0)
    lowered.write()
    for start, overwrite in ((str(other), False), (str(other), True)):
        with raises(CalibrationError, names="limits.current_ma", value=mine):
            file_to_calibrate("contact", start, "electric-mouse", mine, overwrite)
    with raises(CalibrationError, value=mine):
        file_to_calibrate("contact", "line-7", "electric-mouse", mine)


def test_an_output_that_is_no_profile_is_kept(tmp_path):
    mine = tmp_path / "mine.toml"
    mine.write_text("what was there")
    for overwrite in (False, True):
        with raises(ProfileError, value=mine):
            file_to_calibrate("force", None, "electric-mouse", mine, overwrite)
    assert mine.read_text() == "what was there"


def test_what_another_has_written_meanwhile_is_kept(tmp_path):
    mine = tmp_path / "mine.toml"
    calibrated("force", "force.curve", [0.0, 1e-6], mine)
    slow = file_to_calibrate("thresholds", None, "electric-mouse", mine)
    calibrated("contact", "output.masked", [3], mine)
    before = mine.read_bytes()
    slow.set("perception.threshold_ma", [1.1] * 64)
    with raises(CalibrationError, value=mine):
        slow.write()
    assert mine.read_bytes() == before
