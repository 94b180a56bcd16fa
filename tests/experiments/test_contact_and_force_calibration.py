"""Calibration writes measurements to a profile; unusable measurements raise an error."""

import contextlib
import dataclasses
import tomllib
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from smarttouch.base.errors import CalibrationError, LineLostError, ProfileError
from smarttouch.base.files import data_folder
from smarttouch.boards.impedance import Impedance
from smarttouch.experiments.contact_and_force_calibration import (
    MOST_LOSSES,
    ProfileFile,
    file_to_calibrate,
    fit_curve,
    judge_contact,
    measure_contact,
    weigh,
)
from smarttouch.profile import list_profiles, load_profile

from ..support.checks import raises
from ..support.full import WHOLE
from .simulated_sensors import SimulatedCell


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
    # A file that was created after `ProfileFile` had checked the path is not overwritten.
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


def test_a_start_of_another_device_or_with_other_limits_is_refused(tmp_path):
    mine, other = tmp_path / "mine.toml", tmp_path / "other.toml"
    calibrated("force", "force.curve", [0.0, 1e-6], mine)
    lowered = ProfileFile("electric-mouse", other)
    lowered.set("limits.current_ma", 4.0)
    lowered.write()
    for overwrite in (False, True):
        with raises(CalibrationError, names="limits.current_ma", value=mine):
            file_to_calibrate("contact", str(other), "electric-mouse", mine, overwrite)
    with raises(CalibrationError, value=mine):
        file_to_calibrate("contact", "line-7", "electric-mouse", mine)


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


def measured(kohm, condition):
    return Impedance(np.array(kohm, float), tuple(condition), 0.5)


GOOD = ["good"] * 6


def test_medians_spreads_and_most_conditions():
    usual = ["good", "good", "open", "good", "short", "good"]
    once = ["good", "good", "open", "open", "short", "good"]
    runs = [
        measured([30, 31, np.inf, 30, 0.1, 29], usual),
        measured([32, 31, np.inf, np.inf, 0.1, 31], once),
        measured([34, 31, np.inf, 32, 0.2, 33], usual),
    ]
    found = judge_contact(runs)
    assert found.kohm.tolist() == [32, 31, np.inf, 32, 0.1, 31]
    assert found.condition == ("good", "good", "open", "good", "short", "good")
    assert found.broken == [2, 4]
    assert found.spread_kohm[0] == pytest.approx(1.4826 * 2)
    assert found.spread_kohm[1] == 0
    assert np.isnan(found.spread_kohm[[2, 3]]).all()
    assert found.sentence().startswith(
        "4 good, 1 open (electrodes 2), 1 short (electrodes 4) of 6 electrodes; good electrodes: "
        "median impedance 31.5 kohm"
    )


def test_what_they_disagree_on_is_unsure_and_not_masked():
    half = [measured([30] * 6, GOOD), measured([30] * 5 + [np.inf], [*GOOD[:5], "open"])]
    found = judge_contact(half)
    assert found.condition[5] == "unsure"
    assert found.broken == []


def test_what_goes_into_the_profile(profile, changed):
    masked = changed(profile, {"output.masked": (7, 20)})
    kohm = np.linspace(30, 40, 64)
    kohm[[3, 20]] = np.inf, 0.2
    condition = ["good"] * 64
    condition[3], condition[20] = "open", "short"
    found = judge_contact([measured(kohm, condition)])
    assert found.masked(masked) == [3, 7, 20]
    values = found.impedances(masked)
    usual = np.median(np.delete(kohm, [3, 20]))
    assert values[3] == values[20] == pytest.approx(usual, rel=1e-3)
    assert values[0] == 30


LIFTED = {"names": "finger"}


@pytest.mark.parametrize(("runs", "attributes"), [
    ([measured([np.inf] * 6, ["open"] * 6)], LIFTED),
    ([measured([30] * 6, GOOD), measured([np.inf] * 6, ["open"] * 6)], LIFTED),
    (
        [measured([30, 30] + [np.inf] * 4, ["good"] * 2 + ["open"] * 4)],
        {"value": 4},
    ),
    ([measured([30] * 6, ["unsure"] * 6)], {"value": 0}),
    ([measured([10 * 4**i] * 6, GOOD) for i in range(3)], {}),
])  # fmt: skip
def test_no_contact_is_one_sentence(runs, attributes):
    with raises(CalibrationError, **attributes):
        judge_contact(runs)


class Lossy:
    """Board whose connection breaks at the measurements with the numbers ``lost_at``."""

    def __init__(self, lost_at):
        self.lost_at, self.opened, self.measured = lost_at, 0, 0

    @contextlib.contextmanager
    def __call__(self):
        self.opened += 1
        yield self

    def measure(self):
        self.measured += 1
        if self.measured in self.lost_at:
            raise LineLostError("gone")
        return self.measured


def test_a_lost_board_is_opened_again_until_it_is_given_up():
    board = Lossy({2, 4})
    assert measure_contact(board, 4) == [1, 3, 5, 6]
    assert board.opened == 3
    board = Lossy(set(range(1, 100)))
    with pytest.raises(LineLostError):
        measure_contact(board, 4)
    assert board.opened == MOST_LOSSES + 1


UP = (0, 20, 50, 75, 100)


def weighed(cell, grams=UP, seconds=2.0):
    found = []
    for each in grams:
        cell.grams = each
        found.append(weigh(cell, each, seconds))
    return found


def off_n(cell, found):
    """Return the errors, N, of a fitted force curve from 0 to full force."""
    force_n = np.linspace(0, found.full_n, 40)
    seen = cell.zero + cell.counts_per_n * force_n
    return np.array([found.force_n(each) for each in seen]) - force_n


def test_cells_of_known_truth(profile):
    """With 4 mN of noise, 3 % outliers and 2 % NaN, the errors of the force curve stay small."""
    off = []
    for seed in range(200 if WHOLE else 50):
        random = np.random.default_rng(seed)
        cell = SimulatedCell(
            counts_per_n=random.choice([-1, 1]) * 10 ** random.uniform(3, 6),
            zero=random.uniform(-1e5, 1e5), noise_n=0.004, garbage=0.03, missing=0.02, seed=seed,
        )  # fmt: skip
        off.append(off_n(cell, fit_curve(weighed(cell), profile.force)))
    assert np.abs(np.mean(off, axis=0)).max() < 0.0005
    assert np.std(off, axis=0).max() < 0.001


def test_the_curve_keeps_its_digits(profile):
    """With 24-bit readings, rounding of the stored coefficients does not change the force."""
    cell = SimulatedCell(counts_per_n=8e6, zero=8e6, noise_n=0.0005)
    assert np.abs(off_n(cell, fit_curve(weighed(cell), profile.force))).max() < 0.002


class Listed:
    def __init__(self, readings):
        self._readings = readings

    def collect(self, seconds):
        return np.array(self._readings, float)


@pytest.mark.parametrize("readings", [[], [1, 2], [np.nan] * 9, [1, 2, 3, 4, 5] + [np.nan] * 6])
def test_readings_that_are_none(readings):
    count = np.isfinite(readings).sum()
    with raises(CalibrationError, value=count, allowed=5):
        weigh(Listed(readings), 20, 1.0)


def nonsense():
    """Yield a name, weights in g, a map of weight to reading, and attributes of the error."""
    line = {0: 0, 20: 2e4, 50: 5e4, 100: 1e5}
    yield "nothing moves", UP, lambda g: 5.0, {"value": 0, "allowed": 0}
    noisy = {"value": 0, "allowed": lambda noise: noise > 15}
    yield "only noise", UP, lambda g: 0.0, noisy
    yield "turns back", (0, 20, 50, 100), {**line, 50: 1e4}.get, {}
    bent = {"value": lambda residual_n: residual_n > 0.05 * 0.9}
    yield "one step", (0, 20, 50, 100), {**line, 50: 2.1e4}.get, bent
    yield "two weights", (0, 0, 100), line.get, {"value": 2}
    yield "too light", (0, 5, 10), lambda g: 1e3 * g, {"value": 10}


@pytest.mark.parametrize(("name", "grams", "reading", "attributes"), list(nonsense()))
def test_nonsense_is_one_sentence(profile, name, grams, reading, attributes):
    noise = np.random.default_rng(0).standard_normal(50) * (30 if name == "only noise" else 0)
    found = [weigh(Listed(reading(each) + noise), each, 1.0) for each in grams]
    with raises(CalibrationError, **attributes):
        fit_curve(found, profile.force)


def test_a_weight_that_was_not_at_rest(profile):
    found = weighed(SimulatedCell())
    found[2] = dataclasses.replace(found[2], drift=0.1 * 4.1e5)
    with raises(CalibrationError, names="drift", value=pytest.approx(0.1, abs=0.001)) as caught:
        fit_curve(found, profile.force)
    assert "50 g" in str(caught.value)
