"""Tests of the run configuration: allowed values, and the classes whose points share slots."""

import pytest

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import SmartTouchError
from smarttouch.profile import load_profile
from smarttouch.running.config import RunConfig
from smarttouch.stimulation.scan_sequence import NO_SHARING, SlotPolicy

from ..support.checks import raises


def test_which_points_share_slots(profile):
    assert RunConfig().sharing(profile) == SlotPolicy((Afferent.RA,))
    assert RunConfig(hold="charge").sharing(profile) == NO_SHARING
    for name in ("kajimoto-61", "line-7"):
        assert RunConfig().sharing(load_profile(name)) == NO_SHARING
    assert RunConfig(scan="points").sharing(profile) == NO_SHARING


def test_a_recorded_scan_is_used_where_the_board_can(profile):
    shared = SlotPolicy((Afferent.RA,))
    assert RunConfig(scan=shared).sharing(profile) == shared
    assert RunConfig(scan=shared).sharing(load_profile("kajimoto-61")) == NO_SHARING


def test_holding_goes_point_by_point(profile):
    with raises(SmartTouchError, names="scan"):
        RunConfig(scan=SlotPolicy((Afferent.RA,)), hold="energy").sharing(profile)


@pytest.mark.parametrize(("name", "value", "allowed"), [
    ("intensity", 1.5, (0, 1)),
    ("intensity", float("nan"), (0, 1)),
    ("softness", -0.1, (0, 1)),
    ("seconds", 0.0, 0),
    ("seconds", float("nan"), 0),
    ("mode", "XY", tuple(each.value for each in Mode)),
    ("scan", "frame", ("auto", "points")),
    ("hold", "voltage", ("charge", "energy")),
])  # fmt: skip
def test_impossible_values_are_named(name, value, allowed):
    with raises(SmartTouchError, value=value, allowed=allowed):
        RunConfig(**{name: value})


def test_modes_go_by_their_names():
    assert RunConfig(mode="sai").mode is Mode.SAI
    assert RunConfig(mode=Mode.NATURAL).mode is Mode.NATURAL
