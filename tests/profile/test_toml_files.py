"""Profiles are found by name or file."""

import math

import numpy as np
import pytest

from smarttouch.base.errors import ProfileError
from smarttouch.base.files import data_folder
from smarttouch.profile import list_profiles, load_profile

from ..raising import raises

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


@pytest.mark.parametrize("name", ELECTRODES)
def test_shipped_files_describe_themselves(name):
    assert (data_folder("calibration") / f"{name}.toml").read_text(encoding="utf-8")[0] == "#"


def test_hexagon_order_is_the_board_s():
    """Index rises as x falls and as y falls (y up): 0 at (.5, .866), 60 at (-.5, -.866)."""
    electrodes = load_profile("kajimoto-61").electrodes
    unit = electrodes.position_mm / (4 * electrodes.pitch_mm) * [1, -1]
    assert unit[0] == pytest.approx([0.5, math.sqrt(3) / 2])
    assert unit[30] == pytest.approx([0, 0])
    assert unit[60] == pytest.approx([-0.5, -math.sqrt(3) / 2])
    assert len(electrodes) == 61


def test_a_file_of_one_s_own(edited):
    assert load_profile(edited(("rows = 8", "rows = 4"))).array.rows == 4


def test_what_is_known_of_a_board(edited):
    keys = f"masked = [63, 3]\nwiring = {list(range(100, 164))}\nua_per_count = 9.7\n[optics]"
    profile = load_profile(edited(("[optics]", keys)))
    assert profile.driven.tolist() == [each for each in range(64) if each not in (3, 63)]
    assert profile.output.wiring[63] == 163
    assert profile.output.ua_per_count == 9.7


def test_no_toml(edited):
    path = edited(("[array]", "[array"))
    with raises(ProfileError, value=path) as caught:
        load_profile(path)
    assert str(path) in str(caught.value)


def test_unknown_name():
    names = tuple(list_profiles())
    with raises(ProfileError, names="profile", value="nothing", allowed=names) as caught:
        load_profile("nothing")
    assert all(name in str(caught.value) for name in ("nothing", *ELECTRODES))


def test_not_text(tmp_path):
    path = tmp_path / "x.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with raises(ProfileError, value=path):
        load_profile(path)
