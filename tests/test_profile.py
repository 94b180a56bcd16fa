"""Profiles are found by name, and refused with file, key and remedy."""

import math
import os
import random

import numpy as np
import pytest

from smarttouch.electrodes import KAJIMOTO_61_ROWS
from smarttouch.errors import ProfileError
from smarttouch.profile import list_profiles, load_profile
from smarttouch.resources import data_folder

from .raising import assert_says, raises

MUTANTS = int(os.environ.get("SMARTTOUCH_MUTANTS", "300"))
SHIPPED = {
    "electric-mouse": 64,
    "smarttouch-4x4": 16,
    "line-7": 7,
    "line-8": 8,
    "kajimoto-61": 61,
    "etactilekit-32": 32,
    "optacon-24x6": 144,
}


def test_all_are_shipped():
    assert set(list_profiles()) == set(SHIPPED)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped(name):
    profile = load_profile(name)
    assert len(profile.electrodes) == SHIPPED[name] == len(profile.threshold_ma)
    distance = profile.electrodes.distance_mm + np.eye(SHIPPED[name]) * 1e9
    assert distance.min() == pytest.approx(profile.electrodes.pitch_mm)
    assert profile.electrodes.position_mm.mean(axis=0) == pytest.approx([0, 0])


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_files_say_what_they_are(name):
    assert (data_folder("calibration") / f"{name}.toml").read_text(encoding="utf-8")[0] == "#"


def test_hexagon_order_is_the_board_s():
    """Index rises as x falls and as y falls (y up): 0 at (.5, .866), 60 at (-.5, -.866)."""
    electrodes = load_profile("kajimoto-61").electrodes
    unit = electrodes.position_mm / (4 * electrodes.pitch_mm) * [1, -1]
    assert unit[0] == pytest.approx([0.5, math.sqrt(3) / 2])
    assert unit[30] == pytest.approx([0, 0])
    assert unit[60] == pytest.approx([-0.5, -math.sqrt(3) / 2])
    assert sum(KAJIMOTO_61_ROWS) == 61


@pytest.fixture
def edited(tmp_path):
    def edit(*changes):
        text = (data_folder("calibration") / "electric-mouse.toml").read_text(encoding="utf-8")
        for old, new in changes:
            assert old in text
            text = text.replace(old, new, 1)
        path = tmp_path / "mine.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return edit


def test_a_file_of_one_s_own(edited):
    assert load_profile(edited(("rows = 8", "rows = 4"))).array.rows == 4


def test_what_is_known_of_a_board(edited):
    keys = f"masked = [63, 3]\nwiring = {list(range(100, 164))}\nua_per_count = 9.7\n[optics]"
    profile = load_profile(edited(("[optics]", keys)))
    assert profile.driven.tolist() == [each for each in range(64) if each not in (3, 63)]
    assert profile.output.wiring[63] == 163
    assert profile.output.ua_per_count == 9.7


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_ones_drive_every_electrode(name):
    assert len(load_profile(name).driven) == SHIPPED[name]


def wrong(about, problem, value=None, allowed=None, remedy=""):
    if isinstance(value, float):
        value = pytest.approx(value, nan_ok=True)
    return {
        "about": about,
        "problem": problem,
        "value": value,
        "allowed": allowed,
        "remedy": remedy,
    }


@pytest.mark.parametrize(
    ("old", "new", "attributes"),
    [
        ("pitch_x_mm", "pitch_z_mm", wrong("array.pitch_x_mm", "missing")),
        ("[skin]", "surprise = 1\n[skin]", wrong("array.surprise", "unknown", 1)),
        ("rows = 8", "rows = -1", wrong("array.rows", "too small", -1, 1)),
        ("rows = 8", "", wrong("array.rows", "missing")),
        ('layout = "grid"', 'layout = "ring"',
         wrong("array.layout", "unknown", "ring", ("grid", "hexagon-61", "lines", "free"))),
        ('layout = "grid"', "", wrong("array.layout", "missing")),
        ("threshold_ma = 1.2", "threshold_ma = [1.2, 1.3]",
         wrong("perception.threshold_ma", "too few", 2, 64)),
        ("threshold_ma = 1.2", "threshold_ma = nan",
         wrong("perception.threshold_ma", "malformed", math.nan)),
        ("threshold_ma = 1.2", "threshold_ma = 1e-30",
         wrong("perception.threshold_ma", "too small", 1e-30, 1e-9)),
        ("comfort_ratio = 2.0", "comfort_ratio = 4.5",
         wrong("limits.current_ma", "too large", 5.4, 5, "perception.comfort_ratio")),
        ("comfort_ratio = 2.0", "comfort_ratio = 2.5",
         wrong("limits.charge_uc", "too large", 0.6, 0.5, "perception.comfort_ratio")),
        ("comfort_ratio = 2.0", f"comfort_ratio = 2.0\ncomfort_ma = {[2.0] * 63 + [1.0]}",
         wrong("perception.comfort_ma", "too small", 1.0, pytest.approx(1.2))),
        ("current_ma = 5.0", "current_ma = 50.0", wrong("limits.current_ma", "too large", 50.0, 5)),
        ("charge_uc = 0.5", "charge_uc = 0.6", wrong("limits.charge_uc", "too large", 0.6, 0.5)),
        ("ramp_s = 0.5", "ramp_s = 0.1", wrong("limits.ramp_s", "too small", 0.1, 0.5)),
        ("pulse_us = 200", "pulse_us = 100", wrong("pulse.width_us", "too large", 200, 100)),
        ("full_n = 0.9", "full_n = 0.1", wrong("force.full_n", "too small", 0.1, 0.15)),
        ('medium = "half-space"', 'medium = "plane"',
         wrong("skin.medium", "conflict", "plane", ("half-space",), "array.layout")),
        ('medium = "half-space"', 'medium = "layered"',
         wrong("skin.medium", "conflict", "layered", remedy="skin.layers")),
        ("total_ma = 10.0", "total_ma = 1.0",
         wrong("limits.total_ma", "too large", 2.4, 1, "perception.comfort_ratio")),
        ("total_ma = 10.0", "electrode_ma = [1.0]", wrong("limits.electrode_ma", "too few", 1, 64)),
        ("total_ma = 10.0", f"electrode_ma = {[5.0] * 63 + [2.0]}",
         wrong("limits.electrode_ma", "too large", 2.4, 2, "perception.comfort_ratio")),
        ("ra_depth_mm = 0.1", "ra_depth_mm = 0.8",
         wrong("skin.spread.ra_depth_mm", "too large", 0.8, 0.7)),
        ("ra_depth_mm = 0.7", "ra_depth_mm = -0.7",
         wrong("skin.ra_depth_mm", "too small", -0.7, 0)),
        ("diameter_mm = 1.0", "diameter_mm = 1.0\ninner_diameter_mm = 1.0",
         wrong("array.inner_diameter_mm", "too large", 1.0, 1)),
        ("[optics]", "masked = [64]\n[optics]", wrong("output.masked", "too large", 64, 63)),
        ("[optics]", "masked = [3, -1]\n[optics]", wrong("output.masked", "too small", -1, 0)),
        ("[optics]", "masked = [3, 5, 3]\n[optics]", wrong("output.masked", "twice", 3)),
        ("[optics]", f"masked = {list(range(63))}\n[optics]",
         wrong("output.masked", "too many", 63, 62)),
        ("[optics]", "wiring = [0, 1]\n[optics]", wrong("output.wiring", "too few", 2, 64)),
        ("[optics]", "wiring = [7, 7]\n[optics]", wrong("output.wiring", "twice", 7)),
        ("[optics]", "ua_per_count = 0\n[optics]", wrong("output.ua_per_count", "too small", 0, 0)),
    ],
)  # fmt: skip
def test_refusals(edited, old, new, attributes):
    path = edited((old, new))
    with raises(ProfileError, **attributes) as caught:
        load_profile(path)
    assert str(path) in str(caught.value)


def test_the_weakest_electrode_is_named(edited):
    path = edited(("total_ma = 10.0", f"electrode_ma = {[5.0] * 62 + [2.0, 5.0]}"))
    with raises(ProfileError, about="limits.electrode_ma", electrode=62):
        load_profile(path)


def test_no_toml(edited):
    path = edited(("[array]", "[array"))
    with raises(ProfileError, about="file", problem="malformed", value=path) as caught:
        load_profile(path)
    assert str(path) in str(caught.value)


def test_unknown_name():
    names = tuple(list_profiles())
    with raises(
        ProfileError, about="profile", problem="unknown", value="nothing", allowed=names
    ) as caught:
        load_profile("nothing")
    assert all(name in str(caught.value) for name in ("nothing", *SHIPPED))


def test_not_text(tmp_path):
    path = tmp_path / "x.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with raises(ProfileError, about="file", problem="not UTF-8", value=path):
        load_profile(path)


FREE = """[array]
layout = "free"
positions_mm = {positions}
shape = "{shape}"
size_mm = {size}

[skin]"""


def with_free_array(edited, positions, shape="disc", size="[1.0, 0]"):
    text = (data_folder("calibration") / "electric-mouse.toml").read_text(encoding="utf-8")
    table = text[text.index("[array]") : text.index("[skin]") + len("[skin]")]
    return edited((table, FREE.format(positions=positions, shape=shape, size=size)))


def test_electrodes_anywhere(edited):
    profile = load_profile(with_free_array(edited, "[[0, 0], [2, 0], [1, 1.5]]"))
    assert profile.electrodes.position_mm.tolist() == [[-1, -0.75], [1, -0.75], [0, 0.75]]
    assert profile.electrodes.pitch_mm == pytest.approx(np.hypot(1, 1.5))


@pytest.mark.parametrize(
    ("positions", "shape", "size", "attributes"),
    [
        ("[]", "disc", "[1, 0]", wrong("electrodes", "too few", 0, 2)),
        ("[[0, 0]]", "disc", "[1, 0]", wrong("electrodes", "too few", 1, 2)),
        ("[[0, 0], [2, 0], [0, 0]]", "disc", "[1, 0]", wrong("electrodes", "conflict", (0, 2))),
        (
            "[[0, 0], [2, 0]]",
            "annulus",
            "[1, 1]",
            wrong("array.size_mm", "conflict", (1, 1), remedy="array.shape"),
        ),
        (
            "[[0, 0], [2, 0]]",
            "rectangle",
            "[1, 0]",
            wrong("array.size_mm", "conflict", (1, 0), remedy="array.shape"),
        ),
        ("[[0, 0], [2, 0]]", "star", "[1, 0]", wrong("array.shape", "unknown", "star")),
    ],
)
def test_impossible_arrays(edited, positions, shape, size, attributes):
    path = with_free_array(edited, positions, shape, size)
    with raises(ProfileError, **attributes) as caught:
        load_profile(path)
    assert str(path) in str(caught.value)


VALUES = (
    "nan", "inf", "-inf", "-1", "0", "1", "2", "65536", "1e30", "1e-30", "1e308", "9" * 30, '""',
    '"x"', "[]", "[0]", "[[0]]", "{}", "true", '"\\u001b[31m"', "[1, 2, 3]", "[nan, 0]",
    "[[nan, 0.0], [1.0, 1.0]]", "1979-05-27", "9" * 5000, "0x" + "f" * 9999, "[" * 2000,
)  # fmt: skip


def test_no_mutant_is_more_than_one_sentence(tmp_path):
    refused = 0
    for seed in range(MUTANTS):
        chance = random.Random(seed)
        shipped = data_folder("calibration") / f"{chance.choice(sorted(SHIPPED))}.toml"
        lines = shipped.read_text(encoding="utf-8").split("\n")
        for _ in range(chance.choice((1, 1, 2, 4))):
            at = chance.randrange(len(lines))
            if "=" in lines[at] and chance.random() < 0.7:
                lines[at] = f"{lines[at].split('=')[0]}= {chance.choice(VALUES)}"
            elif chance.random() < 0.5:
                lines[at] = lines[chance.randrange(len(lines))]
            else:
                lines[at] += chr(chance.randrange(256))
        path = tmp_path / "mutant.toml"
        path.write_text("\n".join(lines), encoding="utf-8")
        try:
            profile = load_profile(path)
        except ProfileError as error:
            assert_says(error, about=bool, problem=bool)
            refused += 1
            continue
        # What is believed can be used, and kept in a recording.
        assert np.isfinite([*profile.full_ma, *profile.electrodes.position_mm.ravel()]).all()
        assert type(profile).model_validate_json(profile.model_dump_json()) == profile
    assert MUTANTS / 4 < refused < MUTANTS


def test_a_layer_without_end_is_kept_in_a_recording(changed, profile):
    layers = [{"conductivity_s_per_m": 0.1, "thickness_mm": 1.0}, {"conductivity_s_per_m": 0.3}]
    layered = changed(
        profile,
        {"skin.medium": "layered", "skin.layers": layers, "skin.conductivity_s_per_m": None},
    )
    assert layered.skin.layers[-1].thickness_mm == math.inf
    assert type(profile).model_validate_json(layered.model_dump_json()) == layered
