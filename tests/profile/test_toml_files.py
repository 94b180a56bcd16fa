"""Profiles are loaded by name or file; an error names the file and all wrong keys at once."""

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


@pytest.fixture
def edited(tmp_path):
    """Return a function that writes the profile electric-mouse with some words replaced."""

    def edit(*changes):
        text = profile_path("electric-mouse").read_text("utf-8")
        for old, new in changes:
            assert old in text
            text = text.replace(old, new, 1)
        path = tmp_path / "mine.toml"
        path.write_text(text, "utf-8")
        return path

    return edit


def wrong(key, value=None, allowed=None):
    if isinstance(value, float):
        value = pytest.approx(value, nan_ok=True)
    return {"key": key, "value": value, "allowed": allowed}


@pytest.mark.parametrize(
    ("old", "new", "attributes"),
    [
        ("pitch_x_mm", "pitch_z_mm", wrong("array.pitch_x_mm")),
        ("[skin]", "surprise = 1\n[skin]", wrong("array.surprise")),
        ("rows = 8", "rows = -1", wrong("array.rows", -1, 1)),
        ("rows = 8", "", wrong("array.rows")),
        ('layout = "grid"', 'layout = "ring"',
         wrong("array.layout", "ring", ("grid", "hexagon-61", "lines", "free"))),
        ('layout = "grid"', "", wrong("array.layout")),
        ("node_spacing_mm = 0.1", "node_spacing_mm = 0.5",
         wrong("skin.node_spacing_mm", 0.5, 0.25)),
        ("threshold_ma = 1.2", "threshold_ma = [1.2, 1.3]",
         wrong("perception.threshold_ma", 2, 64)),
        ("threshold_ma = 1.2", "threshold_ma = nan",
         wrong("perception.threshold_ma", math.nan)),
        ("threshold_ma = 1.2", "threshold_ma = 1e-30",
         wrong("perception.threshold_ma", 1e-30, 1e-9)),
        ("comfort_ratio = 2.0", "comfort_ratio = 4.5",
         wrong("limits.current_ma", 5.4, 5)),
        ("comfort_ratio = 2.0", "comfort_ratio = 2.5",
         wrong("limits.charge_uc", 0.6, 0.5)),
        ("comfort_ratio = 2.0", f"comfort_ratio = 2.0\ncomfort_ma = {[2.0] * 63 + [1.0]}",
         wrong("perception.comfort_ma", 1.0, pytest.approx(1.2))),
        ("current_ma = 5.0", "current_ma = 50.0", wrong("limits.current_ma", 50.0, 5)),
        ("charge_uc = 0.5", "charge_uc = 0.6", wrong("limits.charge_uc", 0.6, 0.5)),
        ("ramp_s = 0.5", "ramp_s = 0.1", wrong("limits.ramp_s", 0.1, 0.5)),
        ("pulse_us = 200", "pulse_us = 100", wrong("pulse.width_us", 200, 100)),
        ("full_n = 0.9", "full_n = 0.1", wrong("force.full_n", 0.1, 0.15)),
        ('medium = "half-space"', 'medium = "plane"',
         wrong("skin.medium", "plane", ("half-space",))),
        ('medium = "half-space"', 'medium = "layered"',
         wrong("skin.medium", "layered", ("half-space", "infinite", "plane"))),
        ("total_ma = 10.0", "total_ma = 1.0",
         wrong("limits.total_ma", 2.4, 1)),
        ("total_ma = 10.0", "electrode_ma = [1.0]", wrong("limits.electrode_ma", 1, 64)),
        ("total_ma = 10.0", f"electrode_ma = {[5.0] * 63 + [2.0]}",
         wrong("limits.electrode_ma", 2.4, 2)),
        ("ra_depth_mm = 0.7", "ra_depth_mm = -0.7",
         wrong("skin.ra_depth_mm", -0.7, 0)),
        ("diameter_mm = 1.0", "diameter_mm = 1.0\ninner_diameter_mm = 1.0",
         wrong("array.inner_diameter_mm", 1.0, 1)),
        ("[optics]", "masked = [64]\n[optics]", wrong("output.masked", 64, 63)),
        ("[optics]", "masked = [3, -1]\n[optics]", wrong("output.masked", -1, 0)),
        ("[optics]", "masked = [3, 5, 3]\n[optics]", wrong("output.masked", 3)),
        ("[optics]", f"masked = {list(range(63))}\n[optics]",
         wrong("output.masked", 1, 64)),
        ("[optics]", "wiring = [0, 1]\n[optics]", wrong("output.wiring", 2, 64)),
        ("[optics]", "wiring = [7, 7]\n[optics]", wrong("output.wiring", 7)),
        ("[optics]", "ua_per_count = 0\n[optics]", wrong("output.ua_per_count", 0, 0)),
    ],
)  # fmt: skip
def test_refusals(edited, old, new, attributes):
    path = edited((old, new))
    with raises(ProfileError, **attributes) as caught:
        load_profile(path)
    assert str(path) in str(caught.value)


FREE = """[array]
layout = "free"
positions_mm = {positions}
shape = "{shape}"
size_mm = {size}

[skin]"""


def with_free_array(edited, positions, shape="disc", size="[1.0, 0]"):
    text = profile_path("electric-mouse").read_text("utf-8")
    table = text[text.index("[array]") : text.index("[skin]") + len("[skin]")]
    return edited((table, FREE.format(positions=positions, shape=shape, size=size)))


def test_electrodes_anywhere(edited):
    profile = load_profile(with_free_array(edited, "[[0, 0], [2, 0], [1, 1.5]]"))
    assert profile.electrodes.position_mm.tolist() == [[-1, -0.75], [1, -0.75], [0, 0.75]]
    assert profile.electrodes.pitch_mm == pytest.approx(np.hypot(1, 1.5))


@pytest.mark.parametrize(("positions", "shape", "size", "attributes"), [
    ("[]", "disc", "[1, 0]", wrong("electrodes", "no electrodes", "two")),
    ("[[0, 0]]", "disc", "[1, 0]", wrong("electrodes", 1, "two")),
    ("[[0, 0], [2, 0], [0, 0]]", "disc", "[1, 0]", wrong("electrodes", (0, 2))),
    (
        "[[0, 0], [2, 0]]",
        "annulus",
        "[1, 1]",
        wrong("array.size_mm", (1, 1)),
    ),
    (
        "[[0, 0], [2, 0]]",
        "rectangle",
        "[1, 0]",
        wrong("array.size_mm", (1, 0)),
    ),
    ("[[0, 0], [2, 0]]", "star", "[1, 0]", wrong("array.shape", "star")),
])  # fmt: skip
def test_impossible_arrays(edited, positions, shape, size, attributes):
    path = with_free_array(edited, positions, shape, size)
    with raises(ProfileError, **attributes) as caught:
        load_profile(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "complaints"),
    [
        (
            [("rows = 8", "rows = -1"), ("current_ma = 5.0", "current_ma = 50.0"),
             ("full_n = 0.9", "full_n = 0.1"), ("[skin]", "surprise = 1\n[skin]"),
             ("rate_hz = 50.0", "")],
            [("array.rows", -1, 1), ("array.surprise",),
             ("force.full_n", 0.1, 0.15), ("pulse.rate_hz",),
             ("limits.current_ma", 50.0, 5)],
        ),
        (
            [("threshold_ma = 1.2", 'threshold_ma = [1.2, "x", -1.0]')],
            [("perception.threshold_ma.1", "x"),
             ("perception.threshold_ma.2", -1.0, 0)],
        ),
    ],
)  # fmt: skip
def test_all_errors_are_reported_at_once(edited, changes, complaints):
    path = edited(*changes)
    with raises(ProfileError) as caught:
        load_profile(path)
    found = dict(caught.value.complaints)
    assert len(caught.value.complaints) == len(complaints)
    assert {key for key, *_ in complaints} == set(found)
    for key, *numbers in complaints:
        assert all(f"{each}" in found[key] for each in (path, *numbers)), found[key]
    assert caught.value.key == caught.value.complaints[0][0]
    assert all(key.rpartition(".")[2] in str(caught.value) for key in found)


def with_shapes(edited, shapes, sizes, positions="[[0, 0], [0, 0]]"):
    path = with_free_array(edited, positions)
    text = path.read_text().replace(
        "positions_mm", f"shapes = {shapes}\nsizes_mm = {sizes}\npositions_mm", 1
    )
    path.write_text(text)
    return path


CONCENTRIC = ('["disc", "annulus"]', "[[1.0, 0.0], [8.0, 6.0]]")


def test_a_ring_around_a_disc(edited, tmp_path):
    profile = load_profile(with_shapes(edited, *CONCENTRIC))
    array = profile.electrodes
    assert array.position_mm.tolist() == [[0, 0], [0, 0]]
    assert array.area_mm2 == pytest.approx(np.pi / 4 * np.array([1, 64 - 36]))
    assert array.pitch_mm == pytest.approx(3.5)
    path = tmp_path / "written.toml"
    path.write_text(as_toml(profile))
    assert load_profile(path).array == profile.array


@pytest.mark.parametrize(("shapes", "sizes", "attributes"), [
    ('["disc", "annulus"]', "[[6.5, 0.0], [8.0, 6.0]]", wrong("electrodes", (0, 1))),
    ('["disc", "disc"]', "[[1.0, 0.0], [2.0, 0.0]]", wrong("electrodes", (0, 1))),
    ('["disc"]', "[[1.0, 0.0], [2.0, 0.0]]", wrong("array.shapes", 1, 2)),
    (
        '["disc", "annulus"]',
        "[[1.0, 0.0], [6.0, 6.0]]",
        wrong("array.sizes_mm", (6, 6)),
    ),
])  # fmt: skip
def test_impossible_mixtures_of_shapes(edited, shapes, sizes, attributes):
    with raises(ProfileError, **attributes):
        load_profile(with_shapes(edited, shapes, sizes))


def test_a_copy_is_checked_and_keeps_nothing_that_was_derived():
    profile = load_profile("electric-mouse")
    assert profile.full_ma[0] == pytest.approx(2.4)
    weaker = profile.perception.model_copy(update={"threshold_ma": 0.7})
    copy = profile.model_copy(update={"perception": weaker})
    assert copy.full_ma[0] == pytest.approx(1.4)
    assert copy.name == profile.name
    assert copy.model_fields_set == profile.model_fields_set
    impossible = {"limits": profile.limits.model_dump() | {"current_ma": 50.0}, "surprise": 1}
    with raises(ProfileError, key="limits.current_ma") as error:
        profile.model_copy(update=impossible)
    assert [key for key, _ in error.value.complaints] == ["limits.current_ma", "surprise"]


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
    # The ring and the disc have the same center, so the pitch is the ring's mean radius.
    nearest_mm = (8 + 6) / 4 if name == "concentric" else distance.min()
    assert profile.electrodes.pitch_mm == pytest.approx(nearest_mm)
    assert profile.electrodes.position_mm.mean(axis=0) == pytest.approx([0, 0])


def test_hexagon_order_is_the_board_s():
    """Electrode 0 is at the top right corner, 30 in the middle, 60 at the bottom left corner."""
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
    with raises(ProfileError, names="profile", value="nothing", allowed=tuple(ELECTRODES)):
        load_profile("nothing")


@pytest.mark.parametrize("name", list_profiles())
def test_it_is_read_back_as_it_was(name):
    profile = load_profile(name)
    written = tomllib.loads(as_toml(profile))
    assert profile_of(written, Path(f"{profile.name}.toml")) == profile


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
