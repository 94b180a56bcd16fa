"""Profiles of earlier versions are brought up to date: as they counted, or lowered and told."""

import tomllib

import pytest

from smarttouch.errors import ProfileError
from smarttouch.files import read_toml
from smarttouch.profile import list_profiles, load_profile
from smarttouch.profile.load import profile_path
from smarttouch.profile.migrate import migrate
from smarttouch.stimulation.safety import SafetyLimits
from smarttouch.stimulation.sharing import unsupported_reason

from ..raising import raises
from .first_version import TOTAL_GIVEN, first_version

LIMITS = {
    "limits.density_uc_cm2": 100.0,
    "limits.session_s": 3600.0,
    "limits.session_mc": 1800.0,
}


@pytest.mark.parametrize("name", list_profiles())
def test_shipped_ones_are_up_to_date(name):
    table = read_toml(profile_path(name), ProfileError)
    assert migrate(table) == []
    assert table == read_toml(profile_path(name), ProfileError)


@pytest.mark.parametrize("name", list_profiles())
def test_the_first_version_s_come_to_what_is_shipped(name):
    table = tomllib.loads(first_version(name))
    changes = {each.key: each.after for each in migrate(table)}
    total = {} if name in TOTAL_GIVEN else {"limits.total_ma": 10.0}
    assert changes == LIMITS | total | {"frames.share": name in TOTAL_GIVEN}
    assert table == read_toml(profile_path(name), ProfileError)


@pytest.mark.parametrize("name", list_profiles())
def test_what_changes_counted_before(name, tmp_path):
    old = tmp_path / f"{name}.toml"
    old.write_text(first_version(name))
    before, after = load_profile(old), load_profile(name)
    assert SafetyLimits.of(before) == SafetyLimits.of(after)
    assert before.design_total_ma == after.design_total_ma
    assert (unsupported_reason(before) is None) == (unsupported_reason(after) is None)


def test_a_total_above_the_ceiling_is_lowered_and_told(tmp_path):
    table = tomllib.loads(first_version("electric-mouse", 25.5))
    (change,) = [each for each in migrate(table) if each.key == "limits.total_ma"]
    assert (change.before, change.after) == (25.5, 10.0)
    assert "25.5" in str(change)
    assert table["limits"]["total_ma"] == 10.0
    assert migrate(table) == []


def test_loading_one_that_must_be_lowered_says_how(tmp_path):
    old = tmp_path / "old.toml"
    old.write_text(first_version("electric-mouse", 25.5))
    with raises(
        ProfileError,
        about="limits.total_ma",
        problem="too large",
        value=25.5,
        allowed=10.0,
        remedy="smarttouch profiles migrate",
    ):
        load_profile(old)


def test_a_total_that_is_too_large_elsewhere_is_not_of_the_version(tmp_path):
    old = tmp_path / "old.toml"
    old.write_text(first_version("electric-mouse", 1.0))
    with raises(ProfileError, about="limits.total_ma", remedy="perception.comfort_ratio"):
        load_profile(old)


@pytest.mark.parametrize(
    "table",
    [
        {},
        {"limits": 3},
        {"limits": {}, "frames": []},
        {"limits": {"total_ma": "x"}},
        {"limits": {"total_ma": float("nan")}},
        {"limits": {"total_ma": [20]}, "frames": {"share": "x"}},
    ],
)
def test_what_is_no_profile_is_left_to_who_validates(table):
    for each in migrate(table):
        assert each.before is None


def test_no_unknown_key_is_dropped():
    table = tomllib.loads(first_version("line-7"))
    table["limits"]["surprise"] = 1
    migrate(table)
    assert table["limits"]["surprise"] == 1
